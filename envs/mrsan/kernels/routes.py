"""Shortest routes round walls: a graph of corners, and the next corner on the way to a goal.

The nodes of the graph are the convex corners of the walls, moved away from them by the clearance
(`Scenario.route_clearance`). Two of them are linked if a disc of that radius can move between them.
For each agent `State.route_cost` holds the length of the shortest route from every corner to its
goal, and `State.route_corner` the corner to which it is heading, or a `GOAL` or `NO_ROUTE`.
"""

import math

import numpy as np

from mrsan.kernels import function, separate
from mrsan.kernels.walls import (
    AFTER_X,
    AFTER_Y,
    ALONG_X,
    ALONG_Y,
    BEFORE_X,
    BEFORE_Y,
    CLEARANCE,
    CORNERS,
    END_CONVEX,
    END_X,
    END_Y,
    START_CONVEX,
    START_X,
    START_Y,
    WALLS,
    WINDING,
    is_clear,
    nearest_point,
    sees,
    winding_number,
)

GOAL = -1  # the agent heads straight for its goal
NO_ROUTE = -2
UPDATE_EVERY = 4  # steps between two updates of an agent's next corner

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_PI = np.float32(math.pi)
_TWO_PI = np.float32(2.0 * math.pi)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_FAR = np.float32(np.inf)
_SLACK = np.float32(1e-3)  # m, by which routes may undercut the clearance
_SHARP = np.float32(-0.1)  # cosine of a turn; sharper corners have two nodes
_GENTLE = np.float32(0.9)  # cosine of a turn; walls with gentler ones count as round
_STRAIGHT = np.float32(0.999)  # cosine of a turn; straighter corners have no node
_REACHED = np.float32(0.3)  # m, distance at which a corner counts as reached


@function
def is_free(walls, place, x, y):
    """Return whether (x, y) is on the floor, with clearance from all walls."""
    count = int(place[WALLS])
    return winding_number(walls, count, x, y) == int(place[WINDING]) and is_clear(
        walls, count, x, y, _ZERO, _ZERO, place[CLEARANCE] - _SLACK
    )


@function
def _can_move(walls, place, x, y, to_x, to_y):
    """Return whether a disc of the clearance can move straight from one place to another."""
    count, radius = int(place[WALLS]), place[CLEARANCE] - _SLACK
    return is_clear(walls, count, x, y, to_x - x, to_y - y, radius)


@separate
def build_corners(walls, place, corners, linked):
    """Write the nodes of the graph and their links; the number of nodes goes into `place`.

    Args:
        walls: [12, W].
        place: [8], the description of the place.
        corners: [2, V], written.
        linked: [V, V] bool, written.
    """
    count, n = int(place[WALLS]), 0
    away = place[CLEARANCE]
    for k in range(count):
        if walls[START_CONVEX, k] < _HALF:
            continue
        x, y = walls[START_X, k], walls[START_Y, k]
        bx, by, ax, ay = (
            walls[BEFORE_X, k],
            walls[BEFORE_Y, k],
            walls[ALONG_X, k],
            walls[ALONG_Y, k],
        )
        cosine = bx * ax + by * ay
        if cosine > _STRAIGHT:
            continue
        if cosine > _GENTLE and _GENTLE < _next_cosine(walls, k) <= _STRAIGHT:  # a round wall
            if k % 2 == 0:
                scale = _beyond_round_wall(walls, k, cosine, away) / math.sqrt(_TWO + _TWO * cosine)
                n = _add_corner(
                    walls, place, corners, n, x, y, x + scale * (by + ay), y - scale * (bx + ax)
                )
            continue
        # The free side of a direction (dx, dy) is (dy, -dx).
        if cosine >= _SHARP:
            scale = away / (_ONE + cosine)
            n = _add_corner(
                walls, place, corners, n, x, y, x + scale * (by + ay), y - scale * (bx + ax)
            )
        else:  # beyond the corner, on both sides
            n = _add_corner(
                walls, place, corners, n, x, y, x + away * (by + bx), y + away * (by - bx)
            )
            n = _add_corner(
                walls, place, corners, n, x, y, x + away * (ay - ax), y - away * (ax + ay)
            )
    place[CORNERS] = np.float32(n)
    for i in range(n):
        linked[i, i] = False
        for j in range(i):
            free = _can_move(
                walls, place, corners[0, i], corners[1, i], corners[0, j], corners[1, j]
            )
            linked[i, j] = linked[j, i] = free


