"""The two levels: decentralised at run time, the same when acting as when training."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from samarl.algorithms.excess import excess
from samarl.training.rollout import Batch, Rollout, Steps

from mrsan import ConfigurationError, Scenario, World
from samarl.agents.learned import Deployed
from samarl.algorithms.mappo import MAPPO, Learner, advantages, macro_records
from samarl.observations.features import state_of
from samarl.policies.hierarchical import Architecture, HierarchicalPolicy, Waypoints
from samarl.training.curriculum import Group

ARCHITECTURE = Architecture(
    actors=1, width=16, heads=2, history=4, features=16, hidden=16, macro_steps=4,
    levels=2, round_below=180.0, round_radius=7.0, waypoint_ahead=2.0, waypoint_range=2.0,
    track_steps=8,
)  # fmt: skip
UPDATE = MAPPO(
    learning_rate=1e-3, epochs=1, minibatches=2, discount=0.9, local_discount=0.95,
    gae_lambda=0.8, clip_epsilon=0.2, entropy_coefficient=0.01, critic_coefficient=0.5,
    max_gradient_norm=1.0, excess_coefficient=0.01,
)  # fmt: skip
SCENARIO = Scenario(humans=4, robots=2, fov_degrees=120.0, time_limit=5.0)


def policy() -> HierarchicalPolicy:
    torch.manual_seed(0)
    return HierarchicalPolicy(ARCHITECTURE, action_size=3)


def test_training_computes_the_log_probabilities_of_acting() -> None:
    model = policy()
    rollout = Rollout(Group(12, scenario=SCENARIO), model, 10, 0, 0.98, 0.5)
    ended = 0
    for _ in range(3):  # the second and third go on in the middle of episodes
        batch = rollout.collect()
        ended += sum(len(episodes.case) for episodes in batch.episodes)
        steps = batch.steps
        y = model.encoder(batch.frames, batch.begins).view(12, 2, 10, -1).transpose(1, 2)
        robot = torch.arange(2).expand(y.shape[:3])
        macro = model.macro_actor.distribution(y, robot).log_prob(steps.macro)
        told = torch.cat([y, steps.waypoint], -1)
        local = model.local_actor.distribution(told, robot).log_prob(steps.action)
        torch.testing.assert_close(macro, steps.macro_log_prob, atol=1e-4, rtol=0)
        torch.testing.assert_close(local, steps.action_log_prob, atol=1e-4, rtol=0)
    assert ended > 0


def test_a_robot_decides_from_its_own_observations_alone() -> None:
    model = policy()
    for name, parameter in model.named_parameters():  # far from the small initial outputs
        if "actor" in name:
            torch.nn.init.normal_(parameter, std=0.5)
    one, other = World(SCENARIO, 3), World(SCENARIO, 3)
    observations = [world.reset([1, 2, 3]) for world in (one, other)]
    agents = [Deployed(model, SCENARIO) for _ in range(2)]
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


def test_the_batch_does_not_change_a_decision() -> None:
    model, scenario = policy(), replace(SCENARIO, time_limit=50.0)
    world = World(scenario, 5)
    agent, alone = Deployed(model, scenario), Deployed(model, scenario)
    agent.reset(np.ones(5, np.bool_))
    alone.reset(np.ones(1, np.bool_))
    observation = world.reset([0, 1, 2, 3, 4])
    for _ in range(8):
        actions = agent.act(observation)
        third = alone.act(observation.of_worlds(np.array([3])))
        np.testing.assert_allclose(third[0], actions[3], atol=1e-5)
        observation = world.step(actions).observation


def test_a_waypoint_stays_where_it_is_while_the_robot_moves() -> None:
    world = World(SCENARIO)
    ego = world.reset([0]).ego
    waypoints = Waypoints(1, replace(SCENARIO, fov_degrees=360.0), ARCHITECTURE)
    assert waypoints.due(ego).all()
    waypoints.set(ego, waypoints.due(ego), np.zeros((1, 2, 2), np.float32))
    # Zero means straight to the goal, as far as the reach: the robots look at their goals.
    np.testing.assert_allclose(waypoints.seen_from(ego), [[[2, 0], [2, 0]]], atol=1e-4)
    waypoints.tick()
    forward = np.zeros((1, 2, 3), np.float32)
    forward[..., 0] = 0.8  # to 1 m/s at once: 0.125 m
    ego = world.step(forward).observation.ego
    np.testing.assert_allclose(waypoints.seen_from(ego), [[[1.875, 0], [1.875, 0]]], atol=1e-4)
    assert not waypoints.due(ego).any()
    for _ in range(3):
        waypoints.tick()
    assert waypoints.due(ego).all()


def steps_of(**fields: list) -> Steps:
    """One world, one robot, a list per field; what is not given is zero."""
    length = len(fields["macro_reward"])
    default = dict.fromkeys(Steps._fields, [0] * length) | fields
    flags = ("driving", "due", "done", "terminated")
    return Steps(
        **{
            key: torch.tensor(default[key], dtype=torch.bool if key in flags else torch.float32)
            .view(1, length, 1)
            for key in Steps._fields
        }
    )  # fmt: skip


def test_macro_rewards_are_discounted_sums_over_their_durations() -> None:
    steps = steps_of(
        macro_reward=[1, 2, 4, 8, 16, 32, 64],
        due=[1, 0, 0, 1, 0, 1, 0],
        driving=[1, 1, 1, 1, 1, 1, 1],
        done=[0, 0, 0, 0, 1, 0, 0],
        terminated=[0, 0, 0, 0, 1, 0, 0],
    )
    records = macro_records(steps, discount=0.5)
    assert records.reward.flatten().tolist() == [1 + 1 + 1, 8 + 8, 32 + 32]
    assert records.duration.flatten().tolist() == [3, 2, 2]
    assert records.start.flatten().tolist() == [0, 3, 5]
    assert records.end.flatten().tolist() == [2, 4, 6]
    assert records.done.flatten().tolist() == [False, True, False]
    assert records.terminated.flatten().tolist() == [False, True, False]
    assert records.valid.all()


def test_the_macro_level_bootstraps_with_the_discount_of_the_duration() -> None:
    # Two macro actions of 3 and 2 steps; the stream goes on after the second.
    reward, value = torch.tensor([[[3.0], [16.0]]]), torch.tensor([[[1.0], [2.0]]])
    next_value = torch.tensor([[[2.0], [4.0]]])
    no = torch.zeros(1, 2, 1, dtype=torch.bool)
    advantage, target = advantages(
        reward, value, next_value, no, no, 0.5, 0.8, torch.tensor([[[3], [2]]])
    )
    second = 16 + 0.5**2 * 4 - 2
    first = 3 + 0.5**3 * 2 - 1 + 0.5**3 * 0.8 * second
    assert advantage.flatten().tolist() == pytest.approx([first, second])
    assert target.flatten().tolist() == pytest.approx([first + 1, second + 2])


def test_the_time_limit_bootstraps_and_a_collision_does_not() -> None:
    reward, value = torch.tensor([[[1.0], [1.0]]]), torch.tensor([[[5.0], [7.0]]])
    next_value = torch.tensor([[[10.0], [20.0]]])
    done = torch.ones(1, 2, 1, dtype=torch.bool)
    collided = torch.tensor([[[False], [True]]])
    advantage, _ = advantages(reward, value, next_value, done, collided, 0.5, 0.8)
    assert advantage.flatten().tolist() == pytest.approx([1 + 0.5 * 10 - 5, 1 - 7])


def test_an_arrived_robot_ends_its_own_stream() -> None:
    steps = steps_of(
        macro_reward=[1, 15, 9, 9], due=[1, 0, 0, 0], driving=[1, 1, 0, 0], done=[0, 1, 0, 0],
        terminated=[0, 1, 0, 0],
    )  # fmt: skip
    records = macro_records(steps, discount=1.0)
    assert records.reward.flatten().tolist() == [16]
    assert records.terminated.all()


def test_a_timeout_is_bootstrapped_from_the_last_state_and_not_from_the_next_episode() -> None:
    model = policy()
    rollout = Rollout(
        Group(6, scenario=replace(SCENARIO, humans=0, time_limit=1.0)), model, 8, 0, 0.98, 0.5
    )
    batch: Batch = rollout.collect()
    # 1 s is 4 steps: everybody is still on the way.
    assert batch.ends.tolist() == [[e, t] for t in (3, 7) for e in range(6)]
    begins = batch.begins[:, 3:].view(6, 2, -1)[:, 0]
    assert begins[:, 4].all()  # and the next episode begins
    assert (batch.final_state.ego[..., 9] == 1.0).all()  # all time used up
    assert (batch.state.ego[:, 4, 9] == 0.0).all()
    assert not batch.steps.terminated[:, 3].any()
    assert batch.steps.done[:, 3].all()


def test_a_collision_ends_the_stream_of_the_robot_and_cuts_short_those_of_its_team() -> None:
    scenario = replace(SCENARIO, humans=10, circle_radius=4.0)
    rollout = Rollout(Group(32, scenario=scenario), policy(), 40, 0, 0.98, 0.5)
    steps = rollout.collect().steps
    alone = steps.terminated.sum(-1) == 1
    hit = steps.macro_reward <= -20.0
    cut = steps.done & ~steps.terminated
    assert (alone & hit.any(-1)).any()
    assert (steps.terminated[hit]).all()
    assert not hit[cut].any()
    assert cut[alone & hit.any(-1)].any()


def test_critics_see_everybody_with_their_goals() -> None:
    world = World(replace(SCENARIO, fov_degrees=30.0, sensing_range=1.0), 3)
    world.reset([0, 1, 2])
    state = state_of(world)
    assert state.humans_known.all()
    assert state.robots_known.all()
    goals = torch.linalg.vector_norm(state.humans[:, 0, :, 9:11] * 5.0, dim=-1).view(3, 2, 4)
    true = world.state.human_goal[:, None] - world.state.robot_position[:, :, None]
    np.testing.assert_allclose(goals, np.linalg.norm(true, axis=-1), rtol=1e-5)
    world.state.arrived[0, 1] = True
    assert state_of(world).robots[0, 0, 0, 11] == 1.0
    assert state_of(world).robots[1, 0, 0, 11] == 0.0


def test_an_update_learns_and_reports_what_it_did() -> None:
    model = policy()
    learner = Learner(model, replace(UPDATE, epochs=8, learning_rate=0.01))
    rollout = Rollout(Group(16, scenario=replace(SCENARIO, humans=0)), model, 16, 0, 0.98, 0.5)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    first = learner.update([rollout.collect()])
    assert all(np.isfinite(value) for value in first.values())
    changed = {n for n, v in model.state_dict().items() if not torch.equal(v, before[n])}
    for part in ("encoder", "critic_encoder", "macro_actor", "local_actor", "macro_critic"):
        assert any(name.startswith(part) for name in changed), part
    later = [learner.update([rollout.collect()])["losses/local_explained"] for _ in range(9)]
    assert max(later) > first["losses/local_explained"] + 0.3


def test_a_flat_agent_learns_without_waypoints() -> None:
    model = HierarchicalPolicy(replace(ARCHITECTURE, levels=1), 3)
    learner = Learner(model, UPDATE)
    rollout = Rollout(Group(16, scenario=replace(SCENARIO, humans=0)), model, 16, 0, 0.98, 0.5)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    batch = rollout.collect()
    assert not batch.steps.due.any()
    assert (batch.steps.waypoint == 0).all()
    assert torch.equal(batch.steps.local_reward, batch.steps.macro_reward)  # the task's own
    statistics = learner.update([batch])
    assert all(np.isfinite(value) for value in statistics.values())
    changed = {n for n, v in model.state_dict().items() if not torch.equal(v, before[n])}
    assert any(name.startswith("local_actor") for name in changed)
    assert not any(name.startswith("macro") for name in changed)


def test_with_a_narrow_view_progress_is_measured_on_the_way_round() -> None:
    model = policy()
    wide = replace(SCENARIO, humans=0, fov_degrees=180.0)
    narrow = replace(wide, fov_degrees=179.0)
    rewards = []
    for scenario in (wide, narrow):
        rollout = Rollout(Group(8, scenario=scenario), model, 4, 0, 0.98, 0.5)
        torch.manual_seed(1)
        rewards.append(rollout.collect().steps.macro_reward.mean())
    # They set out towards the goal, through the middle: that is no progress on the way round.
    assert rewards[0] > 0.05
    assert rewards[1] < -0.05


def test_robots_with_parameters_of_their_own_act_and_learn_as_they_trained() -> None:
    model = HierarchicalPolicy(replace(ARCHITECTURE, actors=2), 3)
    learner = Learner(model, UPDATE)
    rollout = Rollout(Group(12, scenario=SCENARIO), model, 10, 0, 0.98, 0.5)
    batch = rollout.collect()
    y = model.encode(batch.frames, batch.begins).view(12, 2, 10, -1).transpose(1, 2)
    robot = torch.arange(2).expand(y.shape[:3])
    log_prob = model.macro_actor.distribution(y, robot).log_prob(batch.steps.macro)
    torch.testing.assert_close(log_prob, batch.steps.macro_log_prob, atol=1e-4, rtol=0)
    assert all(np.isfinite(value) for value in learner.update([batch]).values())
    # What robot 0 does depends on its own parameters alone.
    world = World(SCENARIO)
    observation = world.reset([0])
    before = Deployed(model, SCENARIO).act(observation)
    with torch.no_grad():
        for module in (model.encoder, model.macro_actor, model.local_actor):
            for parameter in module.of[1].parameters():
                parameter.add_(0.1)
    after = Deployed(model, SCENARIO).act(observation)
    np.testing.assert_array_equal(after[:, 0], before[:, 0])
    assert (after[:, 1] != before[:, 1]).any()


def test_robots_with_parameters_of_their_own_must_be_so_many() -> None:
    model = HierarchicalPolicy(replace(ARCHITECTURE, actors=2), 3)
    with pytest.raises(ConfigurationError, match=r"scenario.robots is 3; it must be 2"):
        Deployed(model, replace(SCENARIO, robots=3))


def test_low_precision_is_close_and_learns() -> None:
    model = policy()
    rollout = Rollout(Group(12, scenario=SCENARIO), model, 10, 0, 0.98, 0.5)
    batch = rollout.collect()
    exact = model.encode(batch.frames, batch.begins)
    model.low_precision = True
    rough = model.encode(batch.frames, batch.begins)
    assert rough.dtype == torch.float32
    assert not torch.equal(rough, exact)
    torch.testing.assert_close(rough, exact, atol=0.1, rtol=0.1)
    assert all(np.isfinite(value) for value in Learner(model, UPDATE).update([batch]).values())


def test_commands_beyond_the_limits_cost_and_only_those() -> None:
    """5 m/s^2 for 0.25 s is 1.25 m/s; at 1 m/s a robot turns by up to 0.25 rad, standing by 15°."""
    cases = [  # speed, mean action, squared excess without slack
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
    found = excess(mean, torch.full_like(mean, 0.3), speed, SCENARIO, slack=0.0)
    assert found.tolist() == pytest.approx([c[2] for c in cases], abs=1e-6)
    forgiven = excess(mean[2:3], torch.full((1, 3), 0.2), speed[2:3], SCENARIO, slack=1.0)
    assert forgiven.item() == pytest.approx(0.1**2)
    holonomic = replace(SCENARIO, kinematics="holonomic")
    assert not excess(mean[:, :2], mean[:, :2], speed, holonomic, slack=0.0).any()


def test_the_mean_is_drawn_back_to_what_can_be_done() -> None:
    def mean_after(coefficient: float) -> float:
        model = policy()
        bias = model.local_actor.body[-1].bias
        with torch.no_grad():
            bias[0] = 1.5
        batch = Rollout(
            Group(8, scenario=replace(SCENARIO, humans=0)), model, 6, 0, 0.98, 0.5
        ).collect()
        update = replace(UPDATE, excess_coefficient=coefficient, learning_rate=0.01)
        learner = Learner(model, update)
        for _ in range(5):
            learner.update([batch])
        return bias[0].item()

    assert mean_after(10.0) < mean_after(0.0) - 0.02
