"""Starts, goals and routes of agents in places with walls.

Starts and goals are drawn uniformly in the zones of the place, where there is room, until a route
joins them.
"""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.routes import (
    NO_ROUTE,
    find_route,
    follow_route,
    is_free,
    route_length,
)
from mrsan.kernels.walls import CROSSING_SHARE, REDRAWS, ZONES

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_GOAL_TRIES = 32


@function
def _draw_point(zones, zone, key, stream, agent, step, draw):
    """Draw a point in a zone."""
    x = rng.uniform_between(zones[zone, 0], zones[zone, 2], key, stream, agent, step, draw)
    y = rng.uniform_between(zones[zone, 1], zones[zone, 3], key, stream, agent, step, draw + 1)
    return x, y


@function
def _other_zone(zone, count, share):
    """Return a zone other than `zone`, by a number in [0, 1); the same if there is only one."""
    if count == 1:
        return zone
    return (zone + 1 + min(int(share * np.float32(count - 1)), count - 2)) % count


@function
def draw_robot_route_in_zones(state, e, i, key, attempt, p):
    """Draw start and goal of robot `i` in different zones; return whether there is a route."""
    walls, place, zones = state.walls[e], state.place[e], state.zones[e]
    start, goal = state.robot_position[e, i], state.robot_goal[e, i]
    count = int(place[ZONES])
    zone = min(int(rng.uniform(key, rng.START, i, attempt, 4) * np.float32(count)), count - 1)
    other = _other_zone(zone, count, rng.uniform(key, rng.START, i, attempt, 5))
    start[0], start[1] = _draw_point(zones, zone, key, rng.START, i, attempt, 0)
    goal[0], goal[1] = _draw_point(zones, other, key, rng.START, i, attempt, 2)
    if count == 1:
        dx, dy = goal[0] - start[0], goal[1] - start[1]
        squared = dx * dx + dy * dy
        if squared < p.route_length_min * p.route_length_min:
            return False
        if squared > p.route_length_max * p.route_length_max:
            return False
    if not (is_free(walls, place, start[0], start[1]) and is_free(walls, place, goal[0], goal[1])):
        return False
    agent = state.human_radius.shape[1] + i
    if assign_route(state, e, agent, start[0], start[1], goal[0], goal[1]):
        return True
    place[REDRAWS] += _ONE
    return False


@function
def draw_human_start_in_zones(state, e, j, agent, key, attempt):
    """Draw the start of human `j`, agent `agent` of the world; return whether it is free."""
    zones, place, start = state.zones[e], state.place[e], state.human_position[e, j]
    count = int(place[ZONES])
    share = rng.uniform(key, rng.START, agent, attempt, 4)
    zone = min(int(share * np.float32(count)), count - 1)
    start[0], start[1] = _draw_point(zones, zone, key, rng.START, agent, attempt, 0)
    return is_free(state.walls[e], place, start[0], start[1])


@function
def draw_goal_in_zones(state, e, j, key, step, turns_back, p):
    """Draw a goal for human `j`, which a route joins to its position; return success.

    It lies in another zone with the place's `crossing_share`, unless the person turns back, else in
    that where the person is or the nearest one, if possible at least `goal_distance` away.
    """
    walls, place, zones, goal = (
        state.walls[e],
        state.place[e],
        state.zones[e],
        state.human_goal[e, j],
    )
    x, y = state.human_position[e, j, 0], state.human_position[e, j, 1]
    count = int(place[ZONES])
    here = _nearest_zone(zones, count, x, y)
    for attempt in range(_GOAL_TRIES):
        draw, zone = 4 * attempt, here
        share = rng.uniform(key, rng.HUMAN_GOAL, j, step, draw + 2)
        if share < place[CROSSING_SHARE] and not turns_back:
            zone = _other_zone(here, count, rng.uniform(key, rng.HUMAN_GOAL, j, step, draw + 3))
        goal[0], goal[1] = _draw_point(zones, zone, key, rng.HUMAN_GOAL, j, step, draw)
        if not is_free(walls, place, goal[0], goal[1]):
            continue
        if zone == here and attempt < _GOAL_TRIES // 2:
            dx, dy = goal[0] - x, goal[1] - y
            if dx * dx + dy * dy < p.goal_distance * p.goal_distance:
                continue
        if assign_route(state, e, j, x, y, goal[0], goal[1]):
            return True
        place[REDRAWS] += _ONE
    return False


@function
def _nearest_zone(zones, count, x, y):
    """Return the zone that contains (x, y), or the nearest one."""
    best, least = 0, np.float32(np.inf)
    for z in range(count):
        dx = max(max(zones[z, 0] - x, x - zones[z, 2]), _ZERO)
        dy = max(max(zones[z, 1] - y, y - zones[z, 3]), _ZERO)
        if dx * dx + dy * dy < least:
            best, least = z, dx * dx + dy * dy
    return best


@function
def is_in_zone(state, e, x, y):
    """Return whether (x, y) lies in a zone."""
    zones = state.zones[e]
    for z in range(int(state.place[e, ZONES])):
        if zones[z, 0] <= x <= zones[z, 2] and zones[z, 1] <= y <= zones[z, 3]:
            return True
    return False


@function
def assign_route(state, e, agent, x, y, goal_x, goal_y):
    """Find the route of an agent (people first, then robots); return whether there is one."""
    state.route_corner[e, agent], state.route_next[e, agent] = find_route(
        state.walls[e],
        state.place[e],
        state.corners[e],
        state.corner_distance[e],
        x,
        y,
        goal_x,
        goal_y,
        state.route_cost[e, agent],
    )
    return state.route_corner[e, agent] != NO_ROUTE


@function
def join_goal(state, e, j):
    """Move the goal of human `j`, who walks with the one before, to where there is a route to it.

    The goal is beside that of the other person, or the same where a wall is in the way. Returns
    whether there is a route.
    """
    walls, place, goal = state.walls[e], state.place[e], state.human_goal[e]
    x, y = state.human_position[e, j, 0], state.human_position[e, j, 1]
    if is_free(walls, place, goal[j, 0], goal[j, 1]):
        if assign_route(state, e, j, x, y, goal[j, 0], goal[j, 1]):
            return True
    goal[j, 0], goal[j, 1] = goal[j - 1, 0], goal[j - 1, 1]
    return assign_route(state, e, j, x, y, goal[j, 0], goal[j, 1])


@function
def update_route(state, e, agent, x, y, goal_x, goal_y):
    """Update the corners for which an agent at (x, y) heads."""
    state.route_corner[e, agent], state.route_next[e, agent] = follow_route(
        state.walls[e],
        state.place[e],
        state.corners[e],
        state.corner_distance[e],
        state.route_cost[e, agent],
        state.route_corner[e, agent],
        state.route_next[e, agent],
        x,
        y,
        goal_x,
        goal_y,
    )


@function
def next_point(state, e, agent, goal_x, goal_y):
    """Return where the route of an agent leads next: a corner or the goal."""
    corner = state.route_corner[e, agent]
    if corner < 0:
        return goal_x, goal_y
    return state.corners[e, 0, corner], state.corners[e, 1, corner]


@function
def remaining_route(state, e, agent, x, y, goal_x, goal_y):
    """Return the length of the rest of an agent's route from (x, y), m."""
    cost, corner = state.route_cost[e, agent], state.route_corner[e, agent]
    length = route_length(state.corners[e], cost, corner, x, y, goal_x, goal_y)
    if length == np.float32(np.inf):
        dx, dy = goal_x - x, goal_y - y
        return math.sqrt(dx * dx + dy * dy)
    return length
