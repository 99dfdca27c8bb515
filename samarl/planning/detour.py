"""Length of the path to a goal around people and robots that stand still.

Ranked by straight-line distance alone, a robot would wait forever behind a parked robot, because
every detour leads away from the goal at first.
"""

import math

import numpy as np

from mrsan.kernels import function
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.kinematics import HOLONOMIC

STANDING_SPEED = np.float32(0.1)  # slower agents count as standing, m/s
TURN_COST = np.float32(0.2)  # path length charged for turning to the initial bearing, m/rad
LEFT_COST = np.float32(0.1)  # path length charged for passing on the left, m

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)


@function
def remaining_path_length(rows, count, x, y, heading, goal_x, goal_y, p):
    """Return the length of the path from (x, y) to the goal around standing agents, m.

    The path passes all of them on the same side. The left side costs slightly more; otherwise two
    robots facing each other would turn back and forth forever. Turning towards the start of the
    path costs slightly more too, so turning in place is better than waiting.

    Args:
        rows: the robot and the others, `[px, py, vx, vy, radius]` from `gather_rows`, m and m/s.
        count: number of rows in use.
        x: position of the robot in the frame of `rows`, m.
        y: likewise.
        heading: heading of the robot, rad.
        goal_x: position of the goal, m.
        goal_y: likewise.
        p: the scenario's parameters.
    """
    to_x, to_y = goal_x - x, goal_y - y
    straight = math.sqrt(to_x * to_x + to_y * to_y)
    straight += _turn_cost(math.atan2(to_y, to_x) - heading, p)
    right_length = left_length = straight
    for j in range(1, count):
        if _is_obstacle(rows, count, j, x, y, goal_x, goal_y, p):
            radius = rows[j, 4] + p.robot_radius
            from_x, from_y = x - rows[j, 0], y - rows[j, 1]
            end_x, end_y = goal_x - rows[j, 0], goal_y - rows[j, 1]
            right_length = max(
                right_length, _detour_length(from_x, from_y, end_x, end_y, radius, heading, _ONE, p)
            )
            left_length = max(
                left_length, _detour_length(from_x, from_y, end_x, end_y, radius, heading, -_ONE, p)
            )
    return min(right_length, left_length + LEFT_COST)


@function
def _is_obstacle(rows, count, j, x, y, goal_x, goal_y, p):
    """Return whether row `j` blocks the line from (x, y) to the goal.

    A standing agent also counts if there is no room to pass between it and one that does.
    """
    if _blocks_line(rows, j, x, y, goal_x, goal_y, p):
        return True
    if not _is_standing(rows, j):
        return False
    for i in range(1, count):
        dx, dy = rows[i, 0] - rows[j, 0], rows[i, 1] - rows[j, 1]
        passable = rows[i, 4] + rows[j, 4] + p.robot_radius + p.robot_radius
        if dx * dx + dy * dy < passable * passable and _blocks_line(
            rows, i, x, y, goal_x, goal_y, p
        ):
            return True
    return False


@function
def _blocks_line(rows, j, x, y, goal_x, goal_y, p):
    """Return whether row `j` stands too close to the line from (x, y) to the goal."""
    if not _is_standing(rows, j):
        return False
    from_x, from_y = x - rows[j, 0], y - rows[j, 1]
    end_x, end_y = goal_x - rows[j, 0], goal_y - rows[j, 1]
    distance = closest_approach(from_x, from_y, end_x, end_y)
    return distance < rows[j, 4] + p.robot_radius


@function
def _is_standing(rows, j):
    return rows[j, 2] * rows[j, 2] + rows[j, 3] * rows[j, 3] < STANDING_SPEED * STANDING_SPEED


@function
def _detour_length(from_x, from_y, end_x, end_y, radius, heading, side, p):
    """Return the length of two tangents and the arc between them around a disc at the origin, m.

    `side` is 1 for counter-clockwise and -1 for clockwise.
    """
    a = max(math.sqrt(from_x * from_x + from_y * from_y), radius)
    b = max(math.sqrt(end_x * end_x + end_y * end_y), radius)
    cross, dot = from_x * end_y - from_y * end_x, from_x * end_x + from_y * end_y
    between = side * math.atan2(cross, dot)
    if between < _ZERO:
        between += _TWO_PI
    arc = max(between - math.acos(radius / a) - math.acos(radius / b), _ZERO)
    tangents = math.sqrt(a * a - radius * radius) + math.sqrt(b * b - radius * radius)
    bearing = math.atan2(-from_y, -from_x) - side * math.asin(radius / a)
    return tangents + radius * arc + _turn_cost(bearing - heading, p)


@function
def _turn_cost(angle, p):
    """Return the path length charged for turning by `angle`, m; holonomic robots need no turn."""
    if p.kinematics == HOLONOMIC:
        return _ZERO
    return TURN_COST * abs(math.atan2(math.sin(angle), math.cos(angle)))
