"""How people react to the nearest robot; the numbers are those of `mrsan.reactions`."""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.kinematics import wrap_angle
from mrsan.kernels.social_state import ELAPSED, REACTION

# Kinds of reaction, values of `mrsan.choices.Reaction`.
BLIND, REGULAR, IMPASSIVE, SURPRISED, CURIOUS, SCARED, THREATENING = range(7)

_ZERO = np.float32(0.0)
_TINY = np.float32(1e-6)
_FAR = np.float32(np.inf)
_STANDING = np.float32(0.05)  # who prefers a lower speed stands, m/s
_STEP_ROUND = np.float32(math.pi / 3)  # turn round the robot towards its front at a time, rad


@function
def draw_reaction(social, j, key, settings):
    """Draw how human `j` reacts and write it to `social` [M, 3]."""
    kind = settings.reaction_everybody
    if kind < 0:
        share, kind = rng.uniform(key, rng.REACTION, j, 0, 0), REGULAR
        kind += share >= settings.reaction_regular
        kind += share >= settings.reaction_impassive
        kind += share >= settings.reaction_surprised
        kind += share >= settings.reaction_curious
        kind += share >= settings.reaction_scared
        kind += share >= settings.reaction_threatening
        kind = kind if kind <= THREATENING else BLIND
    social[j, REACTION] = kind


@function
def react(state, e, j, preferred_x, preferred_y, max_speed, p, settings, in_sight):
    """Return how human `j` changes its motion because of the nearest robot.

    Args:
        state: the worlds.
        e: which of them.
        j: number of the human.
        preferred_x: preferred velocity without robots, x (m/s).
        preferred_y: preferred velocity without robots, y (m/s).
        max_speed: speed limit without robots (m/s).
        p: the scenario's parameters.
        settings: those of `mrsan.crowds.social_settings`.
        in_sight: function that returns whether no wall hides one point from another.

    Returns:
        The preferred velocity (x and y) and the speed limit in m/s, and whether the human avoids
        robots.
    """
    social, kind = state.human_social[e, j], state.human_social[e, j, REACTION]
    unchanged = preferred_x, preferred_y, max_speed, kind != BLIND
    if kind < SURPRISED:
        return unchanged
    x, y = state.human_position[e, j, 0], state.human_position[e, j, 1]
    i, distance = _nearest_robot(state, e, x, y)
    dx, dy = state.robot_position[e, i, 0] - x, state.robot_position[e, i, 1] - y
    reach = state.human_radius[e, j] + p.robot_radius
    gap = distance - reach
    notices = gap < settings.reaction_notice_distance and in_sight(state, e, x, y, dx, dy)
    if social[ELAPSED] == 0:  # it has not noticed a robot before
        notices = notices and _is_ahead(preferred_x, preferred_y, dx, dy, distance, settings)
        if not notices:
            return unchanged
    elapsed = social[ELAPSED]
    social[ELAPSED] = elapsed + 1
    if not notices:
        return unchanged
    dx, dy = dx / max(distance, _TINY), dy / max(distance, _TINY)
    if kind == SCARED:
        slowed = min(settings.reaction_scared_speed / max(max_speed, _TINY), np.float32(1.0))
        push = settings.reaction_scared_push * math.exp(
            -max(gap, _ZERO) / settings.reaction_scared_range
        )
        return preferred_x * slowed - push * dx, preferred_y * slowed - push * dy, max_speed, True
    if kind == SURPRISED and elapsed < settings.reaction_surprised_steps:
        return _ZERO, _ZERO, max_speed, False
    if kind == CURIOUS and elapsed < settings.reaction_curious_steps:
        speed = min(max_speed, settings.reaction_curious_speed)
        speed = min(speed, max(gap - settings.reaction_curious_gap, _ZERO) / p.time_step)
        return dx * speed, dy * speed, max_speed, False
    if kind == THREATENING and elapsed < settings.reaction_threatening_steps:
        away = reach + settings.reaction_threatening_gap
        vx, vy = _velocity_to_front(state, e, i, x, y, away, p)
        return vx, vy, max(max_speed, settings.reaction_threatening_speed), False
    return unchanged


@function
def _nearest_robot(state, e, x, y):
    """Return the robot nearest to (x, y) and its distance, m."""
    nearest, least = 0, _FAR
    for i in range(state.robot_heading.shape[1]):
        dx, dy = state.robot_position[e, i, 0] - x, state.robot_position[e, i, 1] - y
        distance = math.sqrt(dx * dx + dy * dy)
        if distance < least:
            nearest, least = i, distance
    return nearest, least


@function
def _is_ahead(ahead_x, ahead_y, dx, dy, distance, settings):
    """Return whether (dx, dy) is in the field of view of somebody who walks to (ahead_x, ahead_y).

    Somebody who stands looks around.
    """
    speed = math.sqrt(ahead_x * ahead_x + ahead_y * ahead_y)
    if speed < _STANDING:
        return True
    return ahead_x * dx + ahead_y * dy >= settings.reaction_cos_half_fov * speed * distance - _TINY


@function
def _velocity_to_front(state, e, i, x, y, away, p):
    """Return the velocity that leads from (x, y) to the place `away` metres in front of robot `i`.

    It leads round the robot, a sixth of the circle at a time, and moves along with it.
    """
    robot_x, robot_y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    bearing = math.atan2(y - robot_y, x - robot_x)
    turn = wrap_angle(state.robot_heading[e, i] - bearing)
    bearing += min(max(turn, -_STEP_ROUND), _STEP_ROUND)
    to_x, to_y = robot_x + away * math.cos(bearing), robot_y + away * math.sin(bearing)
    vx = (to_x - x) / p.time_step + state.robot_velocity[e, i, 0]
    vy = (to_y - y) / p.time_step + state.robot_velocity[e, i, 1]
    return vx, vy