@function
def _next_cosine(walls, k):
    """Return the cosine of the turn at the end of a wall; above 1 if it is not convex."""
    if walls[END_CONVEX, k] < _HALF:
        return _TWO
    return walls[ALONG_X, k] * walls[AFTER_X, k] + walls[ALONG_Y, k] * walls[AFTER_Y, k]


@function
def _beyond_round_wall(walls, k, cosine, away):
    """Return how far beyond a vertex of a regular polygon a node lies, if every other has one, m.

    Then the way between two nodes keeps the clearance `away` from the vertex between them.
    """
    dx, dy = walls[END_X, k] - walls[START_X, k], walls[END_Y, k] - walls[START_Y, k]
    half_sine = math.sqrt(_HALF * (_ONE - cosine))  # of half the turn
    radius = _HALF * _distance(dx, dy) / half_sine
    return (radius + away) / cosine - radius


@function
def _add_corner(walls, place, corners, n, corner_x, corner_y, x, y):
    """Add a node if routes may turn there and there is room for it; return their number."""
    if (
        n < corners.shape[1]
        and is_free(walls, place, x, y)
        and _turns_round(walls, place, corner_x, corner_y, x, y)
    ):
        corners[0, n], corners[1, n] = x, y
        return n + 1
    return n


@function
def _turns_round(walls, place, corner_x, corner_y, x, y):
    """Return whether walls fill less than half of the angle around a corner, as seen from a node.

    Where another wall joins, the node may be in a niche in which no shortest route turns.
    """
    left = right = _TWO_PI  # angles from the node to the nearest walls on both sides
    for k in range(int(place[WALLS])):
        near_x, near_y = nearest_point(walls, k, corner_x, corner_y)
        if _distance(near_x - corner_x, near_y - corner_y) > _SLACK:
            continue
        for end_x, end_y in (
            (walls[START_X, k], walls[START_Y, k]),
            (walls[END_X, k], walls[END_Y, k]),
        ):
            dx, dy = end_x - corner_x, end_y - corner_y
            if _distance(dx, dy) <= _SLACK:
                continue
            out_x, out_y = x - corner_x, y - corner_y
            angle = math.atan2(out_x * dy - out_y * dx, out_x * dx + out_y * dy)
            left = min(left, angle if angle >= _ZERO else angle + _TWO_PI)
            right = min(right, -angle if angle <= _ZERO else _TWO_PI - angle)
    return left + right > _PI


@function
def write_route_costs(walls, place, corners, linked, goal_x, goal_y, cost):
    """Write the length of the shortest route from every corner to a goal (Dijkstra's algorithm).

    Args:
        walls: [12, W].
        place: [8].
        corners: [2, V].
        linked: [V, V].
        goal_x: the goal, m.
        goal_y: likewise.
        cost: [V], written; inf where there is no route, m.
    """
    n = int(place[CORNERS])
    for v in range(n):
        x, y = corners[0, v], corners[1, v]
        cost[v] = _FAR
        if _can_move(walls, place, x, y, goal_x, goal_y):
            cost[v] = _distance(x - goal_x, y - goal_y)
    for _ in range(n):  # the costs of settled corners are negative meanwhile: -1 - cost
        nearest, least = -1, _FAR
        for v in range(n):
            if _ZERO <= cost[v] < least:
                nearest, least = v, cost[v]
        if nearest < 0:
            break
        cost[nearest] = -_ONE - least
        x, y = corners[0, nearest], corners[1, nearest]
        for v in range(n):
            if linked[nearest, v] and cost[v] >= _ZERO:
                through = least + _distance(corners[0, v] - x, corners[1, v] - y)
                cost[v] = min(cost[v], through)
    for v in range(n):
        if cost[v] < _ZERO:
            cost[v] = -_ONE - cost[v]


