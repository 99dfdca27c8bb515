"""The beginning of an episode: who starts where, and where they want to go."""

import math

import numpy as np
from numba import prange

from mrsan.kernels import function, kernel, rng
from mrsan.kernels.habits import NEVER, entry_of, place_beside, walking_speed, walks_along
from mrsan.kernels.layout import (
    CIRCLE,
    IMPATIENT,
    draw_human_goal,
    draw_human_start,
    draw_robot_way,
    guess_human_start,
    layout_of,
)
from mrsan.kernels.recorded import (
    NOT_ASSIGNED,
    RECORDED,
    begin_recording,
    draw_recorded_way,
    follow,
)
from mrsan.kernels.tally import CLOSEST_HUMAN, SOONEST_COLLISION

_ZERO = np.float32(0.0)
_FAR = np.float32(np.inf)

# Where it is crowded nearly every place that is drawn is taken, and a map of cells says so at once.
_PATIENCE = 8  # attempts after which the map is looked at
_CELLS = 128  # along either side of it
_CELL = np.float32(0.2)  # side of one, m
_HALF_MAP = np.float32(0.5 * _CELLS) * _CELL
_SLACK = np.float32(1e-3)  # more than rounding, or a guess, can do to a distance on it, m
_AT_ONCE = 16  # attempts that are looked up on it together

# Attempts to place an agent before the scenario is given up. Where the place is widened (see
# `layout`), nearly every scenario needs far fewer.
_MOST_ATTEMPTS = 50_000
_MOST_RECORDED_ATTEMPTS = 20_000  # each looks at everybody in the recording

# Why an episode could not begin, see `begin_episodes`.
NO_ROOM_FOR_ROBOTS = 1
NO_ROOM_FOR_PEOPLE = 2
_NOT_PLACED = -1


@kernel
def begin_episodes(chunks, worlds, state, p, recording, problem):
    """Start the next episode in each world whose mask `worlds` is set: state as of step 0.

    Args:
        chunks: number of pieces the loop over worlds is cut into.
        worlds: [E] bool.
        state: the worlds.
        p: the scenario's parameters.
        recording: the tracks of recorded people.
        problem: [E] int8, written: 0, or `NO_ROOM_FOR_*` in a world that could not begin.
    """
    total = worlds.shape[0]
    for chunk in prange(chunks):
        taken = np.empty((_CELLS, _CELLS), np.bool_)
        guessed = np.empty((2, _AT_ONCE), np.float32).T
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            if worlds[e]:
                problem[e] = _begin(state, e, p, recording, taken, guessed)
                if problem[e] != 0:
                    break


@function
def _begin(state, e, p, recording, taken, guessed):
    """Begin the episode of world `e`; return 0, or why there is no room for everybody."""
    key = rng.episode_key(state.case[e], state.episode[e])
    state.key[e] = key
    state.clock[e] = 0
    state.terminated[e] = False
    state.truncated[e] = False
    layout = layout_of(key, p)
    if p.crowd == RECORDED:
        begin_recording(state, e, key, recording, p)
    for i in range(state.robot_heading.shape[1]):
        if not _place_robot(state, e, i, key, layout, recording, p):
            return NO_ROOM_FOR_ROBOTS
    if p.crowd == RECORDED:
        state.human_present[e, :], state.human_track[e, :] = False, NOT_ASSIGNED
        state.human_entry[e, :] = 0
        follow(state, e, recording, p)
        return 0
    low, high = p.humans_min, state.human_radius.shape[1]
    share = rng.uniform(key, rng.HUMAN_COUNT, 0, 0, 0)
    count = min(low + int(share * np.float32(high - low + 1)), high)
    marked = 0
    for j in range(high):
        state.human_present[e, j] = j < count
        state.human_entry[e, j] = 0 if j < count else NEVER
        if j < count:
            marked = _place_human(state, e, j, key, layout, p, taken, guessed, marked)
            if marked == _NOT_PLACED:
                return NO_ROOM_FOR_PEOPLE
            state.human_entry[e, j] = entry_of(key, j - 1 if walks_along(key, j, p) else j, p)
            state.human_present[e, j] = state.human_entry[e, j] == 0
    return 0


