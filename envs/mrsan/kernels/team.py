"""Team perception: robots report the agents they see to each other (`mrsan.TeamPerception`)."""

import math

import numpy as np

from mrsan.features import (
    OTHER_RADIUS,
    OTHER_VELOCITY_X,
    OTHER_VELOCITY_Y,
    OTHER_X,
    OTHER_Y,
)
from mrsan.kernels import function, kernel, rng
from mrsan.se2 import transform, untransform

# Values of `mrsan.TeamPerception`.
NONE = 0
TRACKS = 1

_ZERO = np.float32(0.0)


@kernel
def share_tracks(
    first,
    last,
    worlds,
    state,
    p,
    humans,
    humans_visible,
    robots,
    robots_visible,
    humans_reported,
    robots_reported,
):
    """Add the agents that team-mates in range saw `team_delay` ago, and their poses.

    A person whom several team-mates report is taken from the first of them. Positions are
    extrapolated by the delay at the reported velocities.

    Args:
        first: the first world.
        last: the world after the last one.
        worlds: [E] bool, the worlds to observe.
        state: the worlds; this step's reports are written to `state.message_buffer`.
        p: the scenario's parameters.
        humans: [E, N, M, 5] observed people; reported ones are added.
        humans_visible: [E, N, M] bool; likewise.
        robots: [E, N, N - 1, 5]; likewise.
        robots_visible: [E, N, N - 1] bool; likewise.
        humans_reported: [E, N, M] bool, written: reported by a team-mate but not seen.
        robots_reported: [E, N, N - 1] bool, written: likewise.
    """
    n, m = humans.shape[1], humans.shape[2]
    messages, clock, keys = state.message_buffer, state.clock, state.key
    position, velocity = state.robot_position, state.robot_velocity
    heading = state.robot_heading
    delay_steps, max_distance, loss = p.team_delay_steps, p.team_range, p.team_loss
    radius, delay = p.robot_radius, np.float32(p.team_delay_steps) * p.time_step
    for e in range(first, last):
        if not worlds[e]:
            continue
        step, length = clock[e], messages.shape[1]
        sent, received = step % length, (step - delay_steps) % length
        for i in range(n):
            pose = position[e, i], velocity[e, i], heading[e, i]
            message = messages[e, sent, i]
            _write_message(humans[e, i], humans_visible[e, i], pose, message, 0, m)
            _write_message(robots[e, i], robots_visible[e, i], pose, message, m, i)
            _write_own_pose(pose, radius, message[m + i])
        for i in range(n):
            humans_reported[e, i, :], robots_reported[e, i, :] = False, False
            pose = position[e, i], velocity[e, i], heading[e, i]
            for k in range(n):
                dx = position[e, k, 0] - position[e, i, 0]
                dy = position[e, k, 1] - position[e, i, 1]
                distance = math.sqrt(dx * dx + dy * dy)
                if k == i or step < delay_steps or distance > max_distance:
                    continue
                if loss > _ZERO:
                    if rng.uniform(keys[e], rng.REPORT_LOSS, i * n + k, step, 0) < loss:
                        continue
                message = messages[e, received, k]
                people = humans[e, i], humans_visible[e, i], humans_reported[e, i]
                others = robots[e, i], robots_visible[e, i], robots_reported[e, i]
                _read_message(message, 0, m, delay, pose, people)
                _read_message(message, m, i, delay, pose, others)


@function
def _write_own_pose(pose, radius, out):
    """Write the robot itself to its message, in the world frame."""
    position, velocity, _ = pose
    out[OTHER_X], out[OTHER_Y] = position[0], position[1]
    out[OTHER_VELOCITY_X], out[OTHER_VELOCITY_Y] = velocity[0], velocity[1]
    out[OTHER_RADIUS] = radius


@function
def _write_message(others, visible, pose, message, first, skip):
    """Write the agents that a robot sees to its message, in the world frame.

    They fill the slots from `first` on, without slot `skip`; a radius of 0 marks an empty slot.
    """
    position, velocity, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    for j in range(others.shape[0]):
        out = message[first + j + (j >= skip)]
        if not visible[j]:
            out[:] = _ZERO
            continue
        x, y = others[j, OTHER_X], others[j, OTHER_Y]
        vx, vy = others[j, OTHER_VELOCITY_X], others[j, OTHER_VELOCITY_Y]
        out[OTHER_X], out[OTHER_Y] = transform(cos, sin, position[0], position[1], x, y)
        out[OTHER_VELOCITY_X], out[OTHER_VELOCITY_Y] = transform(
            cos, sin, velocity[0], velocity[1], vx, vy
        )
        out[OTHER_RADIUS] = others[j, OTHER_RADIUS]


@function
def _read_message(message, first, skip, delay, pose, observed):
    """Add the agents of a message that is `delay` seconds old to those that a robot sees."""
    position, velocity, heading = pose
    others, visible, reported = observed
    cos, sin = math.cos(heading), math.sin(heading)
    for j in range(others.shape[0]):
        track = message[first + j + (j >= skip)]
        if visible[j] or track[OTHER_RADIUS] == _ZERO:
            continue
        vx, vy = track[OTHER_VELOCITY_X], track[OTHER_VELOCITY_Y]
        x, y = track[OTHER_X] + vx * delay, track[OTHER_Y] + vy * delay
        out = others[j]
        out[OTHER_X], out[OTHER_Y] = untransform(cos, sin, position[0], position[1], x, y)
        out[OTHER_VELOCITY_X], out[OTHER_VELOCITY_Y] = untransform(
            cos, sin, velocity[0], velocity[1], vx, vy
        )
        out[OTHER_RADIUS] = track[OTHER_RADIUS]
        visible[j] = reported[j] = True
