"""Team perception: robots tell each other what they see, see `mrsan.TeamPerception`."""

import math

import numpy as np
from numba import prange

from mrsan.features import (
    OTHER_RADIUS,
    OTHER_VELOCITY_X,
    OTHER_VELOCITY_Y,
    OTHER_X,
    OTHER_Y,
)
from mrsan.kernels import function, kernel, rng
from mrsan.se2 import transform, untransform

# Kinds, see `mrsan.scenario.TeamPerception`.
NONE = 0
TRACKS = 1

_ZERO = np.float32(0.0)


@kernel
def tell(
    chunks, worlds, state, p, humans, humans_visible, robots, robots_visible, humans_told,
    robots_told,
):  # fmt: skip
    """Add to what robots see what their team-mates in reach saw `team_delay` ago, and their poses.

    Who is told of a person by several believes the first of them. Positions are moved on at their
    velocities by the delay, which everybody knows.

    Args:
        chunks: number of pieces the loop over worlds is cut into.
        worlds: [E] bool, the worlds to observe.
        state: the worlds; what is said now is written to `state.said`.
        p: the scenario's parameters.
        humans: [E, N, M, 5] what is seen, added to.
        humans_visible: [E, N, M] bool, added to.
        robots: [E, N, N - 1, 5], as humans.
        robots_visible: [E, N, N - 1] bool.
        humans_told: [E, N, M] bool, written: not seen, but told.
        robots_told: [E, N, N - 1] bool, written.
    """
    total, n, m = humans.shape[0], humans.shape[1], humans.shape[2]
    for chunk in prange(chunks):
        said, clock, keys = state.said, state.clock, state.key
        position, velocity = state.robot_position, state.robot_velocity
        heading = state.robot_heading
        delay, reach, loss = p.team_delay_steps, p.team_range, p.team_loss
        radius, late = p.robot_radius, np.float32(p.team_delay_steps) * p.time_step
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            if not worlds[e]:
                continue
            step, kept = clock[e], said.shape[1]
            now, heard = step % kept, (step - delay) % kept
            for i in range(n):
                pose, row = (position[e, i], velocity[e, i], heading[e, i]), said[e, now, i]
                _say(humans[e, i], humans_visible[e, i], pose, row, 0, m)
                _say(robots[e, i], robots_visible[e, i], pose, row, m, i)
                own = row[m + i]
                own[OTHER_X], own[OTHER_Y] = position[e, i, 0], position[e, i, 1]
                own[OTHER_VELOCITY_X], own[OTHER_VELOCITY_Y] = velocity[e, i, 0], velocity[e, i, 1]
                own[OTHER_RADIUS] = radius
            for i in range(n):
                humans_told[e, i, :], robots_told[e, i, :] = False, False
                pose = position[e, i], velocity[e, i], heading[e, i]
                for k in range(n):
                    dx = position[e, k, 0] - position[e, i, 0]
                    dy = position[e, k, 1] - position[e, i, 1]
                    if k == i or step < delay or math.sqrt(dx * dx + dy * dy) > reach:
                        continue
                    if loss > _ZERO and rng.uniform(keys[e], rng.TOLD, i * n + k, step, 0) < loss:
                        continue
                    row = said[e, heard, k]
                    _hear(
                        row, 0, m, late, pose, humans[e, i], humans_visible[e, i],
                        humans_told[e, i],
                    )  # fmt: skip
                    _hear(
                        row, m, i, late, pose, robots[e, i], robots_visible[e, i],
                        robots_told[e, i],
                    )  # fmt: skip


@function
def _say(seen, visible, pose, row, first, skip):
    """What a robot sees of others, in the world frame, from slot `first` on without slot `skip`.

    A radius of 0 says nothing.
    """
    position, velocity, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    for j in range(seen.shape[0]):
        out = row[first + j + (j >= skip)]
        if not visible[j]:
            out[:] = _ZERO
            continue
        x, y = seen[j, OTHER_X], seen[j, OTHER_Y]
        vx, vy = seen[j, OTHER_VELOCITY_X], seen[j, OTHER_VELOCITY_Y]
        out[OTHER_X], out[OTHER_Y] = transform(cos, sin, position[0], position[1], x, y)
        out[OTHER_VELOCITY_X], out[OTHER_VELOCITY_Y] = transform(
            cos, sin, velocity[0], velocity[1], vx, vy
        )
        out[OTHER_RADIUS] = seen[j, OTHER_RADIUS]


@function
def _hear(row, first, skip, late, pose, seen, visible, told):
    """What a robot does not see and was told of others, seen from it, `late` seconds after."""
    position, velocity, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    for j in range(seen.shape[0]):
        of = row[first + j + (j >= skip)]
        if visible[j] or of[OTHER_RADIUS] == _ZERO:
            continue
        vx, vy = of[OTHER_VELOCITY_X], of[OTHER_VELOCITY_Y]
        x, y = of[OTHER_X] + vx * late, of[OTHER_Y] + vy * late
        out = seen[j]
        out[OTHER_X], out[OTHER_Y] = untransform(cos, sin, position[0], position[1], x, y)
        out[OTHER_VELOCITY_X], out[OTHER_VELOCITY_Y] = untransform(
            cos, sin, velocity[0], velocity[1], vx, vy
        )
        out[OTHER_RADIUS] = of[OTHER_RADIUS]
        visible[j] = told[j] = True
