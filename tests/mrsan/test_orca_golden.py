"""One ORCA step against the RVO2 C++ library, on open floors and among walls."""

from pathlib import Path
from typing import Any

import numpy as np
from oracle import orca

from mrsan.kernels import kernel
from mrsan.kernels.obstacle_orca import near_walls, wall_lines
from mrsan.kernels.orca import allocate_orca_scratch, orca_velocity
from mrsan.kernels.walls import START_X, START_Y, WALL_ROWS, close_polygon

DATA = Path(__file__).parents[1] / "data"
BUILD_NOISE = 1e-4  # where two builds of RVO2 differ by more, there is no right answer


@kernel
def one_step(
    first, last, vertices, polygon, n_vertices, agents, counts, preferred, limits, numbers, out
):
    for e in range(first, last):
        walls = np.zeros((WALL_ROWS, vertices.shape[1]), np.float32)
        begin = 0
        for k in range(n_vertices[e]):
            walls[START_X, k], walls[START_Y, k] = vertices[e, k, 0], vertices[e, k, 1]
            if k + 1 == n_vertices[e] or polygon[e, k + 1] != polygon[e, k]:
                close_polygon(walls, begin, k + 1)
                begin = k + 1
        rows, scratch = allocate_orca_scratch(counts[e])
        rows[: counts[e]] = agents[e, : counts[e]]
        reach, most, horizon, wall_horizon, dt = numbers[e]
        for i in range(counts[e]):
            x, y, vx, vy, radius = agents[e, i]
            near_walls(walls, n_vertices[e], x, y, wall_horizon * limits[e, i] + radius, scratch)
            wall_lines(walls, x, y, vx, vy, radius, wall_horizon, scratch)
            out[e, i, 0], out[e, i, 1] = orca_velocity(
                rows, counts[e], i, preferred[e, i, 0], preferred[e, i, 1], limits[e, i], reach,
                int(most), horizon, dt, scratch, scratch.wall_counts[1],
            )  # fmt: skip


def errors(name: str) -> np.ndarray:
    """Distances from the velocities of RVO2, m/s, where those are certain."""
    with np.load(DATA / name) as data:
        golden: dict[str, Any] = dict(data)
    count = len(golden["n_agents"])
    no_walls = {
        "vertices": np.zeros((count, 1, 2), np.float32),
        "polygon": np.zeros((count, 1), np.int64),
        "n_vertices": np.zeros(count, np.int64),
        "time_horizon_obstacles": np.ones(count),
    }
    golden = no_walls | golden
    state = [golden["position"], golden["velocity"], golden["radius"][..., None]]
    names = ("neighbor_dist", "max_neighbors", "time_horizon", "time_horizon_obstacles")
    out = np.full_like(golden["new_velocity"], np.nan)
    one_step(
        count,
        golden["vertices"],
        golden["polygon"].astype(np.int64),
        golden["n_vertices"].astype(np.int64),
        np.concatenate(state, axis=-1),
        golden["n_agents"].astype(np.int64),
        golden["pref_velocity"],
        golden["max_speed"],
        np.stack([golden[name] for name in (*names, "time_step")], -1).astype(np.float32),
        out,
    )
    present = np.arange(out.shape[1]) < golden["n_agents"][:, None]
    certain = present & (golden["build_noise"] < BUILD_NOISE)
    return np.linalg.norm(out - golden["new_velocity"], axis=-1)[certain]


def test_the_kernel_gives_what_rvo2_gives() -> None:
    error = errors("orca_one_step.npz")
    assert len(error) > 22_000
    assert (error < 1e-3).mean() >= 0.999


def test_among_walls_it_gives_what_rvo2_gives() -> None:
    """RVO2 may split a wall in its search tree, which moves the lines of few agents."""
    error = errors("orca_obstacles.npz")
    assert len(error) > 9000
    assert (error < 1e-4).mean() > 0.98


def test_the_oracle_gives_what_rvo2_gives() -> None:
    """What the other tests measure the kernels with is itself measured."""
    with np.load(DATA / "orca_one_step.npz") as data:
        golden = dict(data)
    names = ("neighbor_dist", "max_neighbors", "time_horizon", "time_step")
    errors = []
    for e in range(80):
        n = golden["n_agents"][e]
        rows = [golden[name][e] for name in ("position", "velocity", "radius")]
        agents = np.column_stack(rows)[:n].astype(np.float64)
        reach, most, horizon, dt = (float(golden[name][e]) for name in names)
        for i in np.flatnonzero(golden["build_noise"][e, :n] < BUILD_NOISE)[:6]:
            preferred = golden["pref_velocity"][e, i].astype(np.float64)
            speed = float(golden["max_speed"][e, i])
            velocity = orca(agents, int(i), preferred, speed, reach, int(most), horizon, dt)
            errors.append(np.linalg.norm(velocity - golden["new_velocity"][e, i]))
    assert len(errors) > 200
    assert (np.array(errors) < 1e-3).mean() >= 0.99
