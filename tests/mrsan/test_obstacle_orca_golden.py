"""One ORCA step among walls against the RVO2 C++ library."""

from pathlib import Path

import numpy as np
import pytest
from numba import njit

from mrsan.kernels.obstacle_orca import near_walls, wall_lines
from mrsan.kernels.orca import allocate_orca_scratch, orca_velocity
from mrsan.kernels.walls import START_X, START_Y, WALL_ROWS, close_polygon

GOLDEN = Path(__file__).parents[1] / "data" / "orca_obstacles.npz"
BUILD_NOISE = 1e-4  # where two builds of RVO2 differ by more, there is no right answer


@njit
def one_step(vertices, polygon, n_vertices, agents, counts, preferred, limits, numbers, out):
    for e in range(len(counts)):
        walls = np.zeros((WALL_ROWS, vertices.shape[1]), np.float32)
        first = 0
        for k in range(n_vertices[e]):
            walls[START_X, k], walls[START_Y, k] = vertices[e, k, 0], vertices[e, k, 1]
            if k + 1 == n_vertices[e] or polygon[e, k + 1] != polygon[e, k]:
                close_polygon(walls, first, k + 1)
                first = k + 1
        rows, scratch = allocate_orca_scratch(counts[e])
        rows[: counts[e]] = agents[e, : counts[e]]
        reach, most, horizon, wall_horizon, dt = numbers[e]
        for i in range(counts[e]):
            x, y, vx, vy, radius = agents[e, i]
            wall_reach = wall_horizon * limits[e, i] + radius
            near_walls(walls, n_vertices[e], x, y, wall_reach, scratch)
            wall_lines(walls, x, y, vx, vy, radius, wall_horizon, scratch)
            out[e, i, 0], out[e, i, 1] = orca_velocity(
                rows,
                counts[e],
                i,
                preferred[e, i, 0],
                preferred[e, i, 1],
                limits[e, i],
                reach,
                int(most),
                horizon,
                dt,
                scratch,
                scratch.wall_counts[1],
            )


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    """Distances from the velocities of RVO2, m/s, where those are certain."""
    with np.load(GOLDEN) as data:
        golden = dict(data)
    out = np.full_like(golden["new_velocity"], np.nan)
    state = [golden["position"], golden["velocity"], golden["radius"][..., None]]
    numbers = ("neighbor_dist", "max_neighbors", "time_horizon", "time_horizon_obstacles")
    one_step(
        golden["vertices"],
        golden["polygon"],
        golden["n_vertices"],
        np.concatenate(state, axis=-1),
        golden["n_agents"],
        golden["pref_velocity"],
        golden["max_speed"],
        np.stack([golden[name] for name in (*numbers, "time_step")], -1).astype(np.float32),
        out,
    )
    present = np.arange(out.shape[1]) < golden["n_agents"][:, None]
    certain = present & (golden["build_noise"] < BUILD_NOISE)
    return np.linalg.norm(out - golden["new_velocity"], axis=-1)[certain]


def test_the_velocities_are_those_of_rvo2(errors: np.ndarray) -> None:
    """RVO2 may split a wall in its search tree, which moves the lines of few agents."""
    assert len(errors) > 9000
    assert (errors < 1e-4).mean() > 0.98
