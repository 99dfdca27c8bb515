"""From a velocity that a planner wants to an action that the robot can execute, and back."""

from __future__ import annotations

import math

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mrsan.features import (
    GOAL_X,
    GOAL_Y,
    OTHER_RADIUS,
    OTHER_VELOCITY_X,
    OTHER_VELOCITY_Y,
    OTHER_X,
    OTHER_Y,
    RADIUS,
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.kernels import function, kernel
from mrsan.kernels.kinematics import ACCELERATION_HEADING, HOLONOMIC, next_velocity
from mrsan.parameters import Parameters
from mrsan.se2 import unrotate

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
CREEP = np.float32(1e-3)  # a holonomic robot that turns on the spot so drives meanwhile, m/s
SHARP = np.float32(math.pi / 3)  # beyond this turn the robot stops and turns on the spot, rad


@function
def track_velocity(vx, vy, speed, action, p, sharp=SHARP):
    """Write the action that brings a robot nearest to a velocity within its limits.

    Args:
        vx: wanted velocity ahead, in the body frame (m/s).
        vy: wanted velocity to the left (m/s).
        speed: the robot's speed now (m/s).
        action: [A], written.
        p: the scenario's parameters.
        sharp: beyond this turn the robot stops and turns on the spot, rad.
    """
    wanted = math.sqrt(vx * vx + vy * vy)
    if p.kinematics == HOLONOMIC:
        scale = _ONE / max(wanted, p.robot_speed)
        action[0], action[1] = vx * scale, vy * scale
        return
    turn = math.atan2(vy, vx) if wanted > _ZERO else _ZERO
    wanted = min(wanted, p.robot_speed)
    if abs(turn) > sharp:
        wanted = _ZERO
    limited = min(max(turn / p.max_turn, -_ONE), _ONE)
    if p.kinematics == ACCELERATION_HEADING:
        if not p.turn_in_place and wanted == _ZERO and turn != _ZERO:
            wanted = p.robot_speed / _TWO  # it cannot turn without driving
        push = (wanted - speed) / (p.max_acceleration * p.time_step)
        action[0], action[1], action[2] = min(max(push, -_ONE), _ONE), _ZERO, limited
    else:
        action[0], action[1] = _TWO * wanted / p.robot_speed - _ONE, limited


@function
def preferred_velocity(own, p):
    """Straight to the goal at full speed: ahead and to the left, m/s; `own` is the ego [11]."""
    x, y = own[GOAL_X], own[GOAL_Y]
    scale = p.robot_speed / max(math.sqrt(x * x + y * y), np.float32(1e-6))
    return x * scale, y * scale


@function
def steer(vx, vy, heading, wanted_x, wanted_y, action, p, sharp=SHARP):
    """`track_velocity` for a robot that moves and heads like that in the frame of what it wants."""
    ahead, left = unrotate(math.cos(heading), math.sin(heading), wanted_x, wanted_y)
    track_velocity(ahead, left, math.sqrt(vx * vx + vy * vy), action, p, sharp)


@function
def move(x, y, vx, vy, heading, action, p):
    """One step of an action, as the world moves robots: the next x, y, vx, vy and heading."""
    new_vx, new_vy, heading = next_velocity(vx, vy, heading, action, p)
    if p.instant_velocity:
        vx, vy = new_vx, new_vy
    x += _HALF * (vx + new_vx) * p.time_step
    y += _HALF * (vy + new_vy) * p.time_step
    return x, y, new_vx, new_vy, heading


def motion_after(
    ego: NDArray[np.float32], action: NDArray[np.float32], p: Parameters
) -> tuple[float, float, float, float]:
    """What an action means to a robot.

    Args:
        ego: [1, 1, 11] the robot.
        action: [1, 1, A] in [-1, 1].
        p: the scenario's parameters.

    Returns:
        Its speed after one step (m/s), by how much it turns in it (rad), and its acceleration along
        and across its new heading (m/s^2; of robots that drive by velocities the mean along it).
    """
    out = np.empty(4, np.float32)
    _motion_after(1, ego, action, p, out)
    speed, turn, along, across = (float(value) for value in out)
    return speed, turn, along, across


@kernel
def _motion_after(chunks, ego, action, p, out):
    vx, vy = ego[0, 0, VELOCITY_X], ego[0, 0, VELOCITY_Y]
    new_vx, new_vy, turn = next_velocity(vx, vy, _ZERO, action[0, 0], p)
    speed = math.sqrt(new_vx * new_vx + new_vy * new_vy)
    out[0], out[1] = speed, turn
    if p.kinematics == ACCELERATION_HEADING:
        ahead, left = action[0, 0, 0], action[0, 0, 1]
        scale = p.max_acceleration / max(math.sqrt(ahead * ahead + left * left), _ONE)
        out[2], out[3] = ahead * scale, left * scale
    else:
        out[2], out[3] = (speed - math.sqrt(vx * vx + vy * vy)) / p.time_step, _ZERO


def as_driven(
    ego: NDArray[np.float32], action: NDArray[np.float32], own: Parameters, here: Parameters
) -> NDArray[np.float32]:
    """Actions for robots of another kind than they are meant for: their velocities are tracked.

    An action means the velocity that it leads to in one step; of it the robots of this kind come
    as near as they can.

    Args:
        ego: [E, N, 11] the robots.
        action: [E, N, A] in [-1, 1], for robots of `own`.
        own: parameters of the scenario that the actions are meant for.
        here: parameters of the scenario that the robots are in.

    Returns:
        [E, N, A] in [-1, 1], for robots of `here`.
    """
    size = 3 if here.kinematics == ACCELERATION_HEADING else 2
    out = np.empty((*action.shape[:2], size), np.float32)
    _as_driven(len(out), ego, action, own, here, out)
    return out


@kernel
def _as_driven(chunks, ego, action, own, here, out):
    total = ego.shape[0]
    for chunk in prange(chunks):
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            for i in range(ego.shape[1]):
                vx, vy = ego[e, i, VELOCITY_X], ego[e, i, VELOCITY_Y]
                wanted_x, wanted_y, turn = next_velocity(vx, vy, _ZERO, action[e, i], own)
                sharp = SHARP
                if wanted_x == _ZERO and wanted_y == _ZERO:  # it stands, and may turn on the spot
                    wanted_x, wanted_y = CREEP * math.cos(turn), CREEP * math.sin(turn)
                    sharp = _ZERO
                speed = math.sqrt(vx * vx + vy * vy)
                track_velocity(wanted_x, wanted_y, speed, out[e, i], here, sharp)


@function
def gather(ego, humans, humans_visible, robots, robots_visible, human_margin, robot_margin, rows):
    """List the robot itself and everybody it sees as rows `[px, py, vx, vy, radius]`.

    Positions and velocities are in the body frame but not relative to the robot's motion, which
    is row 0. The margins are added to the radii of humans and robots. Returns how many rows.
    """
    rows[0, 0] = rows[0, 1] = _ZERO
    rows[0, 2], rows[0, 3], rows[0, 4] = ego[VELOCITY_X], ego[VELOCITY_Y], ego[RADIUS]
    count = 1
    for j in range(humans.shape[0]):
        if humans_visible[j]:
            _add(rows, count, humans[j], ego, human_margin)
            count += 1
    for j in range(robots.shape[0]):
        if robots_visible[j]:
            _add(rows, count, robots[j], ego, robot_margin)
            count += 1
    return count


@function
def _add(rows, count, other, ego, margin):
    rows[count, 0], rows[count, 1] = other[OTHER_X], other[OTHER_Y]
    rows[count, 2] = other[OTHER_VELOCITY_X] + ego[VELOCITY_X]
    rows[count, 3] = other[OTHER_VELOCITY_Y] + ego[VELOCITY_Y]
    rows[count, 4] = other[OTHER_RADIUS] + margin
