"""Robots that follow paths from elsewhere are judged as those that `mrsan` moves itself."""

import numpy as np
import pytest

from mrsan import ActionError, Outcome, Scenario, World
from mrsan.metrics import episodes_of
from mrsan.state import State


def poses(state: State) -> np.ndarray:
    """The state of all robots as paths of one piece, [E, N, 1, 5]."""
    columns = state.robot_position, state.robot_velocity, state.robot_heading[..., None]
    return np.concatenate(columns, axis=-1)[:, :, None]


@pytest.mark.parametrize(
    "fields",
    [{}, {"terminate_on_collision": False}, {"layout": "doorway", "humans": 4}],
    ids=["open", "counted", "walled"],
)
def test_paths_of_one_piece_are_the_same_to_the_last_bit(fields: dict) -> None:
    scenario = Scenario(**fields)
    by_actions, along = World(scenario, 2), World(scenario, 2)
    by_actions.reset([5, 6])
    along.reset([5, 6])
    random = np.random.default_rng(0)
    for _ in range(60):
        actions = random.uniform(-1, 1, (2, 3, 3)).astype(np.float32)
        expected = by_actions.step(actions)
        step = along.step_along(poses(by_actions.state))
        np.testing.assert_array_equal(step.reward, expected.reward)
        for name, array in by_actions.state._asdict().items():
            np.testing.assert_array_equal(getattr(along.state, name), array, name)


def facing_a_person() -> World:
    """One robot at the origin; a person stands 0.8 m to its left."""
    world = World(Scenario(robots=1, humans=1, crowd="still"))
    world.reset([0])
    state = world.state
    state.robot_position[:], state.robot_goal[:] = 0.0, (9.0, 0.0)
    state.human_position[:], state.human_radius[:] = (0.0, 0.8), 0.3
    return world


def path_through(*points: tuple[float, float]) -> np.ndarray:
    path = np.zeros((1, 1, len(points), 5), np.float32)
    path[0, 0, :, :2] = points
    return path


def test_a_contact_between_two_moments_counts_and_the_chord_does_not() -> None:
    """The robot goes 0.25 m to the left and back: 0.05 m into the person in the middle."""
    world = facing_a_person()
    world.step_along(path_through((0.0, 0.25), (0.0, 0.0)))
    record = episodes_of(world.state, world.scenario, np.ones(1, np.bool_))
    assert record.outcome[0, 0] == Outcome.hit_human
    assert record.closest_human[0, 0] == pytest.approx(0.8 - 0.25 - 0.6, abs=1e-6)
    straight = facing_a_person()
    straight.step_along(path_through((0.0, 0.0)))
    assert not straight.state.done[0]
    assert straight.state.tally[0, 0, 1] == pytest.approx(0.2, abs=1e-6)  # closest human


def test_paths_that_are_not_finite_are_refused() -> None:
    world = World(Scenario())
    world.reset([0])
    path = poses(world.state)
    path[0, 1, 0, 3] = np.nan
    with pytest.raises(ActionError, match="robot 1 in world 0"):
        world.step_along(path)
