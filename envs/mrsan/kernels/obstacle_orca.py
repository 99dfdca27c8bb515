"""ORCA's half-planes for walls (van den Berg et al., 2011), as in the RVO2 library."""

import math

import numpy as np

from mrsan.kernels import function
from mrsan.kernels.orca import DX, DY, MOST_WALLS, PX, PY
from mrsan.kernels.walls import (
    AFTER_X,
    AFTER_Y,
    ALONG_X,
    ALONG_Y,
    BEFORE_X,
    BEFORE_Y,
    END_CONVEX,
    END_X,
    END_Y,
    START_CONVEX,
    START_X,
    START_Y,
    front_distances,
    nearest_point,
)

_EPSILON = np.float32(1e-5)
_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_FAR = np.float32(np.inf)


@function
def near_walls(walls, count, x, y, reach, scratch):
    """List the walls within `reach` that face (x, y), nearest first, in `scratch`."""
    numbers, distances, all_distances = (
        scratch.wall_numbers,
        scratch.wall_distances,
        scratch.all_wall_distances,
    )
    front_distances(walls, count, x, y, all_distances)
    n = 0
    for k in range(count):
        squared = all_distances[k]
        if squared >= reach * reach:
            continue
        if n == MOST_WALLS:
            if squared >= distances[n - 1]:
                continue
            n -= 1
        row = n
        while row > 0 and squared < distances[row - 1]:
            numbers[row], distances[row] = numbers[row - 1], distances[row - 1]
            row -= 1
        numbers[row], distances[row] = k, squared
        n += 1
    for row in range(n):
        scratch.wall_points[row, 0], scratch.wall_points[row, 1] = nearest_point(
            walls, numbers[row], x, y
        )
    scratch.wall_counts[0] = n


@function
def wall_lines(walls, x, y, vx, vy, radius, time_horizon, scratch):
    """Write the lines of the near walls of an agent into `scratch`.

    Args:
        walls: [12, W], see `mrsan.kernels.walls`.
        x: position of the agent, m.
        y: likewise.
        vx: its velocity, m/s.
        vy: likewise.
        radius: its radius, m.
        time_horizon: time for which the velocity must be free of collisions with walls, s.
        scratch: with the walls that `near_walls` has listed.
    """
    n = 0
    for row in range(scratch.wall_counts[0]):
        k = scratch.wall_numbers[row]
        n = _add_line(walls, k, n, x, y, vx, vy, radius, _ONE / time_horizon, scratch.wall_lines)
    scratch.wall_counts[1] = n


@function
def _put(lines, n, x, y, dx, dy):
    """Write line `n` through (x, y) along (dx, dy); return the number of lines."""
    lines[PX + n], lines[PY + n], lines[DX + n], lines[DY + n] = x, y, dx, dy
    return n + 1


@function
def _is_covered(lines, n, ax, ay, bx, by, reach):
    """Return whether an earlier line keeps the agent from both ends of a wall."""
    for k in range(n):
        x, y, dx, dy = lines[PX + k], lines[PY + k], lines[DX + k], lines[DY + k]
        if (ax - x) * dy - (ay - y) * dx - reach >= -_EPSILON and (bx - x) * dy - (
            by - y
        ) * dx - reach >= -_EPSILON:
            return True
    return False


@function
def _leg(x, y, squared, radius, side):
    """Return the direction from the origin along a disc at (x, y); `side` 1: left of it, -1."""
    along = math.sqrt(max(squared - radius * radius, _ZERO))
    across = side * radius
    return (x * along - y * across) / squared, (x * across + y * along) / squared


