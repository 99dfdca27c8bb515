"""Conversion between desired velocities and executable actions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mrsan import Kinematics, Scenario
from mrsan.features import (
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
CREEP_SPEED = np.float32(1e-3)  # of a holonomic robot that imitates a turn in place, m/s
LOOK_SPEED = 1e-4  # of one that looks round, which must stay where it is, m/s
TURN_IN_PLACE_ANGLE = np.float32(math.pi / 3)  # for larger turns the robot stops first, rad


@function
def track_velocity(vx, vy, speed, action, p, turn_in_place_angle=TURN_IN_PLACE_ANGLE):
    """Write the action whose result is closest to a desired velocity within the robot's limits.

    Args:
        vx: desired forward velocity in the body frame, m/s.
        vy: desired velocity to the left, m/s.
        speed: current speed of the robot, m/s.
        action: [A], written.
        p: the scenario's parameters.
        turn_in_place_angle: for larger turns the robot stops and turns in place, rad.
    """
    desired_speed = math.sqrt(vx * vx + vy * vy)
    if p.kinematics == HOLONOMIC:
        scale = _ONE / max(desired_speed, p.robot_speed)
        action[0], action[1] = vx * scale, vy * scale
        return
    turn = math.atan2(vy, vx) if desired_speed > _ZERO else _ZERO
    desired_speed = min(desired_speed, p.robot_speed)
    if abs(turn) > turn_in_place_angle:
        desired_speed = _ZERO
    turn_action = min(max(turn / p.max_turn, -_ONE), _ONE)
    if p.kinematics == ACCELERATION_HEADING:
        if not p.turn_in_place and desired_speed == _ZERO and turn != _ZERO:
            desired_speed = p.robot_speed / _TWO  # it cannot turn without driving
        thrust = (desired_speed - speed) / (p.max_acceleration * p.time_step)
        action[0], action[1], action[2] = min(max(thrust, -_ONE), _ONE), _ZERO, turn_action
    else:
        action[0], action[1] = _TWO * desired_speed / p.robot_speed - _ONE, turn_action


@function
def preferred_velocity(target, p):
    """Return the velocity straight to a target [2] in the body frame at full speed, m/s."""
    x, y = target[0], target[1]
    scale = p.robot_speed / max(math.sqrt(x * x + y * y), np.float32(1e-6))
    return x * scale, y * scale


@function
def track_rotated_velocity(
    vx, vy, heading, desired_x, desired_y, action, p, turn_in_place_angle=TURN_IN_PLACE_ANGLE
):
    """Call `track_velocity` with a desired velocity in the frame in which `heading` is measured.

    (vx, vy) is the robot's current velocity; only its norm matters.
    """
    forward, leftward = unrotate(math.cos(heading), math.sin(heading), desired_x, desired_y)
    speed = math.sqrt(vx * vx + vy * vy)
    track_velocity(forward, leftward, speed, action, p, turn_in_place_angle)


@function
def step_robot(x, y, vx, vy, heading, action, p):
    """Return x, y, vx, vy and heading after one step of an action, as in the simulator."""
    new_vx, new_vy, heading = next_velocity(vx, vy, heading, action, p)
    if p.instant_velocity:
        vx, vy = new_vx, new_vy
    x += _HALF * (vx + new_vx) * p.time_step
    y += _HALF * (vy + new_vy) * p.time_step
    return x, y, new_vx, new_vy, heading


def stop_fully(
    action: NDArray[np.float32], ego: NDArray[np.float32], stop_speed: float, scenario: Scenario
) -> NDArray[np.float32]:
    """Let robots stand that would otherwise be slower than `stop_speed` (m/s).

    A standing robot may turn in place, while a moving one is limited by its turning radius: a robot
    that creeps can hardly turn at all.

    Args:
        action: [..., A] in [-1, 1].
        ego: [..., 11] the robots.
        stop_speed: 0 and other kinematics than `acceleration_heading` leave all actions as they
            are.
        scenario: the robots' limits.

    Returns:
        The actions, [..., A].
    """
    if stop_speed == 0.0 or scenario.kinematics is not Kinematics.acceleration_heading:
        return action
    gain = np.float32(scenario.max_acceleration * scenario.time_step)
    along = np.hypot(ego[..., VELOCITY_X], ego[..., VELOCITY_Y]) + gain * action[..., 0]
    stops = np.hypot(along.clip(min=0.0), gain * action[..., 1]) < stop_speed
    stopped = action.copy()
    stopped[stops, :2] = -1.0, 0.0
    return stopped


def action_to_motion(
    ego: NDArray[np.float32], action: NDArray[np.float32], p: Parameters
) -> tuple[float, float, float, float]:
    """Return the motion that an action commands.

    Args:
        ego: [1, 1, 11] the robot.
        action: [1, 1, A] in [-1, 1].
        p: the scenario's parameters.

    Returns:
        The speed after one step (m/s), the turn in this step (rad), and the acceleration along and
        across the new heading (m/s^2). Robots driven by velocities have no acceleration of their
        own; for them it is the mean along the heading.
    """
    out = np.empty(4, np.float32)
    _action_to_motion(1, ego, action, p, out)
    speed, turn, along, across = (float(value) for value in out)
    return speed, turn, along, across


@kernel
def _action_to_motion(first, last, ego, action, p, out):
    vx, vy = ego[0, 0, VELOCITY_X], ego[0, 0, VELOCITY_Y]
    new_vx, new_vy, turn = next_velocity(vx, vy, _ZERO, action[0, 0], p)
    speed = math.sqrt(new_vx * new_vx + new_vy * new_vy)
    out[0], out[1] = speed, turn
    if p.kinematics == ACCELERATION_HEADING:
        forward, leftward = action[0, 0, 0], action[0, 0, 1]
        norm = math.sqrt(forward * forward + leftward * leftward)
        scale = p.max_acceleration / max(norm, _ONE)
        out[2], out[3] = forward * scale, leftward * scale
    else:
        out[2], out[3] = (speed - math.sqrt(vx * vx + vy * vy)) / p.time_step, _ZERO


def turning_action(turn: float, p: Parameters) -> NDArray[np.float32]:
    """Return the action [1, 1, A] by which a standing robot turns on the spot, rad."""
    if p.kinematics == HOLONOMIC:
        creep = LOOK_SPEED / float(p.robot_speed)
        action = [creep * math.cos(turn), creep * math.sin(turn)]
    else:
        share = float(np.clip(turn / float(p.max_turn), -1.0, 1.0))
        action = [0.0, 0.0, share] if p.kinematics == ACCELERATION_HEADING else [-1.0, share]
    return np.array([[action]], np.float32)


def retarget_actions(
    ego: NDArray[np.float32],
    action: NDArray[np.float32],
    source: Parameters,
    target: Parameters,
) -> NDArray[np.float32]:
    """Convert actions for one kind of robot to actions for another kind.

    Each action is replaced by the one that comes closest to the velocity the original would reach
    in one step.

    Args:
        ego: [E, N, 11] the robots.
        action: [E, N, A] in [-1, 1], for robots of `source`.
        source: parameters of the scenario for which the actions were computed.
        target: parameters of the scenario in which the robots drive.

    Returns:
        [E, N, A] in [-1, 1], for robots of `target`.
    """
    size = 3 if target.kinematics == ACCELERATION_HEADING else 2
    out = np.empty((*action.shape[:2], size), np.float32)
    _retarget_actions(len(out), ego, action, source, target, out)
    return out


@kernel
def _retarget_actions(first, last, ego, action, source, target, out):
    for e in range(first, last):
        for i in range(ego.shape[1]):
            vx, vy = ego[e, i, VELOCITY_X], ego[e, i, VELOCITY_Y]
            desired_x, desired_y, turn = next_velocity(vx, vy, _ZERO, action[e, i], source)
            turn_in_place_angle = TURN_IN_PLACE_ANGLE
            if desired_x == _ZERO and desired_y == _ZERO:  # it stands and may turn in place
                desired_x = CREEP_SPEED * math.cos(turn)
                desired_y = CREEP_SPEED * math.sin(turn)
                turn_in_place_angle = _ZERO
            speed = math.sqrt(vx * vx + vy * vy)
            track_velocity(desired_x, desired_y, speed, out[e, i], target, turn_in_place_angle)


@function
def gather_rows(
    ego, humans, humans_visible, robots, robots_visible, human_margin, robot_margin, rows
):
    """Write the robot and everybody it sees as rows `[px, py, vx, vy, radius]`; return their count.

    Row 0 is the robot itself. Positions and velocities are in the body frame; velocities are not
    relative to the robot's own. The margins are added to the radii of humans and robots.
    """
    rows[0, 0] = rows[0, 1] = _ZERO
    rows[0, 2], rows[0, 3], rows[0, 4] = ego[VELOCITY_X], ego[VELOCITY_Y], ego[RADIUS]
    count = 1
    for j in range(humans.shape[0]):
        if humans_visible[j]:
            _write_row(rows, count, humans[j], ego, human_margin)
            count += 1
    for j in range(robots.shape[0]):
        if robots_visible[j]:
            _write_row(rows, count, robots[j], ego, robot_margin)
            count += 1
    return count


@function
def _write_row(rows, count, other, ego, margin):
    rows[count, 0], rows[count, 1] = other[OTHER_X], other[OTHER_Y]
    rows[count, 2] = other[OTHER_VELOCITY_X] + ego[VELOCITY_X]
    rows[count, 3] = other[OTHER_VELOCITY_Y] + ego[VELOCITY_Y]
    rows[count, 4] = other[OTHER_RADIUS] + margin
