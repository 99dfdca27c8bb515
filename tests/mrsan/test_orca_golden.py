"""One ORCA step against the RVO2 C++ library."""

from pathlib import Path

import numpy as np
import pytest
from numba import njit
from oracle import orca

from mrsan.kernels.orca import allocate_orca_scratch, orca_velocity

GOLDEN = Path(__file__).parents[1] / "data" / "orca_one_step.npz"
BUILD_NOISE = 1e-4  # where two builds of RVO2 differ by more, there is no right answer


@pytest.fixture(scope="module")
def golden() -> dict[str, np.ndarray]:
    with np.load(GOLDEN) as data:
        return dict(data)


@njit
def one_step(agents, counts, preferred, max_speed, reach, most, horizon, dt, out):
    for e in range(len(counts)):
        rows, scratch = allocate_orca_scratch(counts[e])
        rows[: counts[e]] = agents[e, : counts[e]]
        for i in range(counts[e]):
            out[e, i, 0], out[e, i, 1] = orca_velocity(
                rows,
                counts[e],
                i,
                preferred[e, i, 0],
                preferred[e, i, 1],
                max_speed[e, i],
                reach[e],
                most[e],
                horizon[e],
                dt[e],
                scratch,
            )


def test_the_kernel_gives_what_rvo2_gives(golden: dict[str, np.ndarray]) -> None:
    rows = np.arange(golden["radius"].shape[1]) < golden["n_agents"][:, None]
    compared = rows & (golden["build_noise"] < BUILD_NOISE)
    out = np.full_like(golden["new_velocity"], np.nan)
    one_step(
        np.concatenate(
            [golden["position"], golden["velocity"], golden["radius"][..., None]], axis=-1
        ),
        golden["n_agents"],
        golden["pref_velocity"],
        golden["max_speed"],
        golden["neighbor_dist"],
        golden["max_neighbors"],
        golden["time_horizon"],
        golden["time_step"],
        out,
    )
    error = np.linalg.norm(out - golden["new_velocity"], axis=-1)[compared]
    assert compared.sum() > 22_000
    assert (error < 1e-3).mean() >= 0.999


def test_the_oracle_gives_what_rvo2_gives(golden: dict[str, np.ndarray]) -> None:
    """What the other tests measure the kernels with is itself measured."""
    errors = []
    for e in range(80):
        n = golden["n_agents"][e]
        agents = np.column_stack(
            [golden["position"][e], golden["velocity"][e], golden["radius"][e]]
        )[:n].astype(np.float64)
        for i in np.flatnonzero(golden["build_noise"][e, :n] < BUILD_NOISE)[:6]:
            velocity = orca(
                agents,
                int(i),
                golden["pref_velocity"][e, i].astype(np.float64),
                float(golden["max_speed"][e, i]),
                float(golden["neighbor_dist"][e]),
                int(golden["max_neighbors"][e]),
                float(golden["time_horizon"][e]),
                float(golden["time_step"][e]),
            )
            errors.append(np.linalg.norm(velocity - golden["new_velocity"][e, i]))
    assert len(errors) > 200
    assert (np.array(errors) < 1e-3).mean() >= 0.99
