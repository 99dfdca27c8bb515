"""What is counted of how robots drive among people, in episodes small enough to do by hand."""

import math
from typing import Any

import numpy as np
import pytest
from staging import stage

from mrsan import Episodes, Kinematics, Outcome, World
from mrsan.kernels.tally import SOONEST_COLLISION
from mrsan.metrics import episodes_of

UNICYCLE: dict[str, Any] = {
    "kinematics": Kinematics.unicycle,
    "robot_speed": 1.0,
    "max_turn_rate": 360.0,
}
STAND, AHEAD, LEFT = [-1.0, 0.0], [1.0, 0.0], [1.0, 1.0]


def played(world: World, *actions: list[float]) -> Episodes:
    """The record of the one world after these actions of its one robot, or when it has ended."""
    for action in actions:
        world.step([[action]])
    return episodes_of(world.state, world.scenario, np.ones(1, bool))


def test_a_robot_that_stands_in_social_space() -> None:
    """Two metres lie between it and a person who stands as well."""
    world = stage([(0, 0, 0, 0, 5, 0)], [(2.6, 0, 0, 0)], time_limit=1.0, **UNICYCLE)
    record = played(world, *[STAND] * 4)
    assert record.standing_share.tolist() == record.social_share.tolist() == [[1.0]]
    assert record.personal_share.tolist() == record.close_share.tolist() == [[0.0]]
    assert record.heading_change.tolist() == [[0.0]]
    assert record.min_time_to_collision.tolist() == [[math.inf]]
    assert not record.robot_on_person[0]
    assert not record.person_on_robot[0]


def test_a_person_walks_into_a_robot_that_stands() -> None:
    """At 1 m/s from 2.6 m away: 2.35, 2.1, ... 0.1 m, and contact in the eleventh step."""
    world = stage([(0, 0, 0, 0, 5, 0)], [(3.2, 0, -1, 0)], **UNICYCLE)
    world.step([[STAND]])
    assert world.state.tally[0, 0, SOONEST_COLLISION] == pytest.approx(2.35, abs=1e-4)
    record = played(world, *[STAND] * 10)
    assert record.duration[0] == 11 * 0.25
    assert record.close_share[0, 0] == pytest.approx(3 / 11)  # 0.35, 0.1 and contact
    assert record.personal_share[0, 0] == pytest.approx(3 / 11)  # 1.1, 0.85, 0.6
    assert record.social_share[0, 0] == pytest.approx(5 / 11)
    assert record.standing_share[0, 0] == 1.0
    assert record.min_time_to_collision[0, 0] == 0.0
    assert record.outcome.tolist() == [[Outcome.hit_human]]
    assert (record.robot_on_person[0], record.person_on_robot[0]) == (False, True)


@pytest.mark.parametrize(
    ("human", "robot_did"),
    [
        ((2.0, 0, 0, 0), True),  # it stands
        ((2.0, 0, -0.5, 0), True),  # head-on, the robot is faster
        ((2.0, 0, -1.5, 0), False),  # head-on, the person is faster
        ((1.0, 0, 0.5, 0), True),  # from behind
        ((-1.0, 0, 1.5, 0), False),  # the person from behind
        # It comes abreast of the person, who is slower and walks into its side.
        ((1.0, 1.0, 0, -0.4), False),
    ],
)
def test_who_ran_into_whom(human: tuple[float, ...], robot_did: bool) -> None:
    """A robot at 1 m/s; what counts are the velocities along the line of centres."""
    world = stage([(0, 0, 0, 1, 9, 0)], [human], **UNICYCLE)
    record = played(world, *[AHEAD] * 16)
    assert record.outcome.tolist() == [[Outcome.hit_human]]
    assert (record.robot_on_person[0], record.person_on_robot[0]) == (robot_did, not robot_did)


def test_a_robot_that_drives_a_square() -> None:
    """East, north, west and south, with its goal in the east."""
    world = stage([(0, 0, 0, 1, 10, 0)], time_limit=1.0, **UNICYCLE)
    record = played(world, AHEAD, LEFT, LEFT, LEFT)
    np.testing.assert_allclose(world.state.robot_position[0, 0], [0, 0], atol=1e-6)
    assert record.heading_change[0, 0] == pytest.approx(3 * math.pi / 2, abs=1e-5)
    assert record.standing_share[0, 0] == 0.0
    assert record.path_length[0, 0] == pytest.approx(1.0, abs=1e-5)
