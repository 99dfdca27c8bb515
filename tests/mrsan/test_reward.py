"""SAMARL, Eq. 10, on states small enough to do by hand.

A robot at the origin that drives at 1 m/s along x and does not act is 0.25 m further on after one
step; discs have radius 0.3 m.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from staging import stage

from mrsan import Outcome, Reward, RewardParts, Scenario, World

COAST = [0.0, 0.0, 0.0]
BRAKE = [-1.0, 0.0, 0.0]
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


def test_driving_past_the_goal_costs() -> None:
    aside = round(2 * (4 - math.hypot(4, 0.25)), 4)
    assert rewards(stage([(0, 0, 0, 1, 0, 4)]), COAST) == [aside]


def test_the_reward_is_that_of_the_action_taken() -> None:
    """From one state: braking moves the robot 0.125 m, coasting 0.25 m."""
    assert rewards(stage([DRIVER]), BRAKE) == [0.25]
    assert rewards(stage([DRIVER]), COAST) == [0.5]


@pytest.mark.parametrize(
    ("gap", "expected"),
    [(0.46, 0.5), (0.44, -1 / 0.44), (0.3, -1 / 0.3), (0.21, -1 / 0.21), (0.19, -5), (0.01, -5)],
)
def test_discomfort_is_minus_one_over_the_gap_after_the_step(gap: float, expected: float) -> None:
    world = stage([DRIVER], [(0.25 + 0.6 + gap, 0, 0, 0)])
    assert rewards(world, COAST) == [pytest.approx(expected, rel=2e-4)]


def test_discomfort_counts_people_out_of_sight() -> None:
    world = stage([DRIVER], [(0.25 - 0.6 - 0.3, 0, 0, 0)], fov_degrees=90.0)
    assert not world.observe().humans_visible.any()
    assert rewards(world, COAST) == [pytest.approx(-1 / 0.3, rel=2e-4)]


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


@pytest.mark.parametrize(("reward", "expected"), [(Reward(), [15, 15]), (LITERAL, [5, 5])])
def test_two_that_arrive_together_are_both_last(reward: Reward, expected: list[float]) -> None:
    world = stage([FINISHER, (0, 5, 0, 1, 0.5, 5)], reward=reward)
    assert rewards(world, COAST, COAST) == expected


def test_who_collides_at_its_goal_has_not_arrived() -> None:
    world = stage([FINISHER], [(0.6, 0, 0, 0)])
    assert rewards(world, COAST) == [-20]
    assert not world.state.arrived[0, 0]


def test_arrival_within_a_radius_of_the_goal() -> None:
    """After the step the robot is at x = 0.25; its goal is 0.29 or 0.31 m on."""
    assert rewards(stage([(0, 0, 0, 1, 0.54, 0)]), COAST) == [15]
    assert rewards(stage([(0, 0, 0, 1, 0.56, 0)]), COAST) == [0.5]


def test_a_parked_robot_is_paid_nothing_while_others_drive() -> None:
    """Not even with a human at its side."""
    world = stage([(0, 5, 0, 0, 0, 5), DRIVER], [(0, 5.7, 0, 0)], arrived=[0])
    assert rewards(world, COAST, COAST) == [0, 0.5]


def test_a_human_that_walks_into_a_parked_robot_does_not_count() -> None:
    world = stage([(0, 5, 0, 0, 0, 5), DRIVER], [(0.5, 5, -1, 0)], arrived=[0])
    assert rewards(world, COAST, COAST) == [0, 0.5]
    assert not world.state.done[0]
    assert not world.state.collision.any()


def test_a_robot_that_drives_into_a_parked_one_collides_alone() -> None:
    world = stage([DRIVER, (0.8, 0, 0, 0, 0.8, 0)], arrived=[1])
    assert rewards(world, COAST, COAST) == [-20, 0]
    assert world.state.terminated[0]
    assert world.state.collision[0].tolist() == [Outcome.hit_robot, 0]
    assert world.state.arrived[0].tolist() == [False, True]


def test_a_robot_parks_by_braking() -> None:
    """From 1 m/s at 5 m/s^2 it stands within one step, whatever its action says."""
    world = stage([FINISHER, (0, 5, 0, 1, 9, 5)])
    world.step([[COAST, COAST]])
    world.step([[[1, 1, 1], COAST]])
    np.testing.assert_allclose(world.state.robot_position[0, 0], [0.375, 0], atol=1e-6)
    world.step([[[1, 1, 1], COAST]])
    np.testing.assert_allclose(world.state.robot_position[0, 0], [0.375, 0], atol=1e-6)
    assert world.state.robot_heading[0, 0] == 0


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


def test_the_defaults_are_the_papers() -> None:
    r = Scenario().reward
    assert (r.arrival, r.team, r.collision, r.progress) == (10, 5, -20, 2)
    assert (r.discomfort, r.discomfort_limit, r.discomfort_distance) == (1, -5, 0.45)
    assert (r.goal_distance, r.time) == (0, 0)
