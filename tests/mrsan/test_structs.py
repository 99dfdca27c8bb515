"""Named tuples of arrays and numbers that compiled code reads by reference."""

import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest

from mrsan.kernels import kernel
from mrsan.kernels.structs import KeepsStruct, by_reference


class _Inner(NamedTuple):
    half: np.float32
    grid: Any
    nothing: tuple[()]


class _Outer(NamedTuple):
    flag: bool
    count: int
    empty: Any
    inner: _Inner
    double: float
    names: Any


class _Kept(_Inner, KeepsStruct):
    pass


@kernel
def _read(first, last, outer, more, out):  # type: ignore[no-untyped-def]
    inner = outer.inner
    for i in range(first, last):
        out[i] = inner.grid[i, 1] + inner.half + more
        out[i] += outer.count + outer.double + outer.flag + outer.empty.shape[0]
        out[i] += outer.names.size
        inner.grid[i, 0] = outer.empty.shape[1]


def make_outer(grid: np.ndarray) -> _Outer:
    names = np.zeros((2, 3), np.int32)
    names.flags.writeable = False
    inner = _Inner(np.float32(0.5), grid, ())
    return _Outer(True, -(2**40), np.zeros((0, 7), np.float32), inner, 0.25, names)


@pytest.mark.parametrize("rows", [1, 4])
def test_compiled_code_reads_every_kind_of_field_and_writes_into_arrays(rows: int) -> None:
    grid, out = np.arange(8.0).reshape(4, 2), np.zeros(4)
    _read(rows, make_outer(grid), np.int64(2**40), out)
    expected = [1.0 + 0.5 + 0.25 + 1 + 6, 3.0 + 0.5 + 0.25 + 1 + 6, 12.75, 14.75]
    np.testing.assert_array_equal(out[:rows], expected[:rows])
    np.testing.assert_array_equal(grid[:rows, 0], 7.0)


def test_a_kept_struct_is_neither_pickled_nor_copied() -> None:
    kept = _Kept(np.float32(0.5), np.zeros(3), ())
    assert by_reference(kept) is by_reference(kept)
    other = pickle.loads(pickle.dumps(kept))
    assert type(other) is _Kept
    assert by_reference(other).address != by_reference(kept).address
    other.grid[0] = 1.0
    assert kept.grid[0] == 0.0
