"""SAMARL, Eq. 10, on states small enough to do by hand.

A robot at the origin that drives at 1 m/s along x and does not act is 0.25 m further on after one
step; discs have radius 0.3 m.
"""

from dataclasses import replace

import numpy as np
import pytest
from staging import stage

from mrsan import Outcome, Reward, RewardParts, Scenario, World

COAST = [0.0, 0.0, 0.0]
DRIVER = (0, 0, 0, 1, 4, 0)  # 4 m before its goal
FINISHER = (0, 0, 0, 1, 0.5, 0)  # 0.25 m from its goal after the step: arrived
LITERAL = Reward(literal=True)


def rewards(world: World, *actions: list[float]) -> list[float]:
    return [round(float(r), 4) for r in world.step([list(actions)]).reward[0]]


def parts(world: World, *actions: list[float]) -> list[dict[str, float]]:
    """What is paid to each robot for what; only what is not zero."""
    paid = world.step([list(actions)]).reward_parts
    return [
        {name: round(float(part[0, i]), 4) for name, part in paid._asdict().items() if part[0, i]}
        for i in range(len(actions))
    ]


def test_progress_pays_twice_the_decrease_of_the_distance() -> None:
    assert rewards(stage([DRIVER]), COAST) == [0.5]  # 2 (4 - 3.75)


@pytest.mark.parametrize(
    ("gap", "expected"),
    [(0.46, 0.5), (0.44, -1 / 0.44), (0.3, -1 / 0.3), (0.21, -1 / 0.21), (0.19, -5), (0.01, -5)],
)
def test_discomfort_is_minus_one_over_the_gap_after_the_step(gap: float, expected: float) -> None:
    world = stage([DRIVER], [(0.25 + 0.6 + gap, 0, 0, 0)])
    assert rewards(world, COAST) == [pytest.approx(expected, rel=2e-4)]


@pytest.mark.parametrize("literal", [False, True])
def test_a_collision_costs_whom_it_happens_to(literal: bool) -> None:
    """Its team-mate is paid for its own step, and the episode is over for both."""
    world = stage([DRIVER, (0, 5, 0, 1, 4, 5)], [(0.5, 0, 0, 0)], reward=Reward(literal=literal))
    assert rewards(world, COAST, COAST) == [-20, 0.5]
    assert world.state.terminated[0]
    assert world.state.collision[0].tolist() == [Outcome.hit_human, 0]


@pytest.mark.parametrize("literal", [False, True])
def test_arrival_pays_ten_while_others_are_on_their_way(literal: bool) -> None:
    world = stage([FINISHER, (0, 5, 0, 1, 4, 5)], reward=Reward(literal=literal))
    assert rewards(world, COAST, COAST) == [10, 0.5]
    assert world.state.arrived[0].tolist() == [True, False]
    assert not world.state.done[0]


@pytest.mark.parametrize(("reward", "expected"), [(Reward(), [15, 5]), (LITERAL, [5, 5])])
def test_the_last_arrival_pays_the_team(reward: Reward, expected: list[float]) -> None:
    world = stage([FINISHER, (0, 5, 0, 0, 0, 5)], arrived=[1], reward=reward)
    assert rewards(world, COAST, COAST) == expected
    assert world.state.terminated[0]


@pytest.mark.parametrize("literal", [False, True])
def test_what_a_step_is_paid_for(literal: bool) -> None:
    reward, beside = Reward(literal=literal), (0, 5, 0, 1, 4, 5)
    drives = {"progress": 0.5}
    assert parts(stage([DRIVER], reward=reward), COAST) == [drives]
    near = stage([DRIVER], [(0.25 + 0.6 + 0.4, 0, 0, 0)], reward=reward)
    assert parts(near, COAST) == [{"discomfort": -2.5}]  # -1 / 0.4
    crash = stage([DRIVER, beside], [(0.5, 0, 0, 0)], reward=reward)
    assert parts(crash, COAST, COAST) == [{"collision": -20}, drives]
    assert parts(stage([FINISHER, beside], reward=reward), COAST, COAST) == [
        {"arrival": 10},
        drives,
    ]
    parked = stage([(0, 5, 0, 0, 0, 5), DRIVER], arrived=[0], reward=reward)
    assert parts(parked, COAST, COAST) == [{}, drives]


