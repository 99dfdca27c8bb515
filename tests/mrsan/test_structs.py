"""Named tuples of arrays and numbers that compiled code reads by reference."""

import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest

from mrsan.kernels import kernel
from mrsan.kernels.structs import KeepsStruct, Struct, by_reference


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


def test_a_change_of_a_field_is_another_type() -> None:
    grid = np.zeros((4, 2))
    same = [Struct(outer._fields, outer).type for outer in (make_outer(grid), make_outer(grid + 1))]
    assert same[0] == same[1]
    others = [make_outer(grid)._replace(count=1.0), make_outer(grid.astype(np.float32))]
    assert all(Struct(other._fields, other).type != same[0] for other in others)


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (np.zeros((4, 4))[:, ::2], "C-contiguous"),
        ((1, 2), "named"),
        ("text", "str"),
        (np.int32(1), "int32"),
    ],
)
def test_other_values_are_refused(value: Any, problem: str) -> None:
    with pytest.raises(TypeError, match=problem):
        Struct(["field"], [value])


def test_a_kept_struct_is_neither_pickled_nor_copied() -> None:
    kept = _Kept(np.float32(0.5), np.zeros(3), ())
    assert by_reference(kept) is by_reference(kept)
    other = pickle.loads(pickle.dumps(kept))
    assert type(other) is _Kept
    assert by_reference(other).address != by_reference(kept).address
    other.grid[0] = 1.0
    assert kept.grid[0] == 0.0
