"""Goals at which a robot that has arrived leaves room for the routes of its team-mates."""

import math

import numpy as np

from mrsan.kernels import function, separate
from mrsan.kernels.routes import X, Y, following_corner, has_clearance, length_of
from mrsan.kernels.walls import CLEARANCE

_DIRECTIONS = 24  # in which the room round a parked robot is examined

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)
_STEP = np.float32(2.0 * math.pi / _DIRECTIONS)
_ROUNDING = np.float32(1e-6)


@function
def goals_leave_room(state, e, count, p):
    """Return whether the first `count` robots can reach their goals whoever parks first."""
    for parked in range(count):
        for driver in range(count):
            if driver != parked and not _can_pass(state, e, driver, parked, count, p):
                return False
    return True


@separate
def _can_pass(state, e, driver, parked, count, p):
    """Return whether a robot on its route can pass one that has parked at its goal.

    Where the route comes too close to the parked robot, the driver leaves it on a circle, to the
    left or to the right; the circle must be clear of walls and of the goals of all others.
    """
    place, corners = state.place[e], state.corners[e]
    start, goal = state.robot_position[e], state.robot_goal[e]
    agent = state.human_radius.shape[1] + driver
    corner, following = state.route_corner[e, agent], state.route_next[e, agent]
    radius = p.robot_radius + place[CLEARANCE]
    enters, leaves, meets = _ZERO, _ZERO, False
    x, y = start[driver, 0] - goal[parked, 0], start[driver, 1] - goal[parked, 1]
    while True:
        to_x, to_y = goal[driver, 0], goal[driver, 1]
        if corner >= 0:
            to_x, to_y = corners[X, corner], corners[Y, corner]
        to_x, to_y = to_x - goal[parked, 0], to_y - goal[parked, 1]
        first, last = _share_inside(x, y, to_x - x, to_y - y, radius)
        if first < last:
            if not meets:
                enters = math.atan2(y + first * (to_y - y), x + first * (to_x - x))
            leaves = math.atan2(y + last * (to_y - y), x + last * (to_x - x))
            meets = True
        if corner < 0:
            break
        x, y = to_x, to_y
        corner = following
        following = following_corner(
            place, corners, state.corner_distance[e], state.route_cost[e, agent], corner
        )
    if not meets:
        return True
    left = (leaves - enters) % _TWO_PI
    return _is_arc_free(state, e, driver, parked, count, radius, enters, left, _ONE, p) or (
        _is_arc_free(state, e, driver, parked, count, radius, enters, _TWO_PI - left, -_ONE, p)
    )


@function
def _share_inside(x, y, dx, dy, radius):
    """Return between which shares of a way from (x, y) it is nearer to the origin than `radius`."""
    a = max(dx * dx + dy * dy, _ROUNDING)
    b = x * dx + y * dy
    root = b * b - a * (x * x + y * y - radius * radius)
    if root <= _ZERO:
        return _ONE, _ZERO
    root = math.sqrt(root)
    return max((-b - root) / a, _ZERO), min((-b + root) / a, _ONE)


@function
def _is_arc_free(state, e, driver, parked, count, radius, begin, angle, side, p):
    """Return whether a robot has room on an arc round a parked one, to the left for `side` 1."""
    walls, place, goal = state.walls[e], state.place[e], state.robot_goal[e]
    for k in range(int(angle / _STEP) + 1):
        direction = begin + side * np.float32(k) * _STEP
        x = goal[parked, 0] + radius * math.cos(direction)
        y = goal[parked, 1] + radius * math.sin(direction)
        if not has_clearance(walls, place, x, y):
            return False
        for other in range(count):
            if other != driver and other != parked:
                gap = length_of(goal[other, 0] - x, goal[other, 1] - y)
                if gap < p.robot_radius + p.robot_radius:
                    return False
    return True