@pytest.mark.parametrize(
    ("reward", "last"), [(Reward(), {"arrival": 10, "team": 5}), (LITERAL, {"team": 5})]
)
def test_every_robot_gets_the_teams_bonus_when_the_last_arrives(
    reward: Reward, last: dict[str, float]
) -> None:
    """In Eq. 10 it is of all robots, also of those that have been parked for long."""
    parked = [(0, 5, 0, 0, 0, 5), (0, -5, 0, 0, 0, -5)]
    world = stage([parked[0], FINISHER, parked[1]], arrived=[0, 2], reward=reward)
    assert parts(world, COAST, COAST, COAST) == [{"team": 5}, last, {"team": 5}]
    assert parts(world, COAST, COAST, COAST) == [{}, {}, {}]  # the episode is over


@pytest.mark.parametrize(
    "reward",
    [
        Reward(goal_distance=0.3, time=-0.01),
        Reward(literal=True, goal_distance=1.1, time=0.2),
        Reward(arrival=3.3, team=0.7, progress=-1, goal_distance=3.0, time=-0.7),
    ],
)
@pytest.mark.parametrize("lookahead", [0.0, 0.3])
def test_the_parts_add_up_to_the_reward_exactly(reward: Reward, lookahead: float) -> None:
    """Robots that drive to their goals, and one in four at random; every part comes up."""
    rng, worlds = np.random.default_rng(0), 200
    reward = replace(reward, lookahead=lookahead)
    scenario = Scenario(robots=2, humans=4, circle_radius=3.0, goal_distance=2.0, reward=reward)
    world = World(scenario, worlds, auto_reset=True)
    observation, paid = world.reset(np.arange(worlds)), np.zeros(len(RewardParts._fields), bool)
    for _ in range(80):
        bearing = np.arctan2(observation.ego[..., 1], observation.ego[..., 0])
        action = np.stack([np.full_like(bearing, 0.2), 0 * bearing, np.clip(bearing, -1, 1)], -1)
        action[::4] = rng.uniform(-1, 1, action[::4].shape)
        step = world.step(action)
        observation = step.observation
        assert all(p.dtype == np.float32 and p.shape == (worlds, 2) for p in step.reward_parts)
        np.testing.assert_array_equal(sum(step.reward_parts), step.reward)
        paid |= np.any(step.reward_parts, axis=(1, 2))
    assert paid.tolist() == [*[True] * 7, lookahead > 0, False]  # the last: custom terms


def test_every_weight_is_configurable() -> None:
    reward = Reward(
        arrival=3,
        team=4,
        collision=-7,
        discomfort=0.5,
        discomfort_limit=-2,
        discomfort_distance=0.6,
        progress=8,
        goal_distance=5,
        time=-0.5,
    )
    beside = -0.5 - 5 * 3.75 / 25  # 3.75 m from its goal in a circle of radius 5 m
    assert rewards(stage([DRIVER], reward=reward), COAST) == [2 + beside]
    assert rewards(stage([FINISHER], reward=reward), COAST) == [7 - 0.5 - 5 * 0.25 / 25]
    assert rewards(stage([DRIVER], [(0.5, 0, 0, 0)], reward=reward), COAST) == [-7]
    assert rewards(stage([DRIVER], [(1.35, 0, 0, 0)], reward=reward), COAST) == [-1 + beside]
    assert rewards(stage([DRIVER], [(0.95, 0, 0, 0)], reward=reward), COAST) == [-2 + beside]
