"""The beginning of an episode in a place with walls: the functions that `begin_episodes` calls."""

from functools import cache

import numpy as np

from mrsan.kernels import function, kernel, rng
from mrsan.kernels.habits import place_beside
from mrsan.kernels.layout import layout_of
from mrsan.kernels.parking import goals_leave_room
from mrsan.kernels.places import draw_place
from mrsan.kernels.routes import CORNER_ROWS, build_corners, is_free
from mrsan.kernels.spawn import NOT_PLACED, begin_episodes, draw_traits, has_room
from mrsan.kernels.walls import (
    CLEARANCE,
    DISCARDED,
    PLACE_COLUMNS,
    REDRAWS,
    WALL_ROWS,
    fill_up,
)
from mrsan.kernels.zones import (
    draw_goal_in_zones,
    draw_human_start_in_zones,
    draw_robot_route_in_zones,
    join_goal,
    remaining_route,
)

MOST_PLACES = 50  # places drawn for one case
_MOST_ATTEMPTS = 500  # to place an agent in one of them

_ZERO = np.float32(0.0)


@function
def draw_place_of_case(state, e, attempt, p, place_parameters, fixed_map):
    """Write the walls, zones and corners of the place of an episode."""
    place, walls = state.place[e], state.walls[e]
    key = rng.episode_key(state.case[e], state.episode[e])
    redraws = place[REDRAWS] if attempt > 0 else _ZERO
    if fixed_map.place.shape[0] > 0:
        for k in range(PLACE_COLUMNS):
            place[k] = fixed_map.place[k]
        for row in range(WALL_ROWS):
            for k in range(walls.shape[1]):
                walls[row, k] = fixed_map.walls[row, k]
        for k in range(4):
            state.zones[e, 0, k] = fixed_map.zone[k]
        for k in range(state.corners.shape[2]):
            for row in range(CORNER_ROWS):
                state.corners[e, row, k] = fixed_map.corners[row, k]
            for v in range(state.corners.shape[2]):
                state.corner_distance[e, k, v] = fixed_map.corner_distance[k, v]
    else:
        place[CLEARANCE] = p.route_clearance
        draw_place(walls, place, state.zones[e], key, layout_of(key, p), attempt, place_parameters)
        room = state.route_cost[e, 0]  # written later
        fill_up(walls, place)
        build_corners(walls, place, state.corners[e], state.corner_distance[e], room)
    place[REDRAWS], place[DISCARDED] = redraws, np.float32(attempt)


@function
def draw_walled_route(state, e, i, key, attempt, layout, recording, p):
    """Draw start and goal of robot `i`; return whether this attempt is permitted."""
    number = attempt + _MOST_ATTEMPTS * int(state.place[e, DISCARDED])
    return (
        attempt < _MOST_ATTEMPTS
        and draw_robot_route_in_zones(state, e, i, key, number, p)
        and goals_leave_room(state, e, i + 1, p)
    )


@function
def length_of_route(state, e, i):
    """Return the length of the shortest route of robot `i` from its start, m."""
    start, goal = state.robot_position[e, i], state.robot_goal[e, i]
    agent = state.human_radius.shape[1] + i
    return remaining_route(state, e, agent, start[0], start[1], goal[0], goal[1])


@function
def place_human_in_zone(state, e, j, key, layout, p, social, occupied, candidates, marked):
    """Draw start and goal of human `j`; return `marked`, or `NOT_PLACED`."""
    position, goal = state.human_position[e], state.human_goal[e]
    agent = state.robot_heading.shape[1] + j
    paired = draw_traits(state, e, j, key, p)
    for attempt in range(_MOST_ATTEMPTS):
        if paired:
            place_beside(position, goal, state.human_radius[e], j, key, attempt)
            free = is_free(state.walls[e], state.place[e], position[j, 0], position[j, 1])
        else:
            free = draw_human_start_in_zones(state, e, j, agent, key, attempt)
        if not (free and has_room(state, e, j, j - 1 if paired else j, p)):
            continue
        if paired and join_goal(state, e, j):
            return marked
        if draw_goal_in_zones(state, e, j, key, attempt, False, p):
            return marked
    return NOT_PLACED


@cache
def walled_begin() -> kernel:
    """Return the kernel that begins episodes in places with walls."""
    return begin_episodes.variant(
        "walled",
        most_places=MOST_PLACES,
        draw_walls=draw_place_of_case,
        draw_route=draw_walled_route,
        route_length=length_of_route,
        place_human=place_human_in_zone,
    )