@function
def find_corner(walls, place, corners, cost, x, y, goal_x, goal_y):
    """Return the first corner of the shortest route from (x, y), `GOAL` or `NO_ROUTE`."""
    if _can_move(walls, place, x, y, goal_x, goal_y):
        return GOAL
    best, least = NO_ROUTE, _FAR
    for v in range(int(place[CORNERS])):
        dx, dy = corners[0, v] - x, corners[1, v] - y
        length = _distance(dx, dy) + cost[v]
        if length < least and _can_move(walls, place, x, y, corners[0, v], corners[1, v]):
            best, least = v, length
    if best != NO_ROUTE:
        return best
    # Too close to a wall for the clearance: whatever is in sight.
    count = int(place[WALLS])
    if sees(walls, count, x, y, goal_x - x, goal_y - y):
        return GOAL
    for v in range(int(place[CORNERS])):
        dx, dy = corners[0, v] - x, corners[1, v] - y
        length = _distance(dx, dy) + cost[v]
        if length < least and sees(walls, count, x, y, dx, dy):
            best, least = v, length
    return best


@separate
def plan_route(walls, place, corners, linked, x, y, goal_x, goal_y, cost):
    """Write the costs of the corners for a goal; return the first corner from (x, y)."""
    write_route_costs(walls, place, corners, linked, goal_x, goal_y, cost)
    return find_corner(walls, place, corners, cost, x, y, goal_x, goal_y)


@separate
def follow_route(walls, place, corners, linked, cost, corner, x, y, goal_x, goal_y):
    """Return the corner to head for from (x, y), where the agent headed for `corner` before."""
    count = int(place[WALLS])
    if _can_move(walls, place, x, y, goal_x, goal_y):
        return GOAL
    if corner < 0:
        if corner == GOAL and sees(walls, count, x, y, goal_x - x, goal_y - y):
            return GOAL
        return find_corner(walls, place, corners, cost, x, y, goal_x, goal_y)
    corner_x, corner_y = corners[0, corner], corners[1, corner]
    following = _following(place, corners, linked, cost, corner)
    if following >= 0:
        next_x, next_y = corners[0, following], corners[1, following]
        reached = _distance(corner_x - x, corner_y - y) < _REACHED
        if (reached and sees(walls, count, x, y, next_x - x, next_y - y)) or _can_move(
            walls, place, x, y, next_x, next_y
        ):
            return following
    elif _distance(corner_x - x, corner_y - y) < _REACHED and sees(
        walls, count, x, y, goal_x - x, goal_y - y
    ):
        return GOAL
    if sees(walls, count, x, y, corner_x - x, corner_y - y):
        return corner
    return find_corner(walls, place, corners, cost, x, y, goal_x, goal_y)


@function
def _following(place, corners, linked, cost, corner):
    """Return the corner after `corner` on its shortest route, or `GOAL`."""
    best, least = GOAL, _FAR
    for v in range(int(place[CORNERS])):
        if linked[corner, v] and cost[v] < cost[corner]:
            length = _distance(
                corners[0, v] - corners[0, corner], corners[1, v] - corners[1, corner]
            )
            if length + cost[v] < least:
                best, least = v, length + cost[v]
    return best if least <= cost[corner] + _SLACK else GOAL


@function
def route_length(corners, cost, corner, x, y, goal_x, goal_y):
    """Return the length of the route from (x, y) by way of `corner`, m; inf if there is none."""
    if corner == NO_ROUTE:
        return _FAR
    if corner == GOAL:
        return _distance(goal_x - x, goal_y - y)
    return _distance(corners[0, corner] - x, corners[1, corner] - y) + cost[corner]


@function
def _distance(dx, dy):
    return math.sqrt(dx * dx + dy * dy)
