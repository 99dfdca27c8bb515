"""Shortest routes round walls: a graph of corners, and the next corner on the way to a goal.

The nodes of the graph are the convex corners of the walls, moved away from them by the clearance
(`Scenario.route_clearance`): the vertices of the walls' outlines at that distance. Two of them are
linked if a disc of that radius can move between them and a shortest route may turn at both.
For each agent `State.route_cost` holds the length of the shortest route from every corner to its
goal, `State.route_corner` the corner to which it is heading, or `GOAL` or `NO_ROUTE`, and
`State.route_next` the corner after that one.
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
    is_clear_between,
    nearest_point,
    sees,
    wall_count,
    winding_number,
)
from mrsan.se2 import rotate

# Rows of `State.corners`: the position of a corner, and the directions of the outline of the walls
# before and after it (not of unit length).
CORNER_ROWS = 6
X, Y, IN_X, IN_Y, OUT_X, OUT_Y = range(CORNER_ROWS)

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
_ROUNDING = np.float32(1e-4)
_REACHED = np.float32(0.3)  # m, distance at which a corner counts as reached


@function
def is_free(walls, place, x, y):
    """Return whether (x, y) is on the floor, with clearance from all walls."""
    count = wall_count(place)
    return winding_number(walls, count, x, y) == int(place[WINDING]) and has_clearance(
        walls, place, x, y
    )


@function
def has_clearance(walls, place, x, y):
    """Return whether (x, y) has clearance from all walls."""
    return is_clear(walls, wall_count(place), x, y, _ZERO, _ZERO, place[CLEARANCE] - _SLACK)


@function
def can_move_between(walls, place, x, y, to_x, to_y):
    """Return what `_can_move` does if both places have clearance."""
    count, radius = wall_count(place), place[CLEARANCE] - _SLACK
    return is_clear_between(walls, count, x, y, to_x - x, to_y - y, radius)


@function
def _can_move(walls, place, x, y, to_x, to_y):
    """Return whether a disc of the clearance can move straight from one place to another."""
    count, radius = wall_count(place), place[CLEARANCE] - _SLACK
    dx, dy = to_x - x, to_y - y
    return sees(walls, count, x, y, dx, dy) and is_clear(walls, count, x, y, dx, dy, radius)


@function
def _turns_at(corners, v, dx, dy):
    """Return whether a shortest route may have a corner at an end of a way along (dx, dy).

    It may if the outline of the walls stays on one side of the way.
    """
    before = dy * corners[IN_X, v] - dx * corners[IN_Y, v]
    after = dx * corners[OUT_Y, v] - dy * corners[OUT_X, v]
    return before * after >= -_ROUNDING * (dx * dx + dy * dy)


@separate
def build_corners(walls, place, corners, distance, row):
    """Write the nodes of the graph and their distances; their number goes into `place`.

    Args:
        walls: [12, W].
        place: [9], the description of the place.
        corners: [6, V], written: positions, and the directions of the outline before and after.
        distance: [V, V], written: lengths of the shortest routes; inf where there is none, m.
        row: [V], room to work in.
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
                half_cos = math.sqrt(_HALF * (_ONE + cosine))
                half_sin = math.sqrt(_HALF * (_ONE - cosine))
                in_x, in_y = rotate(half_cos, -half_sin, bx, by)
                out_x, out_y = rotate(half_cos, half_sin, ax, ay)
                px, py = x + scale * (by + ay), y - scale * (bx + ax)
                n = _add_corner(walls, place, corners, n, x, y, px, py, in_x, in_y, out_x, out_y)
            continue
        # The free side of a direction (dx, dy) is (dy, -dx).
        if cosine >= _SHARP:
            scale = away / (_ONE + cosine)
            px, py = x + scale * (by + ay), y - scale * (bx + ax)
            n = _add_corner(walls, place, corners, n, x, y, px, py, bx, by, ax, ay)
        else:  # beyond the corner, on both sides
            px, py = x + away * (by + bx), y + away * (by - bx)
            qx, qy = x + away * (ay - ax), y - away * (ax + ay)
            dx, dy = qx - px, qy - py
            n = _add_corner(walls, place, corners, n, x, y, px, py, bx, by, dx, dy)
            n = _add_corner(walls, place, corners, n, x, y, qx, qy, dx, dy, ax, ay)
    place[CORNERS] = np.float32(n)
    for i in range(n):
        x, y = corners[X, i], corners[Y, i]
        distance[i, i] = _ZERO
        for j in range(i):
            to_x, to_y = corners[X, j], corners[Y, j]
            dx, dy = to_x - x, to_y - y
            length = _FAR
            if _turns_at(corners, i, dx, dy) and _turns_at(corners, j, dx, dy):
                if can_move_between(walls, place, x, y, to_x, to_y):
                    length = length_of(dx, dy)
            distance[i, j] = distance[j, i] = length
    _shorten(distance, n, row)


