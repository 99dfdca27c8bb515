"""What robots report and tell to each other.

With `mrsan.TeamPerception` they report the agents that they see, with `Scenario.team_messages` they
tell what they intend.
"""

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
from mrsan.kernels.routes import GOAL
from mrsan.se2 import transform, untransform

# Values of `mrsan.TeamPerception`.
NONE = 0
TRACKS = 1

# Features of a message, `mrsan.sensors.team.MESSAGE_FEATURES`; the others are as of an agent.
PRIORITY, THROUGH, MACRO_ACTION = 4, 5, 6

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


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
    delay_steps = p.team_delay_steps
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
                if k == i or not _hears(position[e], i, k, step, keys[e], p):
                    continue
                message = messages[e, received, k]
                people = humans[e, i], humans_visible[e, i], humans_reported[e, i]
                others = robots[e, i], robots_visible[e, i], robots_reported[e, i]
                _read_message(message, 0, m, delay, pose, people)
                _read_message(message, m, i, delay, pose, others)


@function
def _hears(position, i, k, step, key, p):
    """Return whether robot `i` receives what robot `k` sent `team_delay` ago."""
    dx, dy = position[k, 0] - position[i, 0], position[k, 1] - position[i, 1]
    if step < p.team_delay_steps or math.sqrt(dx * dx + dy * dy) > p.team_range:
        return False
    if p.team_loss > _ZERO:
        draw = rng.uniform(key, rng.REPORT_LOSS, i * position.shape[0] + k, step, 0)
        return draw >= p.team_loss
    return True


@kernel
def share_messages(first, last, worlds, state, p, features, mask):
    """Write what the robots of some worlds tell their team-mates.

    Args:
        first: first world to work on.
        last: the one after the last.
        worlds: [E] bool, the worlds to observe.
        state: the worlds; this step's messages are written to `state.intent_buffer`.
        p: the scenario's parameters.
        features: [E, N, N - 1, 7], written: `mrsan.sensors.team.MESSAGE_FEATURES`.
        mask: [E, N, N - 1] bool, written: which messages are received.
    """
    n, messages = features.shape[1], state.intent_buffer
    position, velocity, heading = state.robot_position, state.robot_velocity, state.robot_heading
    delay = np.float32(p.team_delay_steps) * p.time_step
    for e in range(first, last):
        if not worlds[e]:
            continue
        step, length = state.clock[e], messages.shape[1]
        sent, received = step % length, (step - p.team_delay_steps) % length
        for i in range(n):
            _write_own_message(state, e, i, messages[e, sent, i])
        for i in range(n):
            pose = position[e, i], velocity[e, i], heading[e, i]
            for j in range(n - 1):
                k = j + (j >= i)
                mask[e, i, j] = _hears(position[e], i, k, step, state.key[e], p)
                out = features[e, i, j]
                out[:] = _ZERO
                if mask[e, i, j]:
                    message = messages[e, received, k]
                    _to_body_frame(message, delay, pose, out)
                    for f in range(PRIORITY, MACRO_ACTION + 1):
                        out[f] = message[f]


@kernel
def write_priorities(first, last, worlds, state, values):
    """Write the priorities of the robots of some worlds [E], [E, N, 1]."""
    for e in range(first, last):
        for i in range(values.shape[1]):
            if worlds[e]:
                values[e, i, 0] = _priority(state, e, i)


@function
def _priority(state, e, i):
    """Return the priority of robot `i` in this episode, in [0, 1)."""
    return rng.uniform(state.key[e], rng.PRIORITY, i, 0, 0)


@function
def _write_own_message(state, e, i, out):
    """Write what robot `i` tells, in the world frame."""
    out[OTHER_X], out[OTHER_Y] = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    out[OTHER_VELOCITY_X] = state.robot_velocity[e, i, 0]
    out[OTHER_VELOCITY_Y] = state.robot_velocity[e, i, 1]
    out[PRIORITY] = _priority(state, e, i)
    agent = state.human_radius.shape[1] + i
    through = state.arrived[e, i] or agent >= state.route_corner.shape[1]
    out[THROUGH] = _ONE if through or state.route_corner[e, agent] == GOAL else _ZERO
    out[MACRO_ACTION] = np.float32(state.macro_action[e, i])


@function
def _to_body_frame(track, delay, pose, out):
    """Write position and velocity of an agent [4] from a track that is `delay` seconds old."""
    position, velocity, heading = pose
    cos, sin = math.cos(heading), math.sin(heading)
    vx, vy = track[OTHER_VELOCITY_X], track[OTHER_VELOCITY_Y]
    x, y = track[OTHER_X] + vx * delay, track[OTHER_Y] + vy * delay
    out[OTHER_X], out[OTHER_Y] = untransform(cos, sin, position[0], position[1], x, y)
    out[OTHER_VELOCITY_X], out[OTHER_VELOCITY_Y] = untransform(
        cos, sin, velocity[0], velocity[1], vx, vy
    )


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
    others, visible, reported = observed
    for j in range(others.shape[0]):
        track = message[first + j + (j >= skip)]
        if visible[j] or track[OTHER_RADIUS] == _ZERO:
            continue
        _to_body_frame(track, delay, pose, others[j])
        others[j, OTHER_RADIUS] = track[OTHER_RADIUS]
        visible[j] = reported[j] = True
