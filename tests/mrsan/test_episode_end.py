"""How episodes end, and how the next one begins."""

import numpy as np
import pytest
from staging import stage

from mrsan import Outcome, Scenario, World
from mrsan.metrics import episodes_of

COAST = [0.0, 0.0, 0.0]
DRIVER = (0, 0, 0, 1, 4, 0)


def test_the_time_limit_truncates() -> None:
    """One second is four steps."""
    world = World(Scenario(robots=2, humans=0, time_limit=1.0), 3)
    world.reset([0, 1, 2])
    flags = [world.step(np.zeros((3, 2, 3))) for _ in range(4)]
    assert [bool(step.truncated.any()) for step in flags[:3]] == [False] * 3
    assert flags[3].truncated.all()
    assert not any(step.terminated.any() for step in flags)
    record = episodes_of(world.state, world.scenario, np.ones(3, bool))
    assert (record.outcome == Outcome.timeout).all()
    assert record.duration.tolist() == [1.0] * 3


def test_a_collision_terminates_even_in_the_last_step() -> None:
    world = stage([DRIVER, (0, 5, 0, 1, 4, 5)], [(0.5, 0, 0, 0)], clock=199)
    step = world.step([[COAST, COAST]])
    assert (bool(step.terminated[0]), bool(step.truncated[0])) == (True, False)
    record = episodes_of(world.state, world.scenario, np.ones(1, bool))
    assert record.outcome[0].tolist() == [Outcome.hit_human, Outcome.interrupted]
    assert not record.success[0]


def test_all_arrived_terminates_even_in_the_last_step() -> None:
    world = stage([(0, 0, 0, 1, 0.5, 0), (0, 5, 0, 0, 0, 5)], arrived=[1], clock=199)
    step = world.step([[COAST, COAST]])
    assert (bool(step.terminated[0]), bool(step.truncated[0])) == (True, False)
    assert episodes_of(world.state, world.scenario, np.ones(1, bool)).success[0]


def test_a_world_that_has_ended_stands_still_unpaid() -> None:
    world = stage([DRIVER], [(0.5, 0, 0, 0)])
    world.step([[COAST]])
    frozen = [array.copy() for array in world.state]
    for _ in range(3):
        step = world.step([[[1.0, 1.0, 1.0]]])
        assert step.reward.tolist() == [[0.0]]
        assert step.terminated[0]
        assert step.finished is None
    for before, after in zip(frozen, world.state, strict=True):
        np.testing.assert_array_equal(before, after)


def test_the_record_of_a_drive_by_hand() -> None:
    """Four steps of coasting at 1 m/s towards a goal 1.2 m ahead, past a human 0.7 m aside."""
    world = stage([(0, 0, 0, 1, 1.2, 0)], [(0.6, 0.9, 0, 0)])
    world.state.robot_acceleration[:] = 0
    for _ in range(4):
        world.step([[COAST]])
    record = episodes_of(world.state, world.scenario, np.ones(1, bool))
    assert record.outcome.tolist() == [[Outcome.arrived]]
    assert record.path_length[0, 0] == pytest.approx(1.0)
    assert record.straight_line[0, 0] == pytest.approx(1.2)
    assert record.time[0, 0] == 1.0
    # It passes x = 0.6 in the third step: the closest approach lies inside a step.
    assert record.closest_human[0, 0] == pytest.approx(0.3, abs=1e-6)
    # The steps end at 0.25, 0.5, 0.75 and 1.0: surface distances 0.366, 0.306, 0.312 and 0.385.
    assert record.close_share[0, 0] == 1.0
    assert record.jerk[0, 0] == pytest.approx(0, abs=1e-3)


def test_jerk_is_the_change_of_acceleration_over_time() -> None:
    """From rest to 1 m/s in one step is 4 m/s^2, from none: 16 m/s^3; then back: 16 again."""
    world = stage([(0, 0, 0, 0, 9, 0)], time_limit=0.5)
    world.step([[[1.0, 0.0, 0.0]]])
    world.step([[COAST]])
    record = episodes_of(world.state, world.scenario, np.ones(1, bool))
    assert record.jerk[0, 0] == pytest.approx(16, rel=1e-4)
    assert record.path_length[0, 0] == pytest.approx(0.125 + 0.25)


def test_auto_reset_keeps_what_ended_and_begins_another_episode() -> None:
    scenario = Scenario(robots=2, humans=5, time_limit=5.0)
    rng = np.random.default_rng(0)
    cases = np.arange(40)
    automatic, manual = World(scenario, 40, auto_reset=True), World(scenario, 40)
    first = automatic.reset(cases)
    np.testing.assert_array_equal(first.ego, manual.reset(cases).ego)
    ended_before = np.zeros(40, bool)
    ends = 0
    for _ in range(20):
        action = rng.uniform(-1, 1, (40, 2, 3)).astype(np.float32)
        action[..., 0] = 1.0
        step, reference = automatic.step(action), manual.step(action)
        done = step.terminated | step.truncated
        new = done & ~ended_before
        np.testing.assert_array_equal(step.reward[~ended_before], reference.reward[~ended_before])
        if step.finished is None:
            assert not done.any()
            assert step.final_observation is None
            continue
        ends += int(done.sum())
        assert step.finished.case.tolist() == cases[done].tolist()
        expected = episodes_of(manual.state, scenario, new)
        rows = np.flatnonzero(new[done])  # those in their first episode
        for field_values, theirs in zip(step.finished, expected, strict=True):
            np.testing.assert_array_equal(field_values[rows], theirs)
        final = step.final_observation.arrays()
        for name, array in reference.observation.of_worlds(new).arrays().items():
            np.testing.assert_array_equal(final[name][rows], array)
        assert (automatic.state.clock[done] == 0).all()
        assert (step.observation.ego[done, :, 10] == 0).all()
        assert (step.observation.ego[new] != first.ego[new]).any(axis=(1, 2)).all()
        ended_before |= done
    assert ends >= 40
    # The next episode is the one that a reset without a case number begins.
    once_more = World(scenario, 40)
    once_more.reset(cases)
    next_episode = once_more.reset()
    automatic.reset(cases)
    np.testing.assert_array_equal(automatic.reset().ego, next_episode.ego)


def test_a_partial_reset_leaves_the_others_alone() -> None:
    world = World(Scenario(robots=2, humans=3), 4)
    world.reset([5, 6, 7, 8])
    for _ in range(3):
        before = world.step(np.full((4, 2, 3), 0.3)).observation
    after = world.reset(worlds=[False, True, False, True])
    assert world.state.clock.tolist() == [3, 0, 3, 0]
    assert world.state.episode.tolist() == [0, 1, 0, 1]
    np.testing.assert_array_equal(before.ego[[0, 2]], after.ego[[0, 2]])
    np.testing.assert_array_equal(before.humans[[0, 2]], after.humans[[0, 2]])
    again = world.reset(cases=[0, 6, 0, 0], worlds=[False, True, False, False])
    fresh = World(Scenario(robots=2, humans=3)).reset([6])
    np.testing.assert_array_equal(again.ego[1], fresh.ego[0])
