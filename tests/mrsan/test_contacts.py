"""Collisions count over the whole step, not only at its end."""

import math

import numpy as np
import pytest
from staging import stage

from mrsan import Kinematics
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.tally import CLOSEST_HUMAN
from mrsan.metrics import Outcome

# One second at ten metres a second: both agents are far apart at both ends of the step.
FAST = {"time_step": 1.0, "robot_speed": 10.0, "kinematics": Kinematics.unicycle}
AHEAD = [1.0, 0.0]


@pytest.mark.parametrize(("aside", "hit"), [(0.0, True), (0.59, True), (0.61, False)])
def test_a_robot_and_a_human_that_swap_places_have_met(aside: float, hit: bool) -> None:
    """The discs of radius 0.3 touch when they pass within 0.6 m."""
    world = stage([(0, 0, 0, 10, 99, 99)], [(10, aside, -10, 0)], **FAST)
    step = world.step([[AHEAD]])
    state = world.state
    np.testing.assert_allclose(state.robot_position[0, 0], [10, 0], atol=1e-4)
    np.testing.assert_allclose(state.human_position[0, 0], [0, aside], atol=1e-4)
    assert bool(step.terminated[0]) is hit
    assert state.collision[0, 0] == (Outcome.hit_human if hit else 0)
    assert state.tally[0, 0, CLOSEST_HUMAN] == pytest.approx(aside - 0.6, abs=1e-4)


@pytest.mark.parametrize(("aside", "hit"), [(0.0, True), (0.59, True), (0.61, False)])
def test_two_robots_that_swap_places_have_met(aside: float, hit: bool) -> None:
    world = stage([(0, 0, 0, 10, 99, 99), (10, aside, math.pi, 10, 99, -99)], **FAST)
    step = world.step([[AHEAD, AHEAD]])
    np.testing.assert_allclose(world.state.robot_position[0], [[10, 0], [0, aside]], atol=1e-4)
    assert bool(step.terminated[0]) is hit
    assert world.state.collision[0].tolist() == [Outcome.hit_robot * hit] * 2


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ((3, 4), (3, 4), 5.0),  # no motion
        ((-1, 2), (1, 2), 2.0),  # nearest halfway
        ((1, 1), (5, 1), math.sqrt(2)),  # nearest at the start
        ((5, 1), (1, 1), math.sqrt(2)),  # nearest at the end
        ((-2, 0), (2, 0), 0.0),  # straight through
    ],
)
def test_closest_approach(start, end, expected: float) -> None:
    f = np.float32
    distance = closest_approach(f(start[0]), f(start[1]), f(end[0]), f(end[1]))
    assert distance == pytest.approx(expected, abs=1e-6)
