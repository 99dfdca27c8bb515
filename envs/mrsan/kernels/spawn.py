"""The beginning of an episode: starts and goals of robots and people."""

import math

import numpy as np

from mrsan.kernels import function, kernel, rng
from mrsan.kernels.habits import NEVER, entry_of, place_beside, walking_speed, walks_along
from mrsan.kernels.layout import (
    CIRCLE,
    IMPATIENT,
    approximate_human_start,
    draw_human_goal,
    draw_human_start,
    draw_robot_route,
    layout_of,
)
from mrsan.kernels.recorded import (
    NOT_ASSIGNED,
    begin_recording,
    draw_recorded_route,
    follow,
)
from mrsan.kernels.tally import CLOSEST_HUMAN, SOONEST_COLLISION

_ZERO = np.float32(0.0)
_FAR = np.float32(np.inf)

# In a crowd nearly every place that is drawn is occupied, which a map of cells tells quickly.
_ATTEMPTS_WITHOUT_MAP = 8  # attempts after which the map is used
_CELLS = 128  # along each side of the map
_CELL = np.float32(0.2)  # side of a cell, m
_HALF_MAP = np.float32(0.5 * _CELLS) * _CELL
_SLACK = np.float32(1e-3)  # exceeds the errors of rounding and of approximate starts, m
_BATCH = 16  # attempts that are looked up together

# Attempts to place an agent before the scenario is refused. As places are widened (see `layout`),
# nearly every scenario needs far fewer.
MOST_ATTEMPTS = 50_000
_MOST_RECORDED_ATTEMPTS = 20_000  # each examines all people of the recording

# Reasons why an episode could not begin, see `begin_episodes`.
NO_ROOM_FOR_ROBOTS = 1
NO_ROOM_FOR_PEOPLE = 2
NOT_PLACED = -1


@function
def draw_open_route(state, e, i, key, attempt, layout, recording, p):
    """Draw start and goal of robot `i`; return whether this attempt is permitted."""
    start, goal = state.robot_position[e, i], state.robot_goal[e, i]
    return draw_robot_route(start, goal, key, i, attempt, layout, p)


@function
def draw_route_among_recorded(state, e, i, key, attempt, layout, recording, p):
    """Draw the same among recorded people, and where the recording begins, which is one number."""
    start, goal = state.robot_position[e, i], state.robot_goal[e, i]
    begin_recording(state, e, key, recording, p)
    begin = state.record_step[e]
    return draw_recorded_route(start, goal, key, i, attempt, begin, recording, p)


@function
def straight_length(state, e, i):
    """Return the distance from the start of robot `i` to its goal, m."""
    return _distance(state.robot_position[e, i], state.robot_goal[e, i])


@function
def no_walls(state, e, attempt, p, place_parameters, fixed_map):
    """Draw no walls."""


@function
def _begin(
    state,
    e,
    p,
    recording,
    social,
    occupied,
    candidates,
    draw_route,
    route_length,
    place_people,
    place_human,
):
    """Begin the episode of world `e`; return 0, or `NO_ROOM_FOR_*`."""
    key = rng.episode_key(state.case[e], state.episode[e])
    state.key[e] = key
    state.clock[e] = 0
    state.terminated[e] = False
    state.truncated[e] = False
    layout = layout_of(key, p)
    for i in range(state.robot_heading.shape[1]):
        if not _place_robot(state, e, i, key, layout, recording, p, draw_route, route_length):
            return NO_ROOM_FOR_ROBOTS
    return place_people(
        state, e, key, layout, p, recording, social, occupied, candidates, place_human
    )


@function
def place_recorded_people(
    state, e, key, layout, p, recording, social, occupied, candidates, place_human
):
    """Assign slots to the people of a recording; return 0."""
    state.human_present[e, :], state.human_track[e, :] = False, NOT_ASSIGNED
    state.human_entry[e, :] = 0
    follow(state, e, recording, p)
    return 0


@function
def place_simulated_people(
    state, e, key, layout, p, recording, social, occupied, candidates, place_human
):
    """Draw which people there are, and their starts; return 0, or `NO_ROOM_FOR_PEOPLE`."""
    low, high = p.humans_min, state.human_radius.shape[1]
    share = rng.uniform(key, rng.HUMAN_COUNT, 0, 0, 0)
    count = min(low + int(share * np.float32(high - low + 1)), high)
    marked = 0
    for j in range(high):
        state.human_present[e, j] = j < count
        state.human_space[e, j], state.human_held_up[e, j] = p.human_safety_space, 0
        state.human_entry[e, j] = 0 if j < count else NEVER
        if j < count:
            marked = place_human(state, e, j, key, layout, p, social, occupied, candidates, marked)
            if marked == NOT_PLACED:
                return NO_ROOM_FOR_PEOPLE
            state.human_entry[e, j] = entry_of(key, j - 1 if walks_along(key, j, p) else j, p)
            state.human_present[e, j] = state.human_entry[e, j] == 0
    return 0


