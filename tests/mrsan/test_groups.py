"""Groups of people: they keep together, walk abreast or stand; robots that pass through them."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from shapely.geometry import MultiPoint, Point

from mrsan import Groups, Layout, Scenario, World
from mrsan.kernels.social_state import GROUP
from mrsan.kernels.tally import INTRUSION_STEPS

STANDING = np.float32([[[-1.0, 0.0, 0.0]]])  # action of the one robot


def group_of(size: int, crowd: str = "orca", case: int = 0, **fields: Any) -> World:
    """One group of `size` people on a large floor."""
    groups = {"share": 1.0, "size_min": size, "size_max": size} | fields
    world = World(
        Scenario(
            robots=1,
            humans=size,
            crowd=crowd,
            layout=Layout.square,
            floor_size=30.0,
            goal_change_probability=0.0,
            terminate_on_collision=False,
            time_limit=100.0,
            groups=Groups(**groups),
        )
    )
    world.reset([case])
    return world


def walk(world: World, steps: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return positions and velocities of the people, [T, M, 2]; the robot is elsewhere."""
    state = world.state
    state.robot_position[0] = [200.0, 200.0]
    positions, velocities = [], []
    for _ in range(steps):
        world.step(STANDING)
        positions.append(state.human_position[0].copy())
        velocities.append(state.human_velocity[0].copy())
    return np.array(positions), np.array(velocities)


def spread(positions: NDArray[np.float32]) -> NDArray[np.float32]:
    """The largest distance of a member from the centre, [T]."""
    return np.linalg.norm(positions - positions.mean(1, keepdims=True), axis=-1).max(1)


@pytest.mark.parametrize("size", [2, 3, 4])
@pytest.mark.parametrize("crowd", ["orca", "social_force"])
def test_a_group_keeps_together_on_a_long_way(crowd: str, size: int) -> None:
    """For 90 s and several goals; nobody strays by more than half a metre, and nobody touches."""
    for case in range(3):
        world = group_of(size, crowd, case)
        positions, velocities = walk(world, 360)
        assert spread(positions).max() < 0.5 * (size - 1) + 0.5
        apart = np.linalg.norm(positions[:, :, None] - positions[:, None], axis=-1)
        apart[:, np.arange(size), np.arange(size)] = np.inf
        assert apart.min() > 0.6
        assert np.linalg.norm(velocities.mean(1), axis=-1).mean() > 0.6
        goals = world.state.human_goal[0]
        np.testing.assert_array_equal(goals, goals[[0] * size])


def test_shares_and_sizes_are_drawn_by_the_case() -> None:
    scenario = Scenario(
        robots=1, humans=30, circle_radius=15.0, groups=Groups(share=0.6, size_min=2, size_max=3)
    )
    world, members = World(scenario), []
    for case in range(60):
        world.reset([case])
        members.append(world.state.human_social[0, :, GROUP].copy())
        numbers, sizes = np.unique(members[-1][members[-1] >= 0], return_counts=True)
        assert set(sizes) <= {2, 3}
        for number in numbers:  # named by its first member, the others follow
            rows = np.flatnonzero(members[-1] == number)
            assert (rows == np.arange(number, number + len(rows))).all()
            speeds = world.state.human_speed[0, rows]
            assert (speeds == speeds[0]).all()
    assert np.mean(np.array(members) >= 0) == pytest.approx(0.6, abs=0.05)
    world.reset([5])
    np.testing.assert_array_equal(world.state.human_social[0, :, GROUP], members[5])


@pytest.mark.parametrize("size", [2, 3, 4])
def test_an_intrusion_is_what_shapely_says(size: int) -> None:
    """The robot is in the convex hull of the members, or nearer to it than 0.3 m."""
    world = group_of(size)
    state, rng = world.state, np.random.default_rng(size)
    intrusions = 0
    for _ in range(150):
        world.reset([0])
        state.human_position[0] = rng.uniform(-1.5, 1.5, (size, 2))
        state.human_goal[0] = [60.0, 0.0]
        state.robot_position[0], state.robot_goal[0] = rng.uniform(-1.5, 1.5, 2), [60.0, 60.0]
        world.step(STANDING)
        people = MultiPoint(state.human_position[0].astype(float))
        distance = people.convex_hull.distance(Point(state.robot_position[0, 0].astype(float)))
        if abs(distance - 0.3) > 1e-5:
            assert state.tally[0, 0, INTRUSION_STEPS] == (distance < 0.3)
            intrusions += distance < 0.3
    assert 15 < intrusions < 140
