"""The walls and routes of a state as polygons and points, for drawings and checks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels.routes import GOAL
from mrsan.kernels.walls import CORNERS, WALLS
from mrsan.state import State

_ROUNDING = 1e-4  # m


def walls_of(state: State, world: int) -> NDArray[np.float32]:
    """Return the wall segments of one world, [W, 4]: x and y of their starts and ends, m."""
    count = int(state.place[world, WALLS]) if state.place.shape[1] else 0
    return state.walls[world, :4, :count].T


def polygons_of(state: State, world: int) -> list[NDArray[np.float64]]:
    """Return the vertices of the polygons of a world's place, [K, 2] each, m.

    Two vertices are a thin wall. The first polygon of every family bounds the floor.
    """
    segments = walls_of(state, world).astype(float)
    polygons, first = [], 0
    for k, (_, _, end_x, end_y) in enumerate(segments):
        if (end_x, end_y) == tuple(segments[first, :2]):
            polygons.append(segments[first : k + 1, :2])
            first = k + 1
    return polygons


def route_of(
    state: State, world: int, agent: int, start: NDArray[np.float32], goal: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Return the points of the shortest route of an agent, [P, 2], m.

    Agents are numbered people first, then robots; `start` is where the next corner was found.
    """
    count, corner = int(state.place[world, CORNERS]), int(state.route_corner[world, agent])
    corners = state.corners[world, :2, :count].T.astype(float)
    cost = state.route_cost[world, agent, :count]
    points = [start.astype(float)]
    while corner != GOAL:
        points.append(corners[corner])
        ways = np.linalg.norm(corners - corners[corner], axis=1)
        is_linked = state.corner_distance[world, corner, :count] < ways + _ROUNDING
        is_on_route = np.abs(ways + cost - cost[corner]) < _ROUNDING
        following = is_linked & is_on_route & (cost < cost[corner])
        corner = int(np.where(following, ways, np.inf).argmin()) if following.any() else GOAL
    return np.array([*points, goal.astype(float)])