@function
def _place_robot(state, e, i, key, layout, recording, p):
    """Draw start and goal of robot `i` until they keep clear of the others; return success."""
    position, goal = state.robot_position[e], state.robot_goal[e]
    gap = p.robot_radius + p.robot_radius + p.spawn_clearance
    placed = False
    for attempt in range(_MOST_RECORDED_ATTEMPTS if p.crowd == RECORDED else _MOST_ATTEMPTS):
        if p.crowd == RECORDED:
            begin = state.record_step[e]
            placed = draw_recorded_way(position[i], goal[i], key, i, attempt, begin, recording, p)
        else:
            placed = draw_robot_way(position[i], goal[i], key, i, attempt, layout, p)
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
    state.arrived[e, i] = False
    state.collision[e, i] = 0
    state.last_contact[e, i, :] = -1
    state.tally[e, i, :] = _ZERO
    state.tally[e, i, CLOSEST_HUMAN] = state.tally[e, i, SOONEST_COLLISION] = _FAR
    return placed


@function
def _place_human(state, e, j, key, layout, p, taken, guessed, marked):
    """Draw human `j` of world `e` until it has room.

    Returns:
        How many agents the map `taken` knows now, or `_NOT_PLACED`.
    """
    robots = state.robot_heading.shape[1]
    position, goal = state.human_position[e], state.human_goal[e]
    radius = rng.uniform_between(
        p.human_radius_min, p.human_radius_max, key, rng.HUMAN_TRAITS, j, 0, 0
    )
    speed = rng.uniform_between(
        p.human_speed_min, p.human_speed_max, key, rng.HUMAN_TRAITS, j, 0, 1
    )
    paired = walks_along(key, j, p)
    speed = state.human_speed[e, j - 1] if paired else walking_speed(speed, key, j, p)
    state.human_radius[e, j] = radius
    state.human_speed[e, j] = speed
    state.human_velocity[e, j, 0] = state.human_velocity[e, j, 1] = _ZERO
    attempt = 0
    if paired:
        place_beside(position, goal, state.human_radius[e], j, key, attempt)
        while not _has_room(state, e, j, j - 1, p):
            attempt += 1
            if attempt >= _MOST_ATTEMPTS:
                return _NOT_PLACED
            place_beside(position, goal, state.human_radius[e], j, key, attempt)
        return marked
    draw_human_start(position[j], key, j, robots + j, attempt, speed, layout, p)
    while _is_taken(position[j], attempt, taken) or not _has_room(state, e, j, j, p):
        attempt += 1
        if attempt >= _MOST_ATTEMPTS:
            return _NOT_PLACED
        if attempt == _PATIENCE:
            _mark(state, e, marked, robots + j, p, taken)
            marked = robots + j
        if attempt >= _PATIENCE and layout == CIRCLE:
            attempt = _skip_taken(key, robots + j, attempt, speed, p, taken, guessed)
        draw_human_start(position[j], key, j, robots + j, attempt, speed, layout, p)
    draw_human_goal(position[j], goal[j], key, j, robots + j, attempt, speed, layout, p)
    return marked


@function
def _has_room(state, e, j, others, p):
    """Whether human `j` keeps clear of all robots and of the first `others` humans."""
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
def _is_taken(place, attempt, taken):
    """Whether the map says that there is no room for a human, which it does not until asked."""
    return attempt >= _PATIENCE and _on_map(place[0], place[1], taken)


@function
def _skip_taken(key, agent, attempt, speed, p, taken, guessed):
    """The next attempt on the circle for which the map does not say that there is no room."""
    while attempt < IMPATIENT:
        for k in range(guessed.shape[0]):
            guess_human_start(guessed[k], key, agent, attempt + k, speed, p)
        for k in range(guessed.shape[0]):
            if not _on_map(guessed[k, 0], guessed[k, 1], taken):
                return attempt + k
        attempt += guessed.shape[0]
    return attempt


@function
def _on_map(x, y, taken):
    """What the map says of a place; outside of it, that there may be room."""
    x, y = x + _HALF_MAP, y + _HALF_MAP
    if not (_ZERO <= x < _HALF_MAP + _HALF_MAP and _ZERO <= y < _HALF_MAP + _HALF_MAP):
        return False
    return taken[int(y / _CELL), int(x / _CELL)]


@function
def _mark(state, e, first, last, p, taken):
    """Mark the cells in which there is no room for a human because of agents `first` to `last`.

    Agents are robots, then humans. A cell is marked if all of it is too near to one of them for
    the smallest human: where the map says nothing there may still be no room.
    """
    robots = state.robot_heading.shape[1]
    if first == 0:
        taken[:, :] = False
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
                    taken[row, column] = True


@function
def _distance(a, b):
    dx, dy = a[0] - b[0], a[1] - b[1]
    return math.sqrt(dx * dx + dy * dy)
