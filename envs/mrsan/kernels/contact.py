"""Two discs in straight motion: their closest approach, and when they touch."""

import math

import numpy as np

from mrsan.kernels import function

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)


@function
def closest_approach(x0, y0, x1, y1):
    """Return the smallest norm of a relative position on its way from (x0, y0) to (x1, y1)."""
    dx, dy = x1 - x0, y1 - y0
    length_squared = dx * dx + dy * dy
    if length_squared > _ZERO:
        s = min(max(-(x0 * dx + y0 * dy) / length_squared, _ZERO), _ONE)
        x0, y0 = x0 + s * dx, y0 + s * dy
    return math.sqrt(x0 * x0 + y0 * y0)


@function
def time_to_collision(x, y, vx, vy, reach, latest):
    """Return when a disc at (x, y), moving at (vx, vy) relative to another, touches it.

    Both keep their velocities: the smaller root of |position + t velocity| = reach, where `reach`
    is the sum of the radii. 0 if they already touch, `latest` if they do not until then.
    """
    outside = x * x + y * y - reach * reach
    if outside <= _ZERO:
        return _ZERO
    closing = -(x * vx + y * vy)
    if not outside < _TWO * closing * latest:  # the root is at least outside / (2 closing)
        return latest
    discriminant = closing * closing - (vx * vx + vy * vy) * outside
    if discriminant < _ZERO:
        return latest
    return min(outside / (closing + math.sqrt(discriminant)), latest)


@function
def comes_to_the_other(own_x, own_y, other_x, other_y, x, y, reach):
    """Return whether the first of two touching discs approaches the other at least as fast.

    During the step they are displaced by (own_x, own_y) and (other_x, other_y). Before it the other
    is at (x, y) relative to the first; `reach` is the sum of the radii. Displacements are compared
    along the line of centres at the moment of contact.
    """
    dx, dy = other_x - own_x, other_y - own_y
    s = time_to_collision(x, y, dx, dy, reach, _ONE)
    along_x, along_y = x + s * dx, y + s * dy  # from the first to the other
    return own_x * along_x + own_y * along_y >= -(other_x * along_x + other_y * along_y)