@function
def _add_line(walls, k, n, x, y, vx, vy, radius, inverse, lines):
    """Add the line of wall `k` to `n` lines, unless it is redundant; return their number."""
    ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
    bx, by = walls[END_X, k] - x, walls[END_Y, k] - y
    ux, uy = walls[ALONG_X, k], walls[ALONG_Y, k]
    if _is_covered(
        lines, n, inverse * ax, inverse * ay, inverse * bx, inverse * by, inverse * radius
    ):
        return n
    a_squared, b_squared, radius_squared = ax * ax + ay * ay, bx * bx + by * by, radius * radius
    wx, wy = bx - ax, by - ay
    s = -(ax * wx + ay * wy) / (wx * wx + wy * wy)
    line_x, line_y = -ax - s * wx, -ay - s * wy
    line_squared = line_x * line_x + line_y * line_y
    a_convex, b_convex = walls[START_CONVEX, k] > _HALF, walls[END_CONVEX, k] > _HALF
    if s < _ZERO and a_squared <= radius_squared:  # the agent touches the start
        if a_convex:
            length = math.sqrt(a_squared)
            n = _put(lines, n, _ZERO, _ZERO, -ay / length, ax / length)
        return n
    if s > _ONE and b_squared <= radius_squared:  # the end; the next wall may take care of it
        if b_convex and bx * walls[AFTER_Y, k] - by * walls[AFTER_X, k] >= _ZERO:
            length = math.sqrt(b_squared)
            n = _put(lines, n, _ZERO, _ZERO, -by / length, bx / length)
        return n
    if _ZERO <= s < _ONE and line_squared <= radius_squared:  # the middle
        return _put(lines, n, _ZERO, _ZERO, -ux, -uy)
    # The legs of the velocity obstacle. A wall that is seen obliquely is only one of its ends.
    only_a = s < _ZERO and line_squared <= radius_squared
    only_b = s > _ONE and line_squared <= radius_squared
    if (only_a and not a_convex) or (only_b and not b_convex):
        return n
    single = only_a or only_b
    if only_a:
        bx, by, b_squared, b_convex = ax, ay, a_squared, a_convex
    elif only_b:
        ax, ay, a_squared, a_convex = bx, by, b_squared, b_convex
    left_x, left_y = -ux, -uy
    if a_convex:
        left_x, left_y = _leg(ax, ay, a_squared, radius, _ONE)
    right_x, right_y = ux, uy
    if b_convex:
        right_x, right_y = _leg(bx, by, b_squared, radius, -_ONE)
    # A leg that points into the neighbouring wall is replaced by that wall.
    before_x, before_y, after_x, after_y = (
        walls[BEFORE_X, k],
        walls[BEFORE_Y, k],
        walls[AFTER_X, k],
        walls[AFTER_Y, k],
    )
    if only_a:
        after_x, after_y = ux, uy
    elif only_b:
        before_x, before_y = ux, uy
    left_is_foreign = a_convex and left_y * before_x - left_x * before_y >= _ZERO
    if left_is_foreign:
        left_x, left_y = -before_x, -before_y
    right_is_foreign = b_convex and right_x * after_y - right_y * after_x <= _ZERO
    if right_is_foreign:
        right_x, right_y = after_x, after_y
    return _project(
        lines,
        n,
        vx,
        vy,
        inverse * ax,
        inverse * ay,
        inverse * bx,
        inverse * by,
        ux,
        uy,
        left_x,
        left_y,
        right_x,
        right_y,
        left_is_foreign,
        right_is_foreign,
        single,
        inverse * radius,
    )


@function
def _project(
    lines,
    n,
    vx,
    vy,
    ax,
    ay,
    bx,
    by,
    ux,
    uy,
    left_x,
    left_y,
    right_x,
    right_y,
    left_is_foreign,
    right_is_foreign,
    single,
    reach,
):
    """Add the line at the point of the velocity obstacle nearest to the velocity (vx, vy).

    The obstacle is cut off at the segment from (ax, ay) to (bx, by), rounded by `reach`, from whose
    ends its legs start.
    """
    cut_x, cut_y = bx - ax, by - ay
    from_a_x, from_a_y, from_b_x, from_b_y = vx - ax, vy - ay, vx - bx, vy - by
    t = _HALF
    if not single:
        t = (from_a_x * cut_x + from_a_y * cut_y) / (cut_x * cut_x + cut_y * cut_y)
    on_left = from_a_x * left_x + from_a_y * left_y
    on_right = from_b_x * right_x + from_b_y * right_y
    if (t < _ZERO and on_left < _ZERO) or (single and on_left < _ZERO and on_right < _ZERO):
        length = math.sqrt(from_a_x * from_a_x + from_a_y * from_a_y)
        wx, wy = from_a_x / length, from_a_y / length
        return _put(lines, n, ax + reach * wx, ay + reach * wy, wy, -wx)
    if t > _ONE and on_right < _ZERO:
        length = math.sqrt(from_b_x * from_b_x + from_b_y * from_b_y)
        wx, wy = from_b_x / length, from_b_y / length
        return _put(lines, n, bx + reach * wx, by + reach * wy, wy, -wx)
    to_cut = to_left = to_right = _FAR
    if not (t < _ZERO or t > _ONE or single):
        dx, dy = from_a_x - t * cut_x, from_a_y - t * cut_y
        to_cut = dx * dx + dy * dy
    if on_left >= _ZERO:
        dx, dy = from_a_x - on_left * left_x, from_a_y - on_left * left_y
        to_left = dx * dx + dy * dy
    if on_right >= _ZERO:
        dx, dy = from_b_x - on_right * right_x, from_b_y - on_right * right_y
        to_right = dx * dx + dy * dy
    if to_cut <= to_left and to_cut <= to_right:
        return _put(lines, n, ax + reach * uy, ay - reach * ux, -ux, -uy)
    if to_left <= to_right:
        if left_is_foreign:
            return n
        return _put(lines, n, ax - reach * left_y, ay + reach * left_x, left_x, left_y)
    if right_is_foreign:
        return n
    return _put(lines, n, bx + reach * right_y, by - reach * right_x, -right_x, -right_y)
