"""Social forces (Helbing and Molnar, 1995): towards the goal, away from agents and walls."""

import math

import numpy as np

from mrsan.kernels import function

_ZERO = np.float32(0.0)
_TINY = np.float32(1e-6)
_STEEPEST = np.float32(20.0)  # larger exponents are clipped, as they would overflow


@function
def social_force_velocity(
    agents,
    count,
    i,
    preferred_x,
    preferred_y,
    max_speed,
    relaxation_time,
    strength,
    reach,
    wall_strength,
    wall_reach,
    time_step,
    scratch,
):
    """Return the next velocity of agent `i` among `count` rows `[px, py, vx, vy, radius]`.

    Args:
        agents: [A, 5] positions, velocities and radii (m, m/s).
        count: number of rows of `agents` in use.
        i: the row of the agent that decides.
        preferred_x: preferred velocity, x (m/s).
        preferred_y: preferred velocity, y (m/s).
        max_speed: speed limit (m/s).
        relaxation_time: time to reach the preferred velocity (s).
        strength: repulsion at contact (m/s^2).
        reach: distance over which repulsion falls to 1/e (m).
        wall_strength: repulsion of walls at contact (m/s^2).
        wall_reach: distance over which it falls to 1/e (m).
        time_step: length of a step (s).
        scratch: from `mrsan.kernels.orca.allocate_orca_scratch`, with the nearest points of walls.
    """
    ax = (preferred_x - agents[i, 2]) / relaxation_time
    ay = (preferred_y - agents[i, 3]) / relaxation_time
    for j in range(count):
        if j == i:
            continue
        dx, dy = agents[i, 0] - agents[j, 0], agents[i, 1] - agents[j, 1]
        distance = max(math.sqrt(dx * dx + dy * dy), _TINY)
        gap = distance - agents[i, 4] - agents[j, 4]
        push = strength * math.exp(min(-gap / reach, _STEEPEST))
        ax += push * dx / distance
        ay += push * dy / distance
    for k in range(scratch.wall_counts[0]):
        dx, dy = agents[i, 0] - scratch.wall_points[k, 0], agents[i, 1] - scratch.wall_points[k, 1]
        distance = max(math.sqrt(dx * dx + dy * dy), _TINY)
        push = wall_strength * math.exp(min((agents[i, 4] - distance) / wall_reach, _STEEPEST))
        ax += push * dx / distance
        ay += push * dy / distance
    vx = agents[i, 2] + ax * time_step
    vy = agents[i, 3] + ay * time_step
    speed = math.sqrt(vx * vx + vy * vy)
    if speed > max_speed:
        vx, vy = vx * max_speed / speed, vy * max_speed / speed
    return vx, vy
