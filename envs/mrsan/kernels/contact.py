"""Two discs in piecewise straight motion: their closest approach, and when they touch."""

import math

import numpy as np

from mrsan.kernels import function

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_FAR = np.float32(np.inf)


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
def closest_to_human(x, y, human_x, human_y, remaining):
    """Return the smallest distance of a robot to a human during a step.

    The human ends the step at (x, y) relative to the robot and moves straight by (human_x, human_y)
    in it; `remaining` [K, 2] is that of the robot.
    """
    count = remaining.shape[0]
    from_x, from_y = x - human_x + remaining[0, 0], y - human_y + remaining[0, 1]
    closest = _FAR
    for k in range(1, count):
        share = np.float32(count - k) / np.float32(count)
        to_x = x - human_x * share + remaining[k, 0]
        to_y = y - human_y * share + remaining[k, 1]
        closest = min(closest, closest_approach(from_x, from_y, to_x, to_y))
        from_x, from_y = to_x, to_y
    return min(closest, closest_approach(from_x, from_y, x, y))


@function
def closest_to_robot(x, y, own, other):
    """Return the smallest distance of two robots during a step, at whose end they are (x, y) apart.

    `own` and `other` [K, 2] are the `remaining` displacements of the two.
    """
    from_x, from_y = x - other[0, 0] + own[0, 0], y - other[0, 1] + own[0, 1]
    closest = _FAR
    for k in range(1, own.shape[0]):
        to_x, to_y = x - other[k, 0] + own[k, 0], y - other[k, 1] + own[k, 1]
        closest = min(closest, closest_approach(from_x, from_y, to_x, to_y))
        from_x, from_y = to_x, to_y
    return min(closest, closest_approach(from_x, from_y, x, y))


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
