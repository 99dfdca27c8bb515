"""Whom ORCA takes for neighbours, against a plain sort."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from mrsan.kernels import orca


@njit
def nearest(agents, i, distance, most):
    rows, scratch = orca.allocate_orca_scratch(len(agents))
    rows[: len(agents)] = agents
    n = orca._find_nearest(
        rows, len(agents), i, distance, most, scratch.distances, scratch.places, scratch.nearest
    )
    return scratch.nearest[:n].copy()


@given(
    st.integers(1, 80),
    st.sampled_from([1, 2, 10, 80]),
    st.sampled_from([0.5, 3.0, 1000.0]),
    st.sampled_from([0, 2, 10, 10_000]),
    st.integers(0, 2**32),
)
def test_they_are_the_nearest_in_order(
    count: int, most: int, distance: float, grid: int, seed: int
) -> None:
    """On coarse grids many are equally near, or at the same place: then the first comes first."""
    rng = np.random.default_rng(seed)
    agents = np.zeros((count, 5), np.float32)
    agents[:, 4] = np.arange(count)  # tells who it is
    agents[:, :2] = 10.0 * rng.integers(0, grid + 1, (count, 2)) / (grid + 1)
    i = int(rng.integers(count))
    squared = ((agents[i, :2] - agents[:, :2]) ** 2).sum(1)
    order = np.argsort(squared, kind="stable")
    expected = [j for j in order if j != i and squared[j] < np.float32(distance) ** 2][:most]
    np.testing.assert_array_equal(nearest(agents, i, np.float32(distance), most), agents[expected])
