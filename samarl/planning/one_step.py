"""Predicted outcome of each command of a discrete set after one step.

Everybody else is assumed to move at constant velocity; the true next state is not used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import Entities, Kinematics, Observation, Scenario
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
    TIME,
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.fields import required
from mrsan.kernels import function, kernel
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.walls import WALL_ROWS, is_clear
from mrsan.parameters import kernel_parameters
from mrsan.reward import step_reward_parts, sum_of_parts
from mrsan.se2 import rotate, unit_vectors, unrotate, untransform
from samarl.observations.tracker import AGE
from samarl.planning.velocity_control import step_robot
from samarl.planning.walls import gather_walls, seen_walls

# Shares of the largest acceleration. In 0.25 s at SAMARL's limits the outer ones stop a robot or
# bring it to full speed; the inner ones change its speed by 0.5 m/s.
LONGITUDINAL = (-1.0, -0.4, 0.0, 0.4, 1.0)

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


@dataclass
class Commands:
    """Sizes of the discrete command set."""

    turns: int = required(3, 99, help="turns, from right to left, for robots with a heading")
    speeds: int = required(2, 20, help="speeds for unicycles and holonomic robots")
    directions: int = required(1, 360, help="directions for holonomic robots")


class Outcomes(NamedTuple):
    """Predicted outcomes of C commands for R robots; shaped like tracks of C worlds of R robots."""

    tracks: Observation  # [C, R, ...] in the body frames after the step
    reward: NDArray[np.float32]  # [C, R] of Eq. 10 of SAMARL, without the team's arrival bonus
    ended: NDArray[np.bool_]  # [C, R] the robot arrives or collides


def command_set(sizes: Commands, kinematics: Kinematics) -> NDArray[np.float32]:
    """Return all commands, [C, A] in [-1, 1]."""
    turns = np.linspace(-1.0, 1.0, sizes.turns)
    if kinematics is Kinematics.acceleration_heading:
        thrusts_and_turns = [(thrust, 0.0, turn) for thrust in LONGITUDINAL for turn in turns]
        return np.array(thrusts_and_turns, np.float32)
    if kinematics is Kinematics.unicycle:
        speeds = np.linspace(-1.0, 1.0, sizes.speeds)  # -1 means standing still
        return np.array([(speed, turn) for speed in speeds for turn in turns], np.float32)
    angle = np.arange(sizes.directions) * (2.0 * math.pi / sizes.directions)
    speed = np.arange(1, sizes.speeds + 1) / sizes.speeds
    velocities = speed[:, None, None] * unit_vectors(angle)
    return np.concatenate([np.zeros((1, 2)), velocities.reshape(-1, 2)]).astype(np.float32)


def predict_outcomes(
    tracks: Observation,
    active: NDArray[np.bool_],
    target: NDArray[np.float32],
    commands: NDArray[np.float32],
    scenario: Scenario,
) -> Outcomes:
    """Predict the outcome of every command after one step.

    Only people and other robots are predicted; further groups and sensors are left out.

    Args:
        tracks: tracks of the robots of E worlds, [E, N, ...].
        active: [E, N] the R robots for which outcomes are predicted, in this order.
        target: [E, N, 2] the point towards which progress is rewarded, m in the body frame.
        commands: [C, A] in [-1, 1].
        scenario: dynamics and reward.
    """
    robots = np.flatnonzero(active)
    shape = len(commands), len(robots)
    following = [np.empty((*shape, *array.shape[2:]), array.dtype) for array in tracks.agents]
    reward, ended = np.empty(shape, np.float32), np.empty(shape, np.bool_)
    _predict_outcomes(
        len(robots),
        robots,
        *tracks.agents,
        *seen_walls(tracks),
        np.ascontiguousarray(target),
        commands,
        kernel_parameters(scenario),
        *following,
        reward,
        ended,
    )
    ego, humans, humans_known, others, others_known = following
    entities = {"humans": Entities(humans, humans_known), "robots": Entities(others, others_known)}
    return Outcomes(Observation(ego, entities, {}), reward, ended)


@kernel
def _predict_outcomes(
    first,
    last,
    robot_index,
    ego,
    humans,
    humans_known,
    robots,
    robots_known,
    segments,
    segments_seen,
    target,
    commands,
    p,
    next_ego,
    next_humans,
    next_humans_known,
    next_robots,
    next_robots_known,
    reward,
    ended,
):
    n = ego.shape[1]
    walls = np.empty((WALL_ROWS, segments.shape[2] + 1), np.float32)
    for r in range(first, last):
        e, i = robot_index[r] // n, robot_index[r] % n
        own = ego[e, i]
        goal_x, goal_y = own[GOAL_X], own[GOAL_Y]
        target_x, target_y = target[e, i, 0], target[e, i, 1]
        seen = gather_walls(segments[e, i], segments_seen[e, i], walls)
        target_distance = math.sqrt(target_x * target_x + target_y * target_y)
        for c in range(commands.shape[0]):
            x, y, vx, vy, turn = step_robot(
                _ZERO, _ZERO, own[VELOCITY_X], own[VELOCITY_Y], _ZERO, commands[c], p
            )
            _next_ego(own, x, y, vx, vy, turn, p, next_ego[c, r])
            next_humans_known[c, r] = humans_known[e, i]
            next_robots_known[c, r] = robots_known[e, i]
            hit_human, gap = _next_others(
                own, humans[e, i], humans_known[e, i], x, y, vx, vy, turn, p, next_humans[c, r]
            )
            hit_robot, _ = _next_others(
                own, robots[e, i], robots_known[e, i], x, y, vx, vy, turn, p, next_robots[c, r]
            )
            hit_wall = not is_clear(walls, seen, _ZERO, _ZERO, x, y, p.robot_radius)
            collided = hit_human or hit_robot or hit_wall
            dx, dy = goal_x - x, goal_y - y
            goal_distance = math.sqrt(dx * dx + dy * dy)
            ends = collided and p.terminate_on_collision
            arrived = not ends and goal_distance < p.robot_radius
            dx, dy = target_x - x, target_y - y
            progress = target_distance - math.sqrt(dx * dx + dy * dy)
            parts = step_reward_parts(
                collided, arrived, False, True, gap, progress, goal_distance, p
            )
            reward[c, r] = sum_of_parts(parts)
            ended[c, r] = ends or arrived


@function
def _next_ego(own, x, y, vx, vy, turn, p, out):
    """Write the ego features after the robot moved to (x, y) and turned, in its new body frame."""
    cos, sin = math.cos(turn), math.sin(turn)
    for k in range(own.shape[0]):
        out[k] = own[k]
    for px, py in ((GOAL_X, GOAL_Y), (ORIGIN_X, ORIGIN_Y)):
        out[px], out[py] = untransform(cos, sin, x, y, own[px], own[py])
    out[VELOCITY_X], out[VELOCITY_Y] = unrotate(cos, sin, vx, vy)
    out[HEADING_COS], out[HEADING_SIN] = rotate(cos, sin, own[HEADING_COS], own[HEADING_SIN])
    out[TIME] = own[TIME] + _ONE / np.float32(p.time_limit_steps)


@function
def _next_others(own, others, known, x, y, vx, vy, turn, p, out):
    """Write the others' features [M, 6] after one step in the new body frame, with the same age.

    Returns whether the robot hits any of them during the step, and the surface distance to the
    nearest after it.
    """
    cos, sin = math.cos(turn), math.sin(turn)
    hit, gap = False, np.float32(np.inf)
    for j in range(known.shape[0]):
        if not known[j]:
            out[j, :] = _ZERO
            continue
        before_x, before_y = others[j, OTHER_X], others[j, OTHER_Y]
        other_vx = others[j, OTHER_VELOCITY_X] + own[VELOCITY_X]
        other_vy = others[j, OTHER_VELOCITY_Y] + own[VELOCITY_Y]
        dx = before_x + other_vx * p.time_step - x
        dy = before_y + other_vy * p.time_step - y
        radii = others[j, OTHER_RADIUS] + p.robot_radius
        hit = hit or closest_approach(before_x, before_y, dx, dy) < radii
        gap = min(gap, math.sqrt(dx * dx + dy * dy) - radii)
        out[j, OTHER_X], out[j, OTHER_Y] = unrotate(cos, sin, dx, dy)
        out[j, OTHER_VELOCITY_X], out[j, OTHER_VELOCITY_Y] = untransform(
            cos, sin, vx, vy, other_vx, other_vy
        )
        out[j, OTHER_RADIUS], out[j, AGE] = others[j, OTHER_RADIUS], others[j, AGE]
    return hit, gap
