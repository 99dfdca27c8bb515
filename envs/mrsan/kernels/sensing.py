"""Observations: a robot itself and the agents within its field of view, in its body frame."""

import math

import numpy as np

from mrsan.features import (
    GOAL_X,
    GOAL_Y,
    HEADING_COS,
    HEADING_SIN,
    ORIGIN_X,
    ORIGIN_Y,
    OTHER_RADIUS,
    OTHER_VELOCITY_X,
    OTHER_VELOCITY_Y,
    OTHER_X,
    OTHER_Y,
    PREFERRED_SPEED,
    RADIUS,
    TIME,
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.kernels import function, kernel, rng
from mrsan.se2 import unrotate

_ZERO = np.float32(0.0)
_LEAST_RADIUS = np.float32(0.05)  # lower limit of noisy radii, as of a person in `Scenario`, m
_FULL_CIRCLE = np.float32(-1.0)  # the cosine of half a field of view of 360 degrees


@function
def always_in_sight(state, e, x, y, dx, dy):
    """Return whether no wall hides what is at (x + dx, y + dy) from (x, y): true without walls."""
    return True


is_in_sight = always_in_sight  # `observe.variant` replaces it, see `mrsan.kernels.walled`


@kernel
def observe(first, last, worlds, state, p, ego, humans, humans_visible, robots, robots_visible):
    """Write every element of the observation of every robot in some worlds.

    Args:
        first: the first world.
        last: the world after the last one.
        worlds: [E] bool, the worlds to observe.
        state: the worlds.
        p: the sensor, see `mrsan.parameters.SensorParameters`.
        ego: [E, N, 11], see `mrsan.features.EGO_FEATURES`.
        humans: [E, N, M, 5], see `mrsan.features.OTHER_FEATURES`; zero where not visible.
        humans_visible: [E, N, M] bool.
        robots: [E, N, N - 1, 5], the other robots in the order of their numbers.
        robots_visible: [E, N, N - 1] bool.
    """
    n, m = ego.shape[1], humans.shape[2]
    # Take arrays and numbers out of the tuples first: Numba copies a tuple wherever it goes.
    position, velocity = state.robot_position, state.robot_velocity
    heading, goal, clock = state.robot_heading, state.robot_goal, state.clock
    human_position, human_velocity = state.human_position, state.human_velocity
    human_radius, human_present, keys = state.human_radius, state.human_present, state.key
    robot_radius, robot_speed = p.robot_radius, p.robot_speed
    limit, cos_half_fov, occlusion = p.sensing_range, p.cos_half_fov, p.occlusion
    missed, position_noise, velocity_noise, radius_noise = (
        p.missed_detection,
        p.position_noise,
        p.velocity_noise,
        p.radius_noise,
    )
    noisy = position_noise > _ZERO or velocity_noise > _ZERO
    steps = np.float32(p.time_limit_steps)
    for e in range(first, last):
        if not worlds[e]:
            continue
        key, step = keys[e], clock[e]
        for i in range(n):
            cos, sin = math.cos(heading[e, i]), math.sin(heading[e, i])
            x, y = position[e, i, 0], position[e, i, 1]
            vx, vy = velocity[e, i, 0], velocity[e, i, 1]
            _write_ego(ego[e, i], cos, sin, x, y, vx, vy, goal[e, i, 0], goal[e, i, 1])
            ego[e, i, RADIUS], ego[e, i, PREFERRED_SPEED] = robot_radius, robot_speed
            ego[e, i, TIME] = np.float32(step) / steps
            for j in range(m + n):
                if j == m + i:
                    continue
                slot, visible = j, True
                if j < m:
                    dx, dy = human_position[e, j, 0] - x, human_position[e, j, 1] - y
                    ux, uy = human_velocity[e, j, 0] - vx, human_velocity[e, j, 1] - vy
                    radius = human_radius[e, j]
                    visible = human_present[e, j]
                else:
                    k = j - m
                    dx, dy = position[e, k, 0] - x, position[e, k, 1] - y
                    ux, uy = velocity[e, k, 0] - vx, velocity[e, k, 1] - vy
                    radius = robot_radius
                    slot = k if k < i else k - 1
                distance = math.sqrt(dx * dx + dy * dy)
                ahead, left = unrotate(cos, sin, dx, dy)
                along, across = unrotate(cos, sin, ux, uy)
                visible = visible and distance <= limit
                if cos_half_fov > _FULL_CIRCLE:
                    visible = visible and ahead >= distance * cos_half_fov
                visible = visible and is_in_sight(state, e, x, y, dx, dy)
                if visible and occlusion:
                    bodies = human_position[e], human_radius[e], human_present[e]
                    visible = not (
                        _is_hidden(bodies, j, x, y, dx, dy)
                        or _is_hidden_by_robot(position[e], robot_radius, i, j - m, dx, dy)
                    )
                if visible and missed > _ZERO:
                    draw = rng.uniform(key, rng.MISSED, i * 128 + j, step, 0)
                    visible = draw >= missed
                if visible and noisy:
                    agent = i * 128 + j
                    ahead += position_noise * rng.normal(key, rng.NOISE, agent, step, 0)
                    left += position_noise * rng.normal(key, rng.NOISE, agent, step, 2)
                    along += velocity_noise * rng.normal(key, rng.NOISE, agent, step, 4)
                    across += velocity_noise * rng.normal(key, rng.NOISE, agent, step, 6)
                if visible and radius_noise > _ZERO and j < m:
                    error = rng.normal(key, rng.NOISE, i * 128 + j, step, 8)
                    radius = max(radius + radius_noise * error, _LEAST_RADIUS)
                if not visible:
                    ahead = left = along = across = radius = _ZERO
                if j < m:
                    humans_visible[e, i, slot] = visible
                    _write_other(humans[e, i, slot], ahead, left, along, across, radius)
                else:
                    robots_visible[e, i, slot] = visible
                    _write_other(robots[e, i, slot], ahead, left, along, across, radius)


@function
def _write_ego(ego, cos, sin, x, y, vx, vy, goal_x, goal_y):
    """Write the robot's own pose, velocity and goal in its body frame."""
    ego[GOAL_X], ego[GOAL_Y] = unrotate(cos, sin, goal_x - x, goal_y - y)
    ego[VELOCITY_X], ego[VELOCITY_Y] = unrotate(cos, sin, vx, vy)
    own_x, own_y = unrotate(cos, sin, x, y)
    ego[ORIGIN_X], ego[ORIGIN_Y] = -own_x, -own_y
    ego[HEADING_COS], ego[HEADING_SIN] = cos, sin


@function
def _write_other(other, ahead, left, along, across, radius):
    """Write position, velocity and radius of another agent."""
    other[OTHER_X], other[OTHER_Y] = ahead, left
    other[OTHER_VELOCITY_X], other[OTHER_VELOCITY_Y] = along, across
    other[OTHER_RADIUS] = radius


@function
def _is_hidden(bodies, j, x, y, dx, dy):
    """Return whether a human other than `j` blocks the sight from (x, y) to (x + dx, y + dy)."""
    position, radius, present = bodies
    for k in range(present.shape[0]):
        if k == j or not present[k]:
            continue
        if _blocks(position[k, 0] - x, position[k, 1] - y, radius[k], dx, dy):
            return True
    return False


@function
def _is_hidden_by_robot(position, radius, i, j, dx, dy):
    """Return whether a robot other than `i` and `j` blocks the sight from `i` by (dx, dy)."""
    for k in range(position.shape[0]):
        x, y = position[k, 0] - position[i, 0], position[k, 1] - position[i, 1]
        if k != i and k != j and _blocks(x, y, radius, dx, dy):
            return True
    return False


@function
def _blocks(x, y, radius, dx, dy):
    """Return whether a disc at (x, y) blocks the sight from the origin to a point behind it."""
    squared = dx * dx + dy * dy
    across = x * dy - y * dx
    return (
        x * dx + y * dy > _ZERO
        and x * x + y * y < squared
        and across * across < radius * radius * squared
    )