@function
def _shorten(distance, n, row):
    """Replace lengths of links by those of shortest routes (the Floyd-Warshall algorithm)."""
    for k in range(n):
        for j in range(n):
            row[j] = distance[k, j]
        for i in range(n):
            through = distance[i, k]
            if through < _FAR:
                for j in range(n):
                    distance[i, j] = min(distance[i, j], through + row[j])


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
    radius = _HALF * length_of(dx, dy) / half_sine
    return (radius + away) / cosine - radius


@function
def _add_corner(walls, place, corners, n, corner_x, corner_y, x, y, in_x, in_y, out_x, out_y):
    """Add a node if routes may turn there and there is room for it; return their number."""
    if (
        n < corners.shape[1]
        and is_free(walls, place, x, y)
        and _turns_round(walls, place, corner_x, corner_y, x, y)
    ):
        corners[X, n], corners[Y, n] = x, y
        corners[IN_X, n], corners[IN_Y, n] = in_x, in_y
        corners[OUT_X, n], corners[OUT_Y, n] = out_x, out_y
        return n + 1
    return n


@function
def _turns_round(walls, place, corner_x, corner_y, x, y):
    """Return whether walls fill less than half of the angle around a corner, as seen from a node.

    Where another wall joins, the node may be in a niche in which no shortest route turns.
    """
    left = right = _TWO_PI  # angles from the node to the nearest walls on both sides
    for k in range(int(place[WALLS])):
        from_x, from_y = corner_x - walls[START_X, k], corner_y - walls[START_Y, k]
        across = from_x * walls[ALONG_Y, k] - from_y * walls[ALONG_X, k]
        if abs(across) > _SLACK:
            continue
        near_x, near_y = nearest_point(walls, k, corner_x, corner_y)
        if length_of(near_x - corner_x, near_y - corner_y) > _SLACK:
            continue
        for end_x, end_y in (
            (walls[START_X, k], walls[START_Y, k]),
            (walls[END_X, k], walls[END_Y, k]),
        ):
            dx, dy = end_x - corner_x, end_y - corner_y
            if length_of(dx, dy) <= _SLACK:
                continue
            out_x, out_y = x - corner_x, y - corner_y
            angle = math.atan2(out_x * dy - out_y * dx, out_x * dx + out_y * dy)
            left = min(left, angle if angle >= _ZERO else angle + _TWO_PI)
            right = min(right, -angle if angle <= _ZERO else _TWO_PI - angle)
    return left + right > _PI


@function
def write_route_costs(walls, place, corners, distance, goal_x, goal_y, cost):
    """Write the length of the shortest route from every corner to a goal.

    Args:
        walls: [12, W].
        place: [9].
        corners: [6, V].
        distance: [V, V].
        goal_x: the goal, m.
        goal_y: likewise.
        cost: [V], written; inf where there is no route, m.
    """
    n = int(place[CORNERS])
    for v in range(n):
        cost[v] = _FAR
    if not has_clearance(walls, place, goal_x, goal_y):
        return
    for u in range(n):
        x, y = corners[X, u], corners[Y, u]
        dx, dy = goal_x - x, goal_y - y
        if _turns_at(corners, u, dx, dy) and can_move_between(walls, place, x, y, goal_x, goal_y):
            last = length_of(dx, dy)
            for v in range(n):
                cost[v] = min(cost[v], distance[u, v] + last)


