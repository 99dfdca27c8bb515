"""How an action moves a robot: SAMARL, Eq. 1-3, and two simpler models."""

import math

import numpy as np

from mrsan.kernels import function
from mrsan.se2 import rotate

ACCELERATION_HEADING = 0
HOLONOMIC = 1
UNICYCLE = 2

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_PI = np.float32(math.pi)
_TWO_PI = np.float32(2.0 * math.pi)


@function
def wrap_angle(angle):
    """Return the equivalent angle in (-pi, pi]."""
    if angle > _PI:
        return angle - _TWO_PI
    if angle <= -_PI:
        return angle + _TWO_PI
    return angle


@function
def next_velocity(vx, vy, heading, action, p):
    """Return (vx, vy, heading) in the world frame after one step of `action`."""
    if p.kinematics == ACCELERATION_HEADING:
        return _acceleration_heading(vx, vy, heading, action[0], action[1], action[2], p)
    if p.kinematics == HOLONOMIC:
        return _holonomic(heading, action[0], action[1], p)
    return _unicycle(heading, action[0], action[1], p)


@function
def brake(vx, vy, heading, p):
    """Return (vx, vy, heading) after one step of full braking straight ahead."""
    if p.kinematics == ACCELERATION_HEADING:
        return _acceleration_heading(vx, vy, heading, -_ONE, _ZERO, _ZERO, p)
    return _ZERO, _ZERO, heading


@function
def _acceleration_heading(vx, vy, heading, longitudinal, lateral, turn, p):
    """Apply SAMARL, Eq. 2 and 3; accelerations are along and across the new heading."""
    norm = math.sqrt(longitudinal * longitudinal + lateral * lateral)
    scale = p.max_acceleration / max(norm, _ONE)  # Eq. 3: the pair lies in a disc
    turn = turn * p.max_turn
    speed = math.sqrt(vx * vx + vy * vy)
    along = speed + longitudinal * scale * p.time_step  # Eq. 2
    across = lateral * scale * p.time_step
    if along <= _ZERO:  # robots do not reverse, but may turn in place
        return _ZERO, _ZERO, wrap_angle(heading + turn) if p.turn_in_place else heading
    new_speed = min(math.sqrt(along * along + across * across), p.robot_speed)
    turn = turn + math.atan2(across, along)
    limit = min(p.max_turn, p.time_step * new_speed / p.min_turning_radius)  # Eq. 3
    heading = wrap_angle(heading + min(max(turn, -limit), limit))
    return new_speed * math.cos(heading), new_speed * math.sin(heading), heading


@function
def _holonomic(heading, forward, left, p):
    """Apply a velocity in the body frame, in preferred speeds; the heading follows it."""
    norm = math.sqrt(forward * forward + left * left)
    scale = p.robot_speed / max(norm, _ONE)
    cos, sin = math.cos(heading), math.sin(heading)
    if norm > _ZERO:
        heading = wrap_angle(heading + math.atan2(left, forward))
    vx, vy = rotate(cos, sin, forward, left)
    return vx * scale, vy * scale, heading


@function
def _unicycle(heading, speed, turn, p):
    """Apply a forward speed (-1: stand, 1: preferred speed) and a change of heading."""
    heading = wrap_angle(heading + turn * p.max_turn)
    new_speed = _HALF * (speed + _ONE) * p.robot_speed
    return new_speed * math.cos(heading), new_speed * math.sin(heading), heading