@function
def _place_robot(state, e, i, key, layout, recording, p, draw_route, route_length):
    """Draw start and goal of robot `i` until they are clear of the others; return success."""
    position, goal = state.robot_position[e], state.robot_goal[e]
    gap = p.robot_radius + p.robot_radius + p.spawn_clearance
    placed = False
    for attempt in range(_MOST_RECORDED_ATTEMPTS if p.people_recorded else MOST_ATTEMPTS):
        placed = draw_route(state, e, i, key, attempt, layout, recording, p)
        for k in range(i):  # starts and goals of the robots keep apart, all four pairs
            placed = placed and (
                min(
                    min(_distance(position[i], position[k]), _distance(goal[i], goal[k])),
                    min(_distance(position[i], goal[k]), _distance(goal[i], position[k])),
                )
                >= gap
            )
        if placed:
            break
    state.robot_heading[e, i] = math.atan2(goal[i, 1] - position[i, 1], goal[i, 0] - position[i, 0])
    state.robot_start[e, i, 0], state.robot_start[e, i, 1] = position[i, 0], position[i, 1]
    for k in range(2):
        state.robot_velocity[e, i, k] = _ZERO
        state.robot_acceleration[e, i, k] = _ZERO
    state.route_length[e, i] = state.route_left[e, i] = route_length(state, e, i)
    state.arrived[e, i] = False
    state.collision[e, i] = 0
    state.last_contact[e, i, :] = -1
    state.tally[e, i, :] = _ZERO
    state.tally[e, i, CLOSEST_HUMAN] = state.tally[e, i, SOONEST_COLLISION] = _FAR
    return placed


@function
def draw_traits(state, e, j, key, p):
    """Draw radius and speed of human `j`, who stands; return whether it walks beside another."""
    radius = rng.uniform_between(
        p.human_radius_min, p.human_radius_max, key, rng.HUMAN_TRAITS, j, 0, 0
    )
    speed = rng.uniform_between(
        p.human_speed_min, p.human_speed_max, key, rng.HUMAN_TRAITS, j, 0, 1
    )
    paired = walks_along(key, j, p)
    state.human_radius[e, j] = radius
    state.human_speed[e, j] = (
        state.human_speed[e, j - 1] if paired else walking_speed(speed, key, j, p)
    )
    state.human_velocity[e, j, 0] = state.human_velocity[e, j, 1] = _ZERO
    return paired


@function
def place_on_floor(state, e, j, key, layout, p, social, occupied, candidates, marked):
    """Draw the start of human `j` of world `e` until it has room.

    Returns:
        The number of agents marked on the map, or `NOT_PLACED`.
    """
    robots = state.robot_heading.shape[1]
    position, goal = state.human_position[e], state.human_goal[e]
    paired = draw_traits(state, e, j, key, p)
    speed = state.human_speed[e, j]
    attempt = 0
    if paired:
        place_beside(position, goal, state.human_radius[e], j, key, attempt)
        while not has_room(state, e, j, j - 1, p):
            attempt += 1
            if attempt >= MOST_ATTEMPTS:
                return NOT_PLACED
            place_beside(position, goal, state.human_radius[e], j, key, attempt)
        return marked
    draw_human_start(position[j], key, j, robots + j, attempt, speed, layout, p)
    while _is_occupied(position[j], attempt, occupied) or not has_room(state, e, j, j, p):
        attempt += 1
        if attempt >= MOST_ATTEMPTS:
            return NOT_PLACED
        if attempt == _ATTEMPTS_WITHOUT_MAP:
            _mark_cells(state, e, marked, robots + j, p, occupied)
            marked = robots + j
        if attempt >= _ATTEMPTS_WITHOUT_MAP and layout == CIRCLE:
            attempt = _skip_occupied(key, robots + j, attempt, speed, p, occupied, candidates)
        draw_human_start(position[j], key, j, robots + j, attempt, speed, layout, p)
    draw_human_goal(position[j], goal[j], key, j, robots + j, attempt, speed, layout, p)
    return marked


