"""CADRL: the command it takes, the least over pairs, and what a value is regressed on."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from mrsan import Observation, Scenario, World
from samarl.agents import build_agent
from samarl.agents.learned import Learned
from samarl.algorithms import ALGORITHMS
from samarl.algorithms.value_learning import ValueLearning, samples_of
from samarl.configuration import load_agent_config
from samarl.observations.features import frames_of
from samarl.planning.one_step import command_set
from samarl.policies.card import LAST
from samarl.policies.checkpoint import make_policy
from samarl.policies.lookahead import LookaheadPolicy
from samarl.rollout import Rollout
from samarl.training.curriculum import CurriculumStage
from samarl.training.trainer import Trainer
from tests.learning import VALUE_NUMBERS, policy_numbers, trainer_config
from tests.scenes import COMMANDS, blind, known, scene_of


def lookahead(action_size: int = 3, encoder: str = "pairwise", **changes: Any) -> LookaheadPolicy:
    torch.manual_seed(0)
    numbers = policy_numbers("lookahead", encoder, **changes)
    policy = make_policy(numbers.pop("name"), numbers, action_size)
    assert isinstance(policy, LookaheadPolicy)
    return policy


def learner(of: LookaheadPolicy, **changes: Any) -> ValueLearning:
    numbers = {"name": "value_learning", **VALUE_NUMBERS, **changes}
    algorithm = ALGORITHMS["value_learning"].cls(of, ALGORITHMS.config(numbers))
    assert isinstance(algorithm, ValueLearning)
    return algorithm


# The policy


def flattened(policy: LookaheadPolicy) -> None:
    """Every state is worth the same: what counts is the reward of the step."""
    with torch.no_grad():
        for network in policy.networks:
            for parameter in network.parameters():
                parameter.zero_()


def test_without_a_value_it_takes_the_step_that_is_paid_best() -> None:
    scenario = Scenario(robots=1, humans=1)
    policy = lookahead()
    flattened(policy)
    for aside, expected in ((3.0, [1.0, 0.0, 0.0]), (0.0, [-1.0, 0.0])):
        # Somebody stands 0.9 m ahead, and 3 m to the left or not: full speed, or none.
        tracks = scene_of([[0.9, aside, -0.2, 0.0, 0.3]], (4.0, 0.0), 0.2, scenario)
        chosen, _ = policy._best(tracks, np.ones((1, 1), np.bool_), scenario, 0.0)
        assert chosen[0, : len(expected)].tolist() == expected


def test_it_explains_the_value_of_what_it_does(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = Scenario(robots=1, humans=0)
    policy = lookahead()
    # The reward of the step, which is known without people, and 7 afterwards.
    monkeypatch.setattr(policy, "value", lambda frames, rows: torch.full((len(rows),), 7.0))
    world = World(scenario)
    observation, state = world.reset([3]), policy.initial_state(1, scenario)
    decision = policy.act(observation, state, np.ones(1, np.bool_), scenario)
    value = policy.explain(decision).value
    assert value is not None
    reward = world.step(decision.action).reward
    np.testing.assert_allclose(value, reward + policy.config.discount * 7.0, atol=1e-4)


def test_it_drives_to_what_is_worth_more_and_only_who_is_on_the_way() -> None:
    scenario = Scenario(robots=2, humans=0)
    policy = lookahead()
    flattened(policy)
    world = World(scenario, 3)
    observation = world.reset([0, 1, 2])
    state = policy.initial_state(3, scenario)
    active = np.array([[True, False], [False, True], [True, True]])
    decision = policy.act(observation, state, np.ones(3, np.bool_), scenario, None, active)
    assert (decision.action != 0).any(-1).tolist() == active.tolist()
    assert decision.levels["local"].decided.tolist() == active.tolist()
    encoder = policy.networks[0].encoder
    with torch.no_grad():  # the goal had better be to the left: it turns to the right
        for own, values in ((encoder.own, encoder.pair), (encoder.own_alone, encoder.alone)):
            own.weight[0, 1] = values[1].weight[0, 0] = 1.0
            values[3].weight[0, 0] = 1e3
    turns = policy.act(observation, state, np.zeros(3, np.bool_), scenario).action[..., 2]
    assert (turns == -1.0).all()


def test_it_imitates_orca_and_explores_with_epsilon() -> None:
    scenario = Scenario(robots=2, humans=5)
    policy = lookahead()
    world = World(scenario, 50)
    observation = world.reset(np.arange(50))
    state, begins = policy.initial_state(50, scenario), np.ones(50, np.bool_)
    policy.imitating = True
    orca = build_agent(load_agent_config("orca"), scenario).act(observation)
    action = policy.act(observation, state, begins, scenario, 0.0).action
    np.testing.assert_array_equal(action, orca)
    greedy = policy.act(observation, state, begins, scenario).action
    assert (greedy != orca).any()
    policy.imitating, policy.epsilon = False, 1.0
    action = policy.act(observation, state, begins, scenario, 0.0).action
    commands = command_set(COMMANDS, scenario.kinematics)
    number = (action[:, :, None] == commands).all(-1)
    assert (number.sum(-1) == 1).all()
    assert len(np.unique(number.argmax(-1))) > 20
    policy.epsilon = 0.0
    action = policy.act(observation, state, begins, scenario, 0.0).action
    np.testing.assert_array_equal(action, greedy)


# The encoder


def test_a_value_is_the_least_over_pairs() -> None:
    policy = lookahead(encoder_numbers={"name": "pairwise", "width": 32})
    scenario = Scenario(robots=3, humans=4)
    world = World(scenario, 20)
    frames = frames_of(known(world.reset(np.arange(20)), scenario), scenario)
    rows = torch.arange(60)
    alone = []
    for part, count in (("humans_known", 4), ("robots_known", 2)):
        for j in range(count):
            only = blind(frames)
            only.arrays("known")[part][..., j] = True
            here = frames.arrays("known")[part][:, 0, j]
            assert here.any()
            alone.append(torch.where(here, policy.value(only, rows), torch.inf))
    torch.testing.assert_close(policy.value(frames, rows), torch.stack(alone).amin(0))
    assert len(torch.stack(alone).argmin(0).unique()) > 2
    encoder, ego = policy.networks[0].encoder, frames.ego[:, 0]
    by_itself = encoder.alone(encoder.own_alone(torch.cat([ego, ego], -1)))[:, 0]
    torch.testing.assert_close(policy.value(blind(frames), rows), 10.0 * by_itself)


# What is learned


def rollout_of(
    active: list[list[list[bool]]],
    reward: list[list[list[float]]],
    done: list[list[bool]],
    terminated: list[list[list[bool]]],
    ego: torch.Tensor | None = None,
    mask: list[list[bool]] | None = None,
    humans: int = 2,
) -> Rollout:
    """S sequences of T steps, and the step after them, of N robots; [S, T + 1, (N)]."""
    on_way = torch.tensor(active)
    s, t, n = on_way.shape
    counts = torch.ones(s, t, dtype=torch.bool) if mask is None else torch.tensor(mask)
    steps = TensorDict(
        {
            "mask": counts.unsqueeze(-1),
            "agents": {"active_mask": on_way},
            "next": {
                "done": torch.tensor(done).unsqueeze(-1),
                "agents": {
                    "reward": torch.tensor(reward),
                    "terminated": torch.tensor(terminated),
                },
            },
        },
        [s, t],
    )
    if ego is None:  # says which robot, which sequence and which step a frame is of
        ego = torch.zeros(s * n, t, 11)
        ego[..., 0] = torch.arange(t)
        ego[..., 1] = torch.arange(s * n).unsqueeze(1)
    frames = Observation.from_arrays(
        {
            "ego": ego,
            "humans": torch.zeros(s * n, t, humans, 10),
            "humans_known": torch.zeros(s * n, t, humans, dtype=torch.bool),
            "robots": torch.zeros(s * n, t, n - 1, 10),
            "robots_known": torch.zeros(s * n, t, n - 1, dtype=torch.bool),
        }
    )
    scenario = Scenario(robots=n, humans=humans)
    begins = torch.zeros(s * n, t, dtype=torch.bool)
    return Rollout(scenario, 0.0, steps, frames, begins, ({},), None, [], s * t)


def test_what_a_value_is_regressed_on() -> None:
    o, x = True, False
    rollout = rollout_of(
        # Robot 0 arrives in step 1, robot 1 hits somebody in step 2 and begins anew. In the second
        # sequence time is up in step 1; in the third robot 1's collision cuts robot 0's way short,
        # and the first step is not of this sequence.
        active=[
            [[o, o], [o, o], [x, o], [o, o]],
            [[o, o], [o, o], [o, o], [o, o]],
            [[o, o], [o, o], [o, o], [o, o]],
        ],
        reward=[
            [[1.0, 2.0], [10.0, 3.0], [0.0, -20.0], [9.0, 9.0]],
            [[4.0, 5.0], [9.0, 9.0], [6.0, 7.0], [9.0, 9.0]],
            [[9.0, 9.0], [8.0, 0.5], [9.0, -20.0], [9.0, 9.0]],
        ],
        done=[[x, x, o, x], [x, o, x, x], [x, x, o, x]],
        terminated=[
            [[x, x], [x, x], [x, o], [x, x]],
            [[x, x], [x, x], [x, x], [x, x]],
            [[x, x], [x, x], [x, o], [x, x]],
        ],
        mask=[[o, o, o, o], [o, o, o, o], [x, o, o, o]],
    )
    samples = samples_of(rollout)
    now, then = (samples[name, "ego"][:, 0] for name in ("now", "next"))
    assert (then[:, 0] == now[:, 0] + 1).all()
    assert (then[:, 1] == now[:, 1]).all()
    assert (samples["robot"] == now[:, 1] % 2).all()
    transitions = {
        (int(row) // 2, int(step), int(row) % 2): (float(r), bool(goes_on))
        for step, row, r, goes_on in zip(
            now[:, 0], now[:, 1], samples["reward"], samples["continues"], strict=True
        )
    }
    assert transitions == {
        (0, 0, 0): (1.0, True),
        (0, 0, 1): (2.0, True),
        (0, 1, 0): (10.0, False),
        (0, 1, 1): (3.0, True),
        (0, 2, 1): (-20.0, False),
        (1, 0, 0): (4.0, True),
        (1, 0, 1): (5.0, True),
        (1, 2, 0): (6.0, True),
        (1, 2, 1): (7.0, True),
        (2, 1, 0): (8.0, True),
        (2, 1, 1): (0.5, True),
        (2, 2, 1): (-20.0, False),
    }
    algorithm = learner(lookahead())
    with torch.no_grad():
        for parameter in algorithm.policy.parameters():
            parameter.mul_(2.0)  # only the target network counts
    later = algorithm.target.value(Observation.from_arrays(samples["next"]), samples["robot"])
    expected = torch.tensor(
        [r + 0.9 * float(v) * g for (r, g), v in zip(transitions.values(), later, strict=True)]
    )
    torch.testing.assert_close(algorithm.targets(samples), expected)


def test_values_come_to_what_the_behaviour_is_paid_from_there_on() -> None:
    """Three states in a row: the discounted sums in plain Python."""
    rewards, discount = [1.0, -2.0, 10.0], 0.9
    expected = [sum(discount**k * r for k, r in enumerate(rewards[i:])) for i in range(3)]
    ego = torch.zeros(1, 4, 11)
    ego[0, :3, :3] = torch.eye(3)
    rollout = rollout_of(
        active=[[[True]] * 4],
        reward=[[[r] for r in [*rewards, 0.0]]],
        done=[[False, False, True, False]],
        terminated=[[[False], [False], [True], [False]]],
        ego=ego,
    )
    algorithm = learner(lookahead(), learning_starts=1, updates=50, learning_rate=3e-3)
    for _ in range(25):
        statistics = algorithm.update([rollout])
    frames = rollout.frames.apply(lambda tensor: tensor.transpose(0, 1)[:3])
    value = algorithm.policy.value(frames, torch.zeros(3, dtype=torch.long))
    assert value.tolist() == pytest.approx(expected, abs=0.05)
    assert statistics["losses/value"] < 0.01
    assert statistics["losses/mean_target"] == pytest.approx(sum(expected) / 3, abs=0.5)


STAGES = [
    CurriculumStage(6, 0.0, 0.5, scenario=Scenario(humans=3, humans_min=0, robots=2)),
    CurriculumStage(6, 0.4, 1.0, 0.0, 1.0, 0.75, Scenario(humans=6, robots=3, circle_radius=4.0)),
]


def trainer(folder: Path) -> Trainer:
    policy = policy_numbers("lookahead", "pairwise")
    algorithm = {"name": "value_learning", **VALUE_NUMBERS}
    return Trainer(folder, trainer_config(2400, 20), policy, algorithm, STAGES, "test")


def test_a_run_learns_goes_on_and_its_policy_drives(tmp_path: Path) -> None:
    first = trainer(tmp_path)
    first.algorithm.set_progress(0.0)
    for _ in range(10):  # past the change of stages
        row = first.round()
        assert all(math.isfinite(value) for value in row.values())
    first.save()
    first.run_dir.release()
    again = trainer(tmp_path)
    assert again.steps_done == first.steps_done
    for module, same in ((first.algorithm, again.algorithm), (first.policy, again.policy)):
        for key, value in module.state_dict().items():
            assert torch.equal(value, same.state_dict()[key]), key
    assert isinstance(again.algorithm, ValueLearning)
    assert len(again.algorithm.replay) == 0  # it is not saved; the next steps do not depend on it
    actions, random = [], torch.get_rng_state()
    for of in (first, again):
        of.algorithm.set_progress(of.steps_done / of.config.steps)
        torch.set_rng_state(random)
        (rollout,) = of.collect().values()
        actions.append(rollout.steps["agents", "action"])
    assert torch.equal(*actions)
    again.run_dir.release()
    trainer(tmp_path).run()
    scenario = STAGES[1].scenario
    agent, world = Learned(scenario, str(tmp_path / LAST)), World(scenario, 2)
    observation = world.reset([0, 1])
    commands = command_set(COMMANDS, scenario.kinematics)
    for _ in range(4):
        action = agent.act(observation)
        assert (action[:, :, None] == commands).all(-1).any(-1).all()
        observation = world.step(action).observation
