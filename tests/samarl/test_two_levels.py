"""The two levels: decentralised at run time, each with its own target, and what is learned."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from mrsan import World
from mrsan.features import GOAL
from samarl.agents.learned import DeployedPolicy
from samarl.algorithms.action_limits import action_limits, excess
from samarl.encoders import ENCODERS
from samarl.observations.features import to_body
from samarl.policies.macro_actions import decode_waypoint
from samarl.policies.policy import LOCAL, MACRO, WAYPOINT_FEATURES, PolicyState
from tests.learning import SCENARIO, algorithm, collector, policy


def waypoints_of(state: PolicyState, ego: np.ndarray) -> np.ndarray:
    """The waypoints in the body frames, [E, N, 2]."""
    return to_body(state["waypoint"].view(*ego.shape[:2], 2).numpy(), ego)


def test_a_robot_decides_from_its_own_observations_alone() -> None:
    model = policy(gain=50.0)  # far from the small initial outputs
    one, other = World(SCENARIO, 3), World(SCENARIO, 3)
    observations = [world.reset([1, 2, 3]) for world in (one, other)]
    agents = [DeployedPolicy(model, SCENARIO) for _ in range(2)]
    for agent in agents:
        agent.reset(np.ones(3, np.bool_))
    other.state.robot_goal[:, 1] += 3.0  # robot 1's private state
    observations[1] = other.observe()
    for _ in range(6):
        first, second = (a.act(o) for a, o in zip(agents, observations, strict=True))
        assert (first[:, 0] == second[:, 0]).all()
        assert (first[:, 1] != second[:, 1]).any()
        observations = [one.step(first).observation, other.step(first).observation]
        observations[1] = other.observe()


@pytest.mark.parametrize(
    ("name", "encoder"),
    [
        ("hierarchical", "spatio_temporal"),
        ("hierarchical", "set_pool"),
        ("flat", "structural_rnn"),
        ("squashed", "temporal_spatial_graph"),
        ("hierarchical", "gru"),
    ],
)
def test_robots_whose_actions_have_no_effect_are_left_out_and_the_others_do_the_same(
    name: str, encoder: str
) -> None:
    model, world = policy(name, encoder, gain=20.0), World(SCENARIO, 5)
    every, focused = DeployedPolicy(model, SCENARIO), DeployedPolicy(model, SCENARIO)
    for agent in (every, focused):
        agent.reset(np.ones(5, np.bool_))
    observation = world.reset([0, 1, 2, 3, 4])
    active = np.ones((5, SCENARIO.robots), np.bool_)
    for step in range(8):
        active[step // 2, step % 2] = False  # as robots arrive one after another
        focused.focus(active)
        expected, actions = every.act(observation), focused.act(observation)
        np.testing.assert_allclose(actions[active], expected[active], atol=1e-5)
        assert not actions[~active].any()
        observation = world.step(expected).observation
    again = np.ones(5, np.bool_)
    again[1:] = False  # the first world starts a new episode
    active[0] = True
    for agent in (every, focused):
        agent.reset(again)
    observation = world.reset(np.full(5, 9), again)
    focused.focus(active)
    expected, actions = every.act(observation), focused.act(observation)
    np.testing.assert_allclose(actions[active], expected[active], atol=1e-5)


def test_a_waypoint_stays_where_it_is_while_the_robot_moves() -> None:
    scenario = replace(SCENARIO, fov_degrees=360.0)
    model, world = policy(), World(scenario)
    with torch.no_grad():  # no macro action: the waypoint is unmoved
        for parameter in model.networks[0].heads[MACRO].body[-1].parameters():
            parameter.zero_()
    state = model.initial_state(1, scenario)
    observation, begins, due = world.reset([0]), np.ones(1, np.bool_), []
    for step in range(9):
        decision = model.act(observation, state, begins, scenario)
        due.append(bool(decision.levels[MACRO].decided.all()))
        seen = waypoints_of(state, observation.ego)
        # Zero means straight to the goal, as far as the reach: the robots look at their goals.
        ahead = 2.0 if step % 4 == 0 else 2.0 - 0.125 - 0.25 * (step % 4 - 1)
        if 0 < step < 4:
            np.testing.assert_allclose(seen, [[[ahead, 0], [ahead, 0]]], atol=1e-3)
        elif due[-1]:
            np.testing.assert_allclose(np.linalg.norm(seen, axis=-1), 2.0, atol=1e-3)
        np.testing.assert_allclose(
            decode_waypoint(decision.step.waypoint_features), seen, atol=1e-5
        )
        forward = np.zeros((1, 2, 3), np.float32)
        forward[..., 0] = 0.8  # to 1 m/s at once: 0.125 m
        observation, begins = world.step(forward).observation, np.zeros(1, np.bool_)
    assert due == [True, *[False] * 3, True, *[False] * 3, True]


@pytest.mark.parametrize("local_goal", [False, True])
def test_without_local_goal_the_goal_changes_no_bit_of_the_local_level(local_goal: bool) -> None:
    for encoder in ENCODERS:
        model, world = policy(encoder=encoder, gain=30.0, local_goal=local_goal), World(SCENARIO, 4)
        state = model.initial_state(4, SCENARIO)
        observation = world.reset(np.arange(4))
        decision = model.act(observation, state, np.ones(4, np.bool_), SCENARIO)
        observation = world.step(decision.action).observation
        other, moved = copy.deepcopy(state), observation.ego.copy()
        moved[..., GOAL] += [3.0, -2.0]
        never = np.zeros(4, np.bool_)
        one = model.act(observation, state, never, SCENARIO)
        two = model.act(observation._replace(ego=moved), other, never, SCENARIO)
        for decision in (one, two):
            assert not decision.levels[MACRO].decided.any()  # the waypoint is what it was
        assert torch.equal(one.step.waypoint_features, two.step.waypoint_features)
        same = torch.equal(one.levels[LOCAL].action, two.levels[LOCAL].action)
        assert same != local_goal
        # The macro level does know the goal.
        state["steps_left"][:], other["steps_left"][:] = 0, 0
        one = model.act(observation, state, never, SCENARIO)
        two = model.act(observation._replace(ego=moved), other, never, SCENARIO)
        assert (one.levels[MACRO].action != two.levels[MACRO].action).any()


@pytest.mark.parametrize("name", ["mappo", "ippo"])
def test_an_update_learns_and_reports_what_it_did(name: str) -> None:
    model = policy()
    learner = algorithm(model, name, epochs=8, minibatches=1, learning_rate=0.01)
    going = collector(model, 8, 16, replace(SCENARIO, humans=0))
    before = {key: value.clone() for key, value in model.state_dict().items()}
    first = learner.update([going.collect()])
    assert all(np.isfinite(value) for value in first.values())
    changed = {key for key, v in model.state_dict().items() if not torch.equal(v, before[key])}
    for part in ("encoder", "heads.macro", "heads.local"):
        assert any(key.startswith(f"networks.0.{part}") for key in changed), part
    key = "losses/local_explained_variance"
    later = [learner.update([going.collect()])[key] for _ in range(6)]
    assert max(later) > first[key] + 0.2


def test_critics_observe_the_waypoints_of_team_mates() -> None:
    scenario = replace(SCENARIO, robots=3, humans=0)
    going = collector(policy(), 2, 5, scenario)
    rollout = going.collect()
    assert rollout.state is not None
    others = rollout.state.robots.view(2, 3, 6, 2, -1)[:, :, -1]  # [S, N, N - 1, F]
    ego, waypoint = going.observation.ego, going.state["waypoint"].view(2, 3, 2).numpy()
    for robot, mates in ((0, [1, 2]), (1, [0, 2]), (2, [0, 1])):
        expected = to_body(waypoint[:, mates], ego[:, robot : robot + 1])  # as this robot sees them
        seen = decode_waypoint(others[:, robot, :, -WAYPOINT_FEATURES:])
        np.testing.assert_allclose(seen, expected, atol=1e-5)


def test_robots_with_parameters_of_their_own_act_alone() -> None:
    model = policy(num_parameter_sets=2)
    rollout = collector(model).collect()
    statistics = algorithm(model).update([rollout])
    assert all(np.isfinite(value) for value in statistics.values())
    # What robot 0 does depends on its own parameters alone.
    observation = World(SCENARIO).reset([0])
    before = DeployedPolicy(model, SCENARIO).act(observation)
    with torch.no_grad():
        for parameter in model.networks[1].parameters():
            parameter.add_(0.1)
    after = DeployedPolicy(model, SCENARIO).act(observation)
    np.testing.assert_array_equal(after[:, 0], before[:, 0])
    assert (after[:, 1] != before[:, 1]).any()


def test_commands_beyond_the_limits_cost_and_only_those() -> None:
    """5 m/s^2 for 0.25 s is 1.25 m/s; at 1 m/s a robot turns by up to 0.25 rad, standing by 15°."""
    cases = [  # speed, mean action, squared excess without noise
        (0.0, [0.8, 0.0, 0.0], 0.0),
        (0.0, [1.0, 0.0, 0.0], 0.2**2),
        (1.0, [0.3, 0.0, 0.0], 0.3**2),
        (1.0, [-0.8, 0.0, 1.0], 0.0),
        (0.5, [-0.9, 0.0, 0.0], 0.5**2),
        (0.0, [-0.5, 0.3, 1.0], 0.5**2),
        (1.0, [0.0, 0.2, 0.0], 0.0),
        (1.0, [0.0, 0.8, 0.0], ((math.atan(1.0) - 0.25) / math.radians(15.0)) ** 2),
        (1.0, [0.0, -0.2, 0.9], 0.0),
        (1.0, [0.0, 0.0, -1.2], ((0.3 * math.pi / 3 - 0.25) / math.radians(15.0)) ** 2),
    ]
    speed, mean = torch.tensor([c[0] for c in cases]), torch.tensor([c[1] for c in cases])
    limits = torch.tensor(action_limits(SCENARIO)).expand(len(mean), -1)
    costs = excess(mean, torch.zeros_like(mean), speed, limits)
    assert costs.tolist() == pytest.approx([c[2] for c in cases], abs=1e-6)
    forgiven = excess(mean[2:3], torch.full((1, 3), 0.2), speed[2:3], limits[2:3])
    assert forgiven.item() == pytest.approx(0.1**2)
    assert not excess(mean[:, :2], mean[:, :2], speed, limits).any()  # holonomic


def test_kept_samples_are_those_of_the_largest_advantages() -> None:
    model = policy("flat")
    learner = algorithm(model, advantage_filter_fraction=0.25)
    (data,) = learner.prepare([collector(model).collect()], {"losses/local_explained_variance": []})
    selected, local = data.selected, data.levels[LOCAL]
    decides, advantage = local["decides"], local["advantage"].squeeze(-1)
    size = advantage.abs()
    assert selected.sum().item() == pytest.approx(0.25 * decides.sum().item(), abs=2)
    assert size[selected].min() >= size[decides & ~selected].max()
    assert advantage[decides].mean().item() == pytest.approx(0.0, abs=1e-5)
    assert advantage[decides].std().item() == pytest.approx(1.0, abs=1e-4)
