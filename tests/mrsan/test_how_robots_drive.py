"""What is counted of how robots drive among people, in episodes small enough to do by hand."""

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
STAND, AHEAD = [-1.0, 0.0], [1.0, 0.0]


def played(world: World, *actions: list[float]) -> Episodes:
    """The record of the one world after these actions of its one robot, or when it has ended."""
    for action in actions:
        world.step([[action]])
    return episodes_of(world.state, world.scenario, np.ones(1, bool))


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