@function
def has_room(state, e, j, others, p):
    """Return whether human `j` is clear of all robots and of the first `others` humans."""
    position, radius = state.human_position[e], state.human_radius[e]
    for k in range(state.robot_heading.shape[1]):
        gap = radius[j] + p.robot_radius + p.spawn_clearance
        if not _distance(position[j], state.robot_position[e, k]) >= gap:
            return False
    for k in range(others):
        gap = radius[j] + radius[k] + p.spawn_clearance
        if not _distance(position[j], position[k]) >= gap:
            return False
    return True


@function
def _is_occupied(place, attempt, occupied):
    """Return whether the map, once it is used, has no room for a human at a place."""
    return attempt >= _ATTEMPTS_WITHOUT_MAP and _cell_is_occupied(place[0], place[1], occupied)


@function
def _skip_occupied(key, agent, attempt, speed, p, occupied, candidates):
    """Return the next attempt on the circle for which the map may have room."""
    while attempt < IMPATIENT:
        for k in range(candidates.shape[0]):
            approximate_human_start(candidates[k], key, agent, attempt + k, speed, p)
        for k in range(candidates.shape[0]):
            if not _cell_is_occupied(candidates[k, 0], candidates[k, 1], occupied):
                return attempt + k
        attempt += candidates.shape[0]
    return attempt


@function
def _cell_is_occupied(x, y, occupied):
    """Return whether the cell of a place is occupied; outside the map it is not."""
    x, y = x + _HALF_MAP, y + _HALF_MAP
    if not (_ZERO <= x < _HALF_MAP + _HALF_MAP and _ZERO <= y < _HALF_MAP + _HALF_MAP):
        return False
    return occupied[int(y / _CELL), int(x / _CELL)]


@function
def _mark_cells(state, e, first, last, p, occupied):
    """Mark the cells that agents `first` to `last` (robots, then humans) occupy.

    A cell is marked if all of it is too close to one of them for the smallest human, so an
    unmarked cell may have no room either.
    """
    robots = state.robot_heading.shape[1]
    if first == 0:
        occupied[:, :] = False
    for k in range(first, last):
        if k < robots:
            place, radius = state.robot_position[e, k], p.robot_radius
        else:
            place, radius = state.human_position[e, k - robots], state.human_radius[e, k - robots]
        x, y = place[0] + _HALF_MAP, place[1] + _HALF_MAP
        reach = radius + p.human_radius_min + p.spawn_clearance - _SLACK
        for row in range(
            max(int((y - reach) / _CELL), 0), min(int((y + reach) / _CELL) + 1, _CELLS)
        ):
            bottom = np.float32(row) * _CELL - y
            dy = max(abs(bottom), abs(bottom + _CELL))
            for column in range(
                max(int((x - reach) / _CELL), 0), min(int((x + reach) / _CELL) + 1, _CELLS)
            ):
                left = np.float32(column) * _CELL - x
                dx = max(abs(left), abs(left + _CELL))
                if dx * dx + dy * dy < reach * reach:
                    occupied[row, column] = True


@function
def _distance(a, b):
    dx, dy = a[0] - b[0], a[1] - b[1]
    return math.sqrt(dx * dx + dy * dy)


# `begin_episodes.variant` replaces these in places with walls, see `mrsan.kernels.walled_spawn`,
# for people who react to robots or walk in groups, see `mrsan.kernels.society`, and for recorded
# people.
most_places = 1
draw_walls = no_walls
draw_route = draw_open_route
route_length = straight_length
place_people = place_simulated_people
place_human = place_on_floor


@kernel
def begin_episodes(
    first, last, worlds, state, p, place_parameters, fixed_map, recording, social, problem
):
    """Begin an episode in each world of a mask: write its state at step 0.

    Args:
        first: the first world.
        last: the world after the last one.
        worlds: [E] bool.
        state: the worlds.
        p: the scenario's parameters.
        place_parameters: the numbers of `mrsan.place.Place`.
        fixed_map: the walls of a map file, see `mrsan.maps.FixedMap`.
        recording: the tracks of recorded people.
        social: how people react to robots and form groups, see `mrsan.kernels.society`.
        problem: [E] int8, written: 0, or `NO_ROOM_FOR_*` in a world that could not begin.
    """
    occupied = np.empty((_CELLS, _CELLS), np.bool_)
    candidates = np.empty((2, _BATCH), np.float32).T
    for e in range(first, last):
        if worlds[e]:
            for attempt in range(most_places):
                draw_walls(state, e, attempt, p, place_parameters, fixed_map)
                problem[e] = _begin(
                    state,
                    e,
                    p,
                    recording,
                    social,
                    occupied,
                    candidates,
                    draw_route,
                    route_length,
                    place_people,
                    place_human,
                )
                if problem[e] == 0:
                    break
            if problem[e] != 0:
                break
