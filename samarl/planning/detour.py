"""How far it is to the goal round those who stand.

By the straight distance alone a robot would stand for ever before somebody who has parked: no way
round leads nearer to the goal at first.
"""

import math

import numpy as np

from mrsan.kernels import function
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.kinematics import HOLONOMIC

STANDING = np.float32(0.1)  # who is slower stands, m/s
TURN = np.float32(0.2)  # distance that a turn to where it sets out for counts, m/rad
KEEP_RIGHT = np.float32(0.1)  # distance that the way on the left counts more, m

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)


@function
def way_left(rows, count, x, y, heading, goal_x, goal_y, p):
    """The way from (x, y) to the goal round those who stand in it, all on the same side, m.

    The left side counts a little more, or two face to face would turn to and fro for ever. A turn
    to where the way sets out counts a little, so turning on the spot is better than standing.

    Args:
        rows: the robot and the others, `[px, py, vx, vy, radius]` as from `gather`, m and m/s.
        count: how many rows there are.
        x: where the robot is, in the frame of the rows (m).
        y: likewise.
        heading: where it heads (rad).
        goal_x: where it is to get (m).
        goal_y: likewise.
        p: the scenario's parameters.
    """
    to_x, to_y = goal_x - x, goal_y - y
    straight = math.sqrt(to_x * to_x + to_y * to_y)
    straight += _turn(math.atan2(to_y, to_x) - heading, p)
    right = left = straight
    for j in range(1, count):
        if _in_the_way(rows, count, j, x, y, goal_x, goal_y, p):
            radius = rows[j, 4] + p.robot_radius
            from_x, from_y = x - rows[j, 0], y - rows[j, 1]
            end_x, end_y = goal_x - rows[j, 0], goal_y - rows[j, 1]
            right = max(right, _way_round(from_x, from_y, end_x, end_y, radius, heading, _ONE, p))
            left = max(left, _way_round(from_x, from_y, end_x, end_y, radius, heading, -_ONE, p))
    return min(right, left + KEEP_RIGHT)


@function
def _in_the_way(rows, count, j, x, y, goal_x, goal_y, p):
    """Whether row `j` stands between (x, y) and the goal, or too near to one that does."""
    if _cuts(rows, j, x, y, goal_x, goal_y, p):
        return True
    if not _stands(rows, j):
        return False
    for i in range(1, count):
        dx, dy = rows[i, 0] - rows[j, 0], rows[i, 1] - rows[j, 1]
        reach = rows[i, 4] + rows[j, 4] + p.robot_radius + p.robot_radius
        if dx * dx + dy * dy < reach * reach and _cuts(rows, i, x, y, goal_x, goal_y, p):
            return True
    return False


@function
def _cuts(rows, j, x, y, goal_x, goal_y, p):
    """Whether row `j` stands where the straight way from (x, y) to the goal leads through it."""
    if not _stands(rows, j):
        return False
    from_x, from_y = x - rows[j, 0], y - rows[j, 1]
    end_x, end_y = goal_x - rows[j, 0], goal_y - rows[j, 1]
    away = closest_approach(from_x, from_y, end_x, end_y)
    return away < rows[j, 4] + p.robot_radius


@function
def _stands(rows, j):
    return rows[j, 2] * rows[j, 2] + rows[j, 3] * rows[j, 3] < STANDING * STANDING


@function
def _way_round(from_x, from_y, end_x, end_y, radius, heading, side, p):
    """Round a disc about the origin, 1: counter-clockwise: two tangents and an arc between, m."""
    a = max(math.sqrt(from_x * from_x + from_y * from_y), radius)
    b = max(math.sqrt(end_x * end_x + end_y * end_y), radius)
    cross, dot = from_x * end_y - from_y * end_x, from_x * end_x + from_y * end_y
    between = side * math.atan2(cross, dot)
    if between < _ZERO:
        between += _TWO_PI
    arc = max(between - math.acos(radius / a) - math.acos(radius / b), _ZERO)
    tangents = math.sqrt(a * a - radius * radius) + math.sqrt(b * b - radius * radius)
    bearing = math.atan2(-from_y, -from_x) - side * math.asin(radius / a)
    return tangents + radius * arc + _turn(bearing - heading, p)


@function
def _turn(angle, p):
    """What turning by an angle counts, so that turning on the spot is better than standing, m."""
    if p.kinematics == HOLONOMIC:
        return _ZERO
    return TURN * abs(math.atan2(math.sin(angle), math.cos(angle)))
