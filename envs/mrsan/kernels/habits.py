"""Habits of people: hurrying, standing, walking in pairs, entering late and leaving."""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.layout import widened

NEVER = -1  # entry step of a person who does not enter (again)

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_HALF_PI = np.float32(0.5 * math.pi)
_GOLDEN_ANGLE = np.float32(2.399963)  # multiples of it never repeat a direction, rad
_BESIDE = np.float32(0.2)  # surface distance of a pair, m
_HURRY_MIN, _HURRY_MAX = np.float32(1.5), np.float32(2.0)  # m/s, of people in a hurry
_ENTRY = np.float32(1.0)  # least surface distance of an entering person to robots, m

# Draws of the stream rng.HABITS.
_HURRY, _HURRY_SPEED, _LATE, _LATE_STEP, _SIDE, _PAIR, PATIENCE = range(7)


@function
def walking_speed(speed, key, j, p):
    """Return the preferred speed of human `j` in m/s: `speed`, unless the person is in a hurry."""
    if p.hurry_probability > _ZERO and (
        rng.uniform(key, rng.HABITS, j, 0, _HURRY) < p.hurry_probability
    ):
        return rng.uniform_between(_HURRY_MIN, _HURRY_MAX, key, rng.HABITS, j, 0, _HURRY_SPEED)
    return speed


@function
def walks_along(key, j, p):
    """Return whether human `j` forms a pair with the one before it."""
    if j % 2 == 0 or p.pair_probability == _ZERO:
        return False
    return rng.uniform(key, rng.HABITS, j, 0, _PAIR) < p.pair_probability


@function
def place_beside(position, goal, radius, j, key, attempt):
    """Write start and goal of human `j`, both beside those of the one before it."""
    dx, dy = goal[j - 1, 0] - position[j - 1, 0], goal[j - 1, 1] - position[j - 1, 1]
    side = _HALF_PI if rng.uniform(key, rng.HABITS, j, 0, _SIDE) < _HALF else -_HALF_PI
    angle = math.atan2(dy, dx) + side + _GOLDEN_ANGLE * np.float32(attempt)
    away = widened(radius[j] + radius[j - 1] + _BESIDE, attempt)
    offset_x, offset_y = away * math.cos(angle), away * math.sin(angle)
    position[j, 0], position[j, 1] = position[j - 1, 0] + offset_x, position[j - 1, 1] + offset_y
    goal[j, 0], goal[j, 1] = goal[j - 1, 0] + offset_x, goal[j - 1, 1] + offset_y


@function
def entry_of(key, j, p):
    """Return the step at which human `j` enters; 0: it is present from the beginning."""
    if p.late_probability == _ZERO or (
        rng.uniform(key, rng.HABITS, j, 0, _LATE) >= p.late_probability
    ):
        return 0
    return 1 + int(rng.uniform(key, rng.HABITS, j, 0, _LATE_STEP) * np.float32(p.late_steps))


@function
def stands(key, j, step, p):
    """Return whether human `j` stands still until goals can change again."""
    if p.stand_probability == _ZERO:
        return False
    return rng.uniform(key, rng.STANDING, j, step // p.goal_change_steps, 0) < p.stand_probability


@function
def come_and_go(state, e, p):
    """Let people leave at their goals, and enter at their starts when due if there is room."""
    position, goal, present = state.human_position[e], state.human_goal[e], state.human_present[e]
    radius, entry = state.human_radius[e], state.human_entry[e]
    key, step = state.key[e], state.clock[e]
    for j in range(present.shape[0]):
        if present[j]:
            dx, dy = goal[j, 0] - position[j, 0], goal[j, 1] - position[j, 1]
            if dx * dx + dy * dy < radius[j] * radius[j] and (
                rng.uniform(key, rng.LEAVING, j, step, 0) < p.leave_probability
            ):
                present[j], entry[j] = False, NEVER
        elif entry[j] != NEVER and entry[j] <= step and _is_free(state, e, j, p):
            present[j] = True


@function
def _is_free(state, e, j, p):
    """Return whether human `j` can enter clear of all people and not close to a robot."""
    position, radius = state.human_position[e], state.human_radius[e]
    for k in range(radius.shape[0]):
        if state.human_present[e, k] and k != j:
            dx, dy = position[k, 0] - position[j, 0], position[k, 1] - position[j, 1]
            gap = radius[k] + radius[j] + p.spawn_clearance
            if dx * dx + dy * dy < gap * gap:
                return False
    for i in range(state.robot_heading.shape[1]):
        dx = state.robot_position[e, i, 0] - position[j, 0]
        dy = state.robot_position[e, i, 1] - position[j, 1]
        gap = p.robot_radius + radius[j] + max(p.spawn_clearance, _ENTRY)
        if dx * dx + dy * dy < gap * gap:
            return False
    return True
