"""Planar rigid transforms: numbers from paper and pencil, inverses, and every kind of argument."""

import numpy as np
import torch

from mrsan.kernels import function
from mrsan.se2 import (
    rotate,
    rotate_vectors,
    transform,
    unrotate_vectors,
    untransform,
)

# A body at (2, 1) that faces up: one metre ahead of it is (2, 2), one to its left (1, 1).
UP = (0.0, 1.0)
BODY = (2.0, 1.0)


def test_ahead_and_left_of_a_body_that_faces_up() -> None:
    assert rotate(*UP, 1.0, 0.0) == (0.0, 1.0)
    assert rotate(*UP, 0.0, 1.0) == (-1.0, 0.0)
    assert transform(*UP, *BODY, 1.0, 0.0) == (2.0, 2.0)
    assert transform(*UP, *BODY, 0.0, 1.0) == (1.0, 1.0)
    assert untransform(*UP, *BODY, 1.0, 1.0) == (0.0, 1.0)


def test_floats_arrays_tensors_and_kernels_give_the_same_bits() -> None:
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=(6, 20)).astype(np.float32)

    @function
    def compiled(cos, sin, body_x, body_y, x, y):  # type: ignore[no-untyped-def]
        return untransform(cos, sin, body_x, body_y, *transform(cos, sin, body_x, body_y, x, y))

    arrays = compiled.py_func(*numbers)
    tensors = compiled.py_func(*torch.from_numpy(numbers))
    scalars = np.array([compiled(*column) for column in numbers.T], np.float32).T
    np.testing.assert_array_equal(arrays, torch.stack(tensors).numpy())
    np.testing.assert_array_equal(arrays, scalars)


def test_rows_of_vectors_turn_by_their_directions() -> None:
    vectors = np.array([[1.0, 0.0], [0.0, 2.0]])
    directions = np.array([UP, (-1.0, 0.0)])
    np.testing.assert_array_equal(rotate_vectors(vectors, directions), [[0.0, 1.0], [0.0, -2.0]])
    turned_back = unrotate_vectors(rotate_vectors(vectors, directions), directions)
    np.testing.assert_array_equal(turned_back, vectors)