@function
def _find_corner(walls, place, corners, cost, x, y):
    """Return the first corner of the shortest route from (x, y) to a goal out of reach."""
    best, least = NO_ROUTE, _FAR
    if not has_clearance(walls, place, x, y):
        return best
    for v in range(int(place[CORNERS])):
        dx, dy = corners[X, v] - x, corners[Y, v] - y
        length = length_of(dx, dy) + cost[v]
        if length < least and _turns_at(corners, v, dx, dy):
            if can_move_between(walls, place, x, y, corners[X, v], corners[Y, v]):
                best, least = v, length
    return best


@function
def _find_corner_in_sight(walls, place, corners, cost, x, y):
    """Return the best corner in sight from (x, y), too close to a wall for the clearance."""
    count = wall_count(place)
    best, least = NO_ROUTE, _FAR
    for v in range(int(place[CORNERS])):
        dx, dy = corners[X, v] - x, corners[Y, v] - y
        length = length_of(dx, dy) + cost[v]
        if length < least and sees(walls, count, x, y, dx, dy):
            best, least = v, length
    return best


@separate
def find_route(walls, place, corners, distance, x, y, goal_x, goal_y, cost):
    """Write the costs of the corners for a goal; return the first two corners from (x, y).

    Either may be `GOAL`; the first may be `NO_ROUTE`.
    """
    write_route_costs(walls, place, corners, distance, goal_x, goal_y, cost)
    if _can_move(walls, place, x, y, goal_x, goal_y):
        return GOAL, GOAL
    corner = _find_corner(walls, place, corners, cost, x, y)
    if corner == NO_ROUTE and not has_clearance(walls, place, x, y):
        if sees(walls, wall_count(place), x, y, goal_x - x, goal_y - y):
            return GOAL, GOAL
        corner = _find_corner_in_sight(walls, place, corners, cost, x, y)
    return corner, following_corner(place, corners, distance, cost, corner)


@separate
def follow_route(walls, place, corners, distance, cost, corner, following, x, y, goal_x, goal_y):
    """Return the two corners to head for from (x, y), after `corner` and `following` before."""
    count = wall_count(place)
    if corner < 0:
        if sees(walls, count, x, y, goal_x - x, goal_y - y):
            return GOAL, GOAL
    else:
        near_x, near_y = corners[X, corner] - x, corners[Y, corner] - y
        to_x, to_y = goal_x, goal_y
        if following >= 0:
            to_x, to_y = corners[X, following], corners[Y, following]
        reached = near_x * near_x + near_y * near_y < _REACHED * _REACHED
        if sees(walls, count, x, y, to_x - x, to_y - y) and (
            reached or _can_move(walls, place, x, y, to_x, to_y)
        ):
            if following < 0:
                return GOAL, GOAL
            return following, following_corner(place, corners, distance, cost, following)
        if sees(walls, count, x, y, near_x, near_y):
            return corner, following
    # It has been pushed off its route.
    corner = _find_corner(walls, place, corners, cost, x, y)
    if corner == NO_ROUTE:
        corner = _find_corner_in_sight(walls, place, corners, cost, x, y)
    return corner, following_corner(place, corners, distance, cost, corner)


@function
def following_corner(place, corners, distance, cost, corner):
    """Return the corner after `corner` on its shortest route, or `GOAL`."""
    if corner < 0:
        return GOAL
    best, nearest = GOAL, _FAR
    for v in range(int(place[CORNERS])):
        way = length_of(corners[X, v] - corners[X, corner], corners[Y, v] - corners[Y, corner])
        is_linked = distance[corner, v] <= way + _ROUNDING
        is_on_route = cost[v] < cost[corner] and way + cost[v] <= cost[corner] + _ROUNDING
        if v != corner and is_linked and is_on_route and way < nearest:
            best, nearest = v, way
    return best


@function
def route_length(corners, cost, corner, x, y, goal_x, goal_y):
    """Return the length of the route from (x, y) by way of `corner`, m; inf if there is none."""
    if corner == NO_ROUTE:
        return _FAR
    if corner == GOAL:
        return length_of(goal_x - x, goal_y - y)
    return length_of(corners[X, corner] - x, corners[Y, corner] - y) + cost[corner]


@function
def length_of(dx, dy):
    """Return the length of a vector."""
    return math.sqrt(dx * dx + dy * dy)
