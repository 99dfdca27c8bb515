"""Another route to the goal: the shortest one that stays away from the next corner of the route."""

import math

import numpy as np
from numba import prange

from mrsan.kernels import function, kernel, separate
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.routes import (
    NO_ROUTE,
    X,
    Y,
    can_move_between,
    has_clearance,
    length_of,
    route_length,
)
from mrsan.kernels.walls import CORNERS
from mrsan.se2 import unrotate

DETOUR = np.float32(1.5)  # m, distance that the other route keeps from the next corner

_ZERO = np.float32(0.0)
_FAR = np.float32(np.inf)
_ROUNDING = np.float32(1e-4)


@kernel
def observe_other_route(chunks, worlds, state, other):
    """Write where another route of each robot leads, and by how much it is longer.

    Args:
        chunks: number of pieces the loop over worlds is cut into.
        worlds: [E] bool, the worlds to observe.
        state: the worlds.
        other: [E, N, 3], written: the first corner of the other route in the body frame, and by how
            much the route is longer than the shortest one, m; zeros if there is no other route.
    """
    total, n = other.shape[0], other.shape[1]
    for chunk in prange(chunks):
        cost = np.empty(max(state.corners.shape[2], 1), np.float32)
        unsettled = np.empty(max(state.corners.shape[2], 1), np.bool_)
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            if worlds[e]:
                for i in range(n):
                    _write_other_route(state, e, i, cost, unsettled, other[e, i])


@function
def _write_other_route(state, e, i, cost, unsettled, other):
    other[0], other[1], other[2] = _ZERO, _ZERO, _ZERO
    if state.place.shape[1] == 0:
        return
    agent = state.human_radius.shape[1] + i
    corner = state.route_corner[e, agent]
    if corner < 0:
        return
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    goal_x, goal_y = state.robot_goal[e, i, 0], state.robot_goal[e, i, 1]
    corners, shortest = state.corners[e], state.route_cost[e, agent]
    first, length = find_other_route(
        state.walls[e],
        state.place[e],
        corners,
        state.corner_distance[e],
        shortest,
        corner,
        x,
        y,
        goal_x,
        goal_y,
        cost,
        unsettled,
    )
    if first == NO_ROUTE:
        return
    cos, sin = math.cos(state.robot_heading[e, i]), math.sin(state.robot_heading[e, i])
    other[0], other[1] = unrotate(cos, sin, corners[X, first] - x, corners[Y, first] - y)
    least = route_length(corners, shortest, corner, x, y, goal_x, goal_y)
    other[2] = max(length - least, _ZERO)


@separate
def find_other_route(
    walls, place, corners, distance, shortest, corner, x, y, goal_x, goal_y, cost, unsettled
):
    """Return the first corner and the length of the shortest route that stays away from a corner.

    It keeps the distance `DETOUR` from it; if (x, y) is nearer, it starts by moving away. Returns
    `NO_ROUTE` and infinity if there is none, or if (x, y) has no clearance.

    Args:
        walls: [12, W].
        place: [8].
        corners: [6, V].
        distance: [V, V] lengths of the shortest routes between corners.
        shortest: [V] length of the shortest route from every corner to the goal, m.
        corner: the index of the corner to stay away from.
        x: where the route starts, m.
        y: likewise.
        goal_x: the goal, m.
        goal_y: likewise.
        cost: [V], room to work in: lengths of the routes found so far.
        unsettled: [V] bool, room to work in: the length may still become smaller.
    """
    n = int(place[CORNERS])
    ax, ay = corners[X, corner], corners[Y, corner]
    for v in range(n):
        vx, vy = corners[X, v], corners[Y, v]
        cost[v] = _FAR
        unsettled[v] = length_of(vx - ax, vy - ay) >= DETOUR
        to_goal = length_of(goal_x - vx, goal_y - vy)
        if unsettled[v] and shortest[v] <= to_goal + _ROUNDING:  # it leads straight to the goal
            if _stays_away(ax, ay, vx, vy, goal_x, goal_y):
                cost[v] = to_goal
    best, least = NO_ROUTE, _FAR
    if not has_clearance(walls, place, x, y):
        return best, least
    while True:  # Dijkstra's algorithm, from the goal
        u = -1
        for v in range(n):
            if unsettled[v] and cost[v] < _FAR and (u < 0 or cost[v] < cost[u]):
                u = v
        if u < 0 or cost[u] >= least:
            return best, least
        unsettled[u] = False
        ux, uy = corners[X, u], corners[Y, u]
        for v in range(n):
            if not unsettled[v]:
                continue
            vx, vy = corners[X, v], corners[Y, v]
            way = length_of(ux - vx, uy - vy)
            is_linked = distance[v, u] <= way + _ROUNDING
            if is_linked and cost[u] + way < cost[v] and _stays_away(ax, ay, vx, vy, ux, uy):
                cost[v] = cost[u] + way
        length = length_of(ux - x, uy - y) + cost[u]
        if length < least and _stays_away(ax, ay, x, y, ux, uy):
            if can_move_between(walls, place, x, y, ux, uy):
                best, least = u, length


@function
def _stays_away(ax, ay, x, y, to_x, to_y):
    """Return whether a straight way keeps the distance `DETOUR` from (ax, ay), or leads away."""
    leads_away = (ax - x) * (to_x - x) + (ay - y) * (to_y - y) <= _ZERO
    return leads_away or closest_approach(x - ax, y - ay, to_x - ax, to_y - ay) >= DETOUR
