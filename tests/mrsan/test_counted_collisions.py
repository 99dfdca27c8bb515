"""Where collisions do not end the episode (MSA3C): what is counted and paid, by hand.

Discs have radius 0.3 m, a step is 0.25 s; the robot drives along x at 1 m/s.
"""

from typing import Any

import numpy as np
import pytest
from staging import stage

from mrsan import Episodes, Kinematics, Outcome, Reward, Scenario, World
from mrsan.metrics import episodes_of

AHEAD, STAND = [1.0, 0.0], [0.0, 0.0]
DRIVER = (0, 0, 0, 0, 8, 0)
ONLY_COLLISIONS = Reward(progress=0.0, discomfort=0.0)


def counted(robots: list, humans: Any = (), arrived: Any = (), **fields: Any) -> World:
    fields = {"kinematics": Kinematics.holonomic, "terminate_on_collision": False, **fields}
    return stage(robots, humans, arrived, **fields)


def records(world: World) -> Episodes:
    return episodes_of(world.state, world.scenario, np.ones(1, bool))


def drive(world: World, *actions: list[float], steps: int) -> list[list[float]]:
    return [world.step([list(actions)]).reward[0].tolist() for _ in range(steps)]


def test_a_lasting_contact_counts_once_and_costs_in_every_step() -> None:
    """The person stands at x = 1: they touch from x = 0.4 to 1.6, in the steps that end at 0.5 to
    1.75 (the last of them begins inside)."""
    world = counted([DRIVER], [(1, 0, 0, 0)], reward=ONLY_COLLISIONS)
    paid = [reward for (reward,) in drive(world, AHEAD, steps=9)]
    assert paid == [0, -20, -20, -20, -20, -20, -20, 0, 0]
    assert not world.state.done[0]
    assert world.state.collision[0].tolist() == [Outcome.hit_human]
    assert records(world).contacts.tolist() == [[1]]


def test_who_comes_back_is_a_contact_anew() -> None:
    """It steps in and out of reach three times, with a step apart between."""
    world = counted([(0, 0, 0, 0, 8, 0)], [(0.8, 0, 0, 0)])
    for _ in range(3):
        heading = world.state.robot_heading[0, 0]
        assert heading == pytest.approx(0, abs=1e-6)
        world.step([[AHEAD]])  # to 0.25: they touch
        world.step([[[-1.0, 0.0]]])  # back to 0: they still do at the beginning of the step
        world.step([[STAND]])  # apart
        world.state.robot_heading[0, 0] = 0.0
    assert records(world).contacts.tolist() == [[3]]


def test_two_robots_that_meet_are_one_collision() -> None:
    """Each is paid for it and has half of the count; of one that has parked it is all one's own."""
    world = counted([DRIVER, (1, 0, np.pi, 0, -8, 0)], reward=ONLY_COLLISIONS)
    assert drive(world, AHEAD, AHEAD, steps=2) == [[-20, -20], [-20, -20]]
    assert records(world).contacts.tolist() == [[0.5, 0.5]]
    assert (records(world).outcome == Outcome.hit_robot).all()
    world = counted([DRIVER, (0.8, 0, 0, 0, 0.8, 0)], arrived=[1], reward=ONLY_COLLISIONS)
    assert drive(world, AHEAD, AHEAD, steps=2) == [[-20, 0], [-20, 0]]
    assert records(world).contacts.tolist() == [[1, 0]]


def test_it_arrives_whatever_it_hit() -> None:
    """All robots arrived in time, but it is no success, which is without collisions."""
    world = counted([(0, 0, 0, 0, 2, 0)], [(1, 0, 0, 0)])
    for _ in range(6):
        world.step([[AHEAD]])
        assert not world.state.done[0]
    step = world.step([[AHEAD]])  # to 1.75, less than a radius from 2
    assert (bool(step.terminated[0]), bool(step.truncated[0])) == (True, False)
    record = records(world)
    assert record.arrived.all()
    assert record.steps.tolist() == [7]
    assert record.outcome.tolist() == [[Outcome.hit_human]]
    assert not record.success[0]


def test_steps_in_the_comfort_zone() -> None:
    """Past a person 0.8 m aside, whose zone reaches to 0.85 m from centre to centre: within it at
    |x| < 0.287, at the ends of the steps to 0.75, 1.0 and 1.25 with the person at x = 1."""
    world = counted([DRIVER], [(1, 0.8, 0, 0)])
    drive(world, AHEAD, steps=10)
    assert records(world).comfort_share[0, 0] == pytest.approx(3 / 10)
    assert records(world).contacts.tolist() == [[0]]


def test_msa3cs_reward_by_hand() -> None:
    """Its Eq. 2 without the look ahead, with R = 5 m."""
    reward = Reward(
        arrival=0.0,
        team=0.0,
        progress=0.0,
        collision=-1.0,
        discomfort_limit=-0.5,
        discomfort_distance=0.25,
        goal_distance=1.0,
        time=-0.001,
    )
    far = counted([DRIVER], reward=reward)
    assert drive(far, AHEAD, steps=2) == [
        [pytest.approx(-7.75 / 25 - 0.001)],
        [pytest.approx(-7.5 / 25 - 0.001)],
    ]
    near = counted([DRIVER], [(0.25 + 0.6 + 0.24, 0, 0, 0)], reward=reward)
    assert drive(near, AHEAD, steps=1) == [[pytest.approx(-7.75 / 25 - 0.001 - 0.5)]]
    crash = counted([DRIVER], [(0.8, 0, 0, 0)], reward=reward)
    assert drive(crash, AHEAD, steps=1) == [[-1]]
    last = counted([(0, 0, 0, 0, 0.5, 0)], reward=reward)
    assert drive(last, AHEAD, steps=1) == [[pytest.approx(-0.25 / 25 - 0.001)]]
    parked = counted([DRIVER, (0, 5, 0, 0, 0, 5)], arrived=[1], reward=reward)
    assert drive(parked, AHEAD, AHEAD, steps=1)[0][1] == 0


def test_people_change_goals_with_probabilities_of_their_own() -> None:
    """Drawn from 0 to 1, the shares of changes have the spread of a uniform number, not of a
    binomial one: variances of 1/12 + 1/6/n and 1/4/n."""
    changes, people, worlds = 8, 4, 400
    scenario = Scenario(
        robots=1,
        humans=people,
        goal_change_interval=0.25,
        goal_change_probability=0.0,
        goal_change_probability_max=1.0,
        human_speed_min=0.05,
        human_speed_max=0.05,
    )
    world = World(scenario, worlds)
    world.reset(np.arange(worlds))
    world.step(np.zeros((worlds, 1, 3), np.float32))  # at the start nobody does
    changed = np.zeros((worlds, people))
    for _ in range(changes):
        before = world.state.human_goal.copy()
        world.step(np.zeros((worlds, 1, 3), np.float32))
        changed += (world.state.human_goal != before).any(-1)
    share = changes and changed / changes
    assert share.mean() == pytest.approx(0.5, abs=5 * np.sqrt((1 / 12 + 1 / 6 / 8) / share.size))
    assert share.var() == pytest.approx(1 / 12 + 1 / 6 / changes, rel=0.1)
