"""Observation of those who left the view."""

import numpy as np
import pytest

from mrsan import Scenario, World
from samarl.observations.tracker import Tracker
from tests.staging import stage


def test_a_person_who_leaves_the_view_is_coasted_and_then_forgotten() -> None:
    # The robot drives along x and looks 90 degrees wide; the person walks across, behind it.
    world = stage([[0, 0, 0, 1, 9, 0]], [[1.65, 0.9, 0, 0.4]], fov_degrees=90.0, time_limit=10.0)
    tracker = Tracker(track_time=0.75, time_step=0.25)
    memory, begins = tracker.initial(1, 1, 1), np.ones(1, np.bool_)
    tracks = tracker.update(world.observe(), memory, begins)
    ages = []
    for _ in range(9):
        tracks = tracker.update(world.step(np.zeros((1, 1, 3))).observation, memory, ~begins)
        ages.append(
            round(3 * float(tracks.humans[0, 0, 0, 5])) if tracks.humans_known.any() else -1
        )
        if ages[-1] >= 0:  # it walks straight, so coasting is exact
            truth = world.state.human_position[0, 0] - world.state.robot_position[0, 0]
            assert tracks.humans[0, 0, 0, :2] == pytest.approx(truth, abs=1e-5)
            assert tracks.humans[0, 0, 0, 2:4] == pytest.approx([-1.0, 0.4], abs=1e-5)
    seen = ages.index(1)
    assert ages[seen:] == [1, 2, 3, *([-1] * (9 - seen - 3))]
    assert set(ages[:seen]) == {0}
    assert not tracks.humans.any()


def test_memory_survives_turning_and_ends_with_the_episode() -> None:
    world = World(Scenario(fov_degrees=90.0), worlds=4)
    tracker = Tracker(track_time=25.0, time_step=0.25)
    memory, every = tracker.initial(4, 3, 10), np.ones(4, np.bool_)
    known = tracker.update(world.reset([0, 1, 2, 3]), memory, every).humans_known.sum((1, 2))
    for _ in range(12):  # a full half-turn on the spot
        turning = np.tile(np.float32([-1, 0, 1]), (4, 3, 1))
        step = world.step(turning)
        tracks = tracker.update(step.observation, memory, ~every)
    assert (tracks.humans_known.sum((1, 2)) > known).all()
    gone = np.array([True, False, True, False])
    after = tracker.update(world.reset(worlds=gone), memory, gone)
    assert (after.humans_known[gone] == world.observe().humans_visible[gone]).all()
    assert (after.humans_known[~gone] == tracks.humans_known[~gone]).all()
