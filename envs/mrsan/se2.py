"""Planar rigid transforms: how a body frame is entered and left.

The x axis of a body frame points along the heading and its y axis to the left; `cos` and `sin` are
those of the heading in the world frame. The arithmetic works on floats, NumPy arrays and tensors,
and compiled kernels call the same functions.

NumPy's own sin, cos, arctan2, exp and the like differ in the last bit between processors with and
without AVX-512. Simulation and planning therefore call those of the C library, from compiled
kernels or from `math`, so that episodes are the same bit for bit on every x86-64 processor.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

_callable_from_kernels = partial(register_jitable, forceinline=True)


@_callable_from_kernels()
def rotate(cos: Any, sin: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """Rotate a vector from the axes of the body to those of the world."""
    return cos * x - sin * y, sin * x + cos * y


@_callable_from_kernels()
def unrotate(cos: Any, sin: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """Rotate a vector from the axes of the world to those of the body."""
    return cos * x + sin * y, cos * y - sin * x


@_callable_from_kernels()
def transform(cos: Any, sin: Any, body_x: Any, body_y: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """Map a point of the frame of a body at (body_x, body_y) to the world frame."""
    return body_x + cos * x - sin * y, body_y + sin * x + cos * y


@_callable_from_kernels()
def untransform(cos: Any, sin: Any, body_x: Any, body_y: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """Map a point of the world frame to the frame of a body at (body_x, body_y)."""
    return unrotate(cos, sin, x - body_x, y - body_y)


def rotate_vectors(vectors: NDArray[Any], direction: NDArray[Any]) -> NDArray[Any]:
    """Rotate vectors [..., 2] by the angles of directions [..., 2], which are (cos, sin)."""
    x, y, cos, sin = vectors[..., 0], vectors[..., 1], direction[..., 0], direction[..., 1]
    return np.stack(rotate(cos, sin, x, y), -1)


def unrotate_vectors(vectors: NDArray[Any], direction: NDArray[Any]) -> NDArray[Any]:
    """Rotate vectors [..., 2] back by the angles of directions [..., 2], which are (cos, sin)."""
    x, y, cos, sin = vectors[..., 0], vectors[..., 1], direction[..., 0], direction[..., 1]
    return np.stack(unrotate(cos, sin, x, y), -1)


def unit_vectors(angles: NDArray[Any]) -> NDArray[np.float64]:
    """Return the unit vectors (cos, sin), [L, 2], of angles [L] in rad."""
    vectors = [(math.cos(angle), math.sin(angle)) for angle in angles.tolist()]
    return np.array(vectors, np.float64).reshape(-1, 2)
