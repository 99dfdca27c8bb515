"""The beginning of an episode: who starts where, and where they want to go."""

import math

import numpy as np
from numba import prange

from mrsan.kernels import function, kernel, rng

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)
_GROWTH = np.float32(0.05)
_ROUNDING = np.float32(1.0001)
_SQRT_2 = np.float32(math.sqrt(2.0))
_TRIES = 64  # tries before the circle is widened for an agent that finds no room
_GOAL_TRIES = 32
_FAR = np.float32(np.inf)


@kernel
def begin_episodes(chunks, worlds, state, p):
    """Start the next episode in each world whose mask `worlds` is set: state as of step 0."""
    total = worlds.shape[0]
    for chunk in prange(chunks):
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            if worlds[e]:
                _begin(state, e, p)


@function
def _begin(state, e, p):
    key = rng.episode_key(state.case[e], state.episode[e])
    state.key[e] = key
    state.clock[e] = 0
    state.terminated[e] = False
    state.truncated[e] = False
    for i in range(state.robot_heading.shape[1]):
        _place_robot(state, e, i, key, p)
    low, high = p.humans_min, state.human_radius.shape[1]
    share = rng.uniform(key, rng.HUMAN_COUNT, 0, 0, 0)
    count = min(low + int(share * np.float32(high - low + 1)), high)
    for j in range(high):
        state.human_present[e, j] = j < count
        if j < count:
            _place_human(state, e, j, key, p)


@function
def _place_robot(state, e, i, key, p):
    position, goal = state.robot_position[e], state.robot_goal[e]
    gap = p.robot_radius + p.robot_radius + p.spawn_clearance
    room = p.arena_radius - p.robot_radius - _SQRT_2 * p.spawn_jitter * p.robot_speed
    attempt = 0
    placed = False
    while not placed:
        _draw_crossing(position[i], goal[i], key, i, attempt, p.robot_speed, room, p)
        placed = True
        for k in range(i):  # starts and goals of the robots keep apart, all four pairs
            placed = placed and (
                min(
                    min(_distance(position[i], position[k]), _distance(goal[i], goal[k])),
                    min(_distance(position[i], goal[k]), _distance(goal[i], position[k])),
                )
                >= gap
            )
        attempt += 1
    state.robot_heading[e, i] = math.atan2(goal[i, 1] - position[i, 1], goal[i, 0] - position[i, 0])
    state.robot_start[e, i, 0], state.robot_start[e, i, 1] = position[i, 0], position[i, 1]
    for k in range(2):
        state.robot_velocity[e, i, k] = _ZERO
        state.robot_acceleration[e, i, k] = _ZERO
    state.arrived[e, i] = False
    state.collision[e, i] = 0
    state.path_length[e, i] = _ZERO
    state.closest_human[e, i] = _FAR
    state.driven_steps[e, i] = 0
    state.close_steps[e, i] = 0
    state.jerk_sum[e, i] = _ZERO


@function
def _place_human(state, e, j, key, p):
    robots = state.robot_heading.shape[1]
    position, goal = state.human_position[e], state.human_goal[e]
    radius = rng.uniform_between(
        p.human_radius_min, p.human_radius_max, key, rng.HUMAN_TRAITS, j, 0, 0
    )
    speed = rng.uniform_between(
        p.human_speed_min, p.human_speed_max, key, rng.HUMAN_TRAITS, j, 0, 1
    )
    state.human_radius[e, j] = radius
    state.human_speed[e, j] = speed
    state.human_velocity[e, j, 0] = state.human_velocity[e, j, 1] = _ZERO
    attempt = 0
    placed = False
    while not placed:
        _draw_crossing(position[j], goal[j], key, robots + j, attempt, speed, _FAR, p)
        placed = True
        for k in range(robots):
            gap = radius + p.robot_radius + p.spawn_clearance
            placed = placed and _distance(position[j], state.robot_position[e, k]) >= gap
        for k in range(j):
            gap = radius + state.human_radius[e, k] + p.spawn_clearance
            placed = placed and _distance(position[j], position[k]) >= gap
        attempt += 1


@function
def _draw_crossing(start, goal, key, agent, attempt, speed, room, p):
    """A start on the circle and the opposite goal, each coordinate of both jittered."""
    circle = p.circle_radius * (_ONE + _GROWTH * np.float32(attempt // _TRIES))
    if circle > room * _ROUNDING:  # a wall, and no room on the circle: anywhere inside
        circle = room * math.sqrt(rng.uniform(key, rng.START, agent, attempt, 5))
    angle = _TWO_PI * rng.uniform(key, rng.START, agent, attempt, 0)
    cos, sin = circle * math.cos(angle), circle * math.sin(angle)
    jitter = p.spawn_jitter * speed
    start[0] = cos + rng.uniform_between(-jitter, jitter, key, rng.START, agent, attempt, 1)
    start[1] = sin + rng.uniform_between(-jitter, jitter, key, rng.START, agent, attempt, 2)
    goal[0] = -cos + rng.uniform_between(-jitter, jitter, key, rng.START, agent, attempt, 3)
    goal[1] = -sin + rng.uniform_between(-jitter, jitter, key, rng.START, agent, attempt, 4)


@function
def draw_goal(x, y, key, agent, step, circle_radius, jitter, least_distance):
    """A new goal (x, y) on the circle for a human at (x, y), at least so far from it."""
    goal_x, goal_y = _ZERO, _ZERO
    for attempt in range(_GOAL_TRIES):
        draw = 3 * attempt
        angle = _TWO_PI * rng.uniform(key, rng.HUMAN_GOAL, agent, step, draw)
        goal_x = circle_radius * math.cos(angle) + rng.uniform_between(
            -jitter, jitter, key, rng.HUMAN_GOAL, agent, step, draw + 1
        )
        goal_y = circle_radius * math.sin(angle) + rng.uniform_between(
            -jitter, jitter, key, rng.HUMAN_GOAL, agent, step, draw + 2
        )
        dx, dy = goal_x - x, goal_y - y
        if dx * dx + dy * dy >= least_distance * least_distance:
            break
    return goal_x, goal_y


@function
def _distance(a, b):
    dx, dy = a[0] - b[0], a[1] - b[1]
    return math.sqrt(dx * dx + dy * dy)
