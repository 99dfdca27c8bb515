"""Distance kept between two discs during a step, not only at its end."""

import math

import numpy as np

from mrsan.kernels import function

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


@function
def closest_approach(x0, y0, x1, y1):
    """Smallest norm of a relative position that moves straight from (x0, y0) to (x1, y1)."""
    dx, dy = x1 - x0, y1 - y0
    length_squared = dx * dx + dy * dy
    if length_squared > _ZERO:
        s = min(max(-(x0 * dx + y0 * dy) / length_squared, _ZERO), _ONE)
        x0, y0 = x0 + s * dx, y0 + s * dy
    return math.sqrt(x0 * x0 + y0 * y0)
