"""The world looks the same when it is rotated, mirrored or renumbered."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from mrsan import Crowd, CrowdReaction, Observation, Scenario, Step, World

WORLDS = 100
VECTORS = ("position", "velocity", "goal")
SCENARIO = Scenario(
    robots=3,
    humans=6,
    fov_degrees=140.0,
    sensing_range=8.0,
    occlusion=True,
    arena_radius=8.0,
    goal_change_probability=0.0,
    human_radius_max=0.5,
    crowd_reaction=CrowdReaction.reciprocal,
)
HEADING = slice(6, 8)  # the only entries of `ego` that tell north from south


def scattered(scenario: Scenario, seed: int = 0) -> World:
    rng = np.random.default_rng(seed)
    world = World(scenario, WORLDS)
    world.reset(np.arange(WORLDS))
    state = world.state
    for array in (state.robot_position, state.human_position):
        array[:] = rng.uniform(-6, 6, array.shape)
    state.robot_heading[:] = rng.uniform(-3, 3, state.robot_heading.shape)
    speed = rng.uniform(0, 1, state.robot_heading.shape)
    state.robot_velocity[..., 0] = speed * np.cos(state.robot_heading)
    state.robot_velocity[..., 1] = speed * np.sin(state.robot_heading)
    state.human_velocity[:] = rng.uniform(-0.7, 0.7, state.human_velocity.shape)
    # Goals that nobody reaches: new ones would be drawn in the frame of the map.
    state.human_goal[:] = state.human_position + rng.choice([-40, 40], state.human_goal.shape)
    return world


def transform(world: World, matrix: NDArray, headings: NDArray) -> World:
    """A copy of `world` with every vector multiplied by `matrix` ([2, 2] or one per world)."""
    copy = World(world.scenario, WORLDS)
    copy.reset(world.state.case)
    for name in world.state._fields:
        source, target = getattr(world.state, name), getattr(copy.state, name)
        vector = name.split("_")[-1] in VECTORS
        target[...] = np.einsum("...ij,e...j->e...i", matrix, source) if vector else source
    copy.state.robot_heading[...] = headings
    return copy


def well_conditioned(world: World) -> NDArray[np.bool_]:
    """Worlds whose next step hardly depends on the rounding of positions; ORCA can be ill-posed."""
    rng, twin = np.random.default_rng(2), transform(world, np.eye(2), world.state.robot_heading)
    noisy = transform(world, np.eye(2), world.state.robot_heading)
    noisy.state.human_position[:] += rng.uniform(-2e-6, 2e-6, (WORLDS, 6, 2))
    twin.step(actions())
    noisy.step(actions())
    change = np.abs(twin.state.human_velocity - noisy.state.human_velocity).max((1, 2))
    steady = change < 2e-5
    assert steady.sum() > 0.9 * WORLDS
    return steady


def actions(seed: int = 1) -> NDArray[np.float32]:
    return np.random.default_rng(seed).uniform(-1, 1, (WORLDS, 3, 3)).astype(np.float32)


def assert_same_observation(
    a: Observation, b: Observation, sign: np.float32, tolerance: float = 2e-5
) -> None:
    """Equal but for the heading; `sign` multiplies the left-hand components of `b`."""
    np.testing.assert_array_equal(a.humans_visible, b.humans_visible)
    np.testing.assert_array_equal(a.robots_visible, b.robots_visible)
    flip_ego = np.ones(11)
    flip_ego[[1, 3, 5]] = sign
    flip_other = np.array([1, sign, 1, sign, 1])
    left, right = a.ego.copy(), b.ego * flip_ego
    left[..., HEADING] = right[..., HEADING] = 0
    np.testing.assert_allclose(left, right, atol=tolerance)
    np.testing.assert_allclose(a.humans, b.humans * flip_other, atol=tolerance)
    np.testing.assert_allclose(a.robots, b.robots * flip_other, atol=tolerance)


def assert_same_step(
    world: World,
    other: World,
    before: Step,
    after: Step,
    matrix: NDArray,
    steady: NDArray,
    sign: np.float32,
) -> None:
    """`other` went on as `world` did, transformed by `matrix`, in the worlds `steady`."""
    np.testing.assert_allclose(before.reward[steady], after.reward[steady], atol=1e-3)
    np.testing.assert_array_equal(before.terminated, after.terminated)
    for name in ("robot_position", "robot_velocity", "human_position", "human_velocity"):
        expected = getattr(world.state, name)[steady] @ matrix.T
        np.testing.assert_allclose(getattr(other.state, name)[steady], expected, atol=5e-4)
    rows = (step.observation.of_worlds(steady) for step in (before, after))
    assert_same_observation(*rows, sign, 5e-4)


@pytest.mark.parametrize("crowd", [Crowd.orca, Crowd.social_force])
@pytest.mark.parametrize("degrees", [90.0, 33.0, -171.0])
def test_a_rotated_world_goes_on_rotated(degrees: float, crowd: Crowd) -> None:
    angle = np.radians(degrees)
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    world = scattered(replace(SCENARIO, crowd=crowd))
    headings = np.arctan2(
        np.sin(world.state.robot_heading + angle), np.cos(world.state.robot_heading + angle)
    )
    rotated = transform(world, matrix, headings)
    assert_same_observation(world.observe(), rotated.observe(), np.float32(1))

    steady = well_conditioned(world)
    before, after = world.step(actions()), rotated.step(actions())

    assert_same_step(world, rotated, before, after, matrix, steady, np.float32(1))
    heading = after.observation.ego[..., HEADING]
    np.testing.assert_allclose(heading, before.observation.ego[..., HEADING] @ matrix.T, atol=1e-5)


def test_a_mirrored_world_goes_on_mirrored() -> None:
    matrix = np.diag([1.0, -1.0])
    world = scattered(SCENARIO)
    mirrored = transform(world, matrix, -world.state.robot_heading)
    assert_same_observation(world.observe(), mirrored.observe(), np.float32(-1))
    steady = well_conditioned(world)
    before = world.step(actions())
    after = mirrored.step(actions() * np.float32([1, -1, -1]))  # lateral and turn change sides
    assert_same_step(world, mirrored, before, after, matrix, steady, np.float32(-1))


def test_renumbered_humans_are_seen_and_walk_renumbered() -> None:
    order = np.array([4, 0, 5, 2, 1, 3])
    world = scattered(SCENARIO)
    renumbered = transform(world, np.eye(2), world.state.robot_heading)
    for name in ("position", "velocity", "goal", "radius", "speed"):
        array = getattr(renumbered.state, f"human_{name}")
        array[...] = array[:, order]
    for _ in range(3):
        before, after = world.step(actions()), renumbered.step(actions())
        np.testing.assert_array_equal(before.reward, after.reward)
        np.testing.assert_array_equal(before.observation.ego, after.observation.ego)
        np.testing.assert_array_equal(
            before.observation.humans[:, :, order], after.observation.humans
        )
        np.testing.assert_array_equal(
            before.observation.humans_visible[:, :, order], after.observation.humans_visible
        )


def test_renumbered_robots_see_and_drive_renumbered() -> None:
    order = np.array([2, 0, 1])
    world = scattered(SCENARIO)
    renumbered = transform(world, np.eye(2), world.state.robot_heading)
    for name in ("position", "velocity", "goal", "heading"):
        array = getattr(renumbered.state, f"robot_{name}")
        array[...] = array[:, order]
    before, after = world.step(actions()), renumbered.step(actions()[:, order])
    np.testing.assert_array_equal(before.observation.ego[:, order], after.observation.ego)
    np.testing.assert_allclose(before.reward[:, order], after.reward, atol=1e-6)
    # Robot 2 is now robot 0; the others of it were 0 and 1 and are now 1 and 2.
    np.testing.assert_array_equal(before.observation.robots[:, 2], after.observation.robots[:, 0])
