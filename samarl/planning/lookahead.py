"""One step ahead: what each of a set of commands leads to, as far as a robot can predict it.

Everybody else goes on at constant velocity; nothing of the true next state is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mrsan import Kinematics, Scenario
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
from mrsan.parameters import kernel_parameters
from mrsan.reward import step_reward_parts, sum_of_parts
from mrsan.se2 import rotate, unrotate, untransform
from samarl.observations.tracker import AGE, Tracks
from samarl.planning.tracking import move

# Of the largest acceleration. In 0.25 s at SAMARL's limits the outer ones stop a robot or bring it
# to full speed, the inner ones change its speed by half.
LONGITUDINAL = (-1.0, -0.4, 0.0, 0.4, 1.0)

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


@dataclass
class Commands:
    """A set of commands, each of which a robot can execute."""

    turns: int = required(3, 99, help="turns, from right to left, of robots with a heading")
    speeds: int = required(2, 20, help="speeds of unicycles and holonomic robots")
    directions: int = required(1, 360, help="directions of holonomic robots")


class Outcomes(NamedTuple):
    """What C commands lead R robots to; the tracks look like those of C worlds of R robots."""

    tracks: Tracks  # [C, R, ...] in the body frames after the step
    reward: NDArray[np.float32]  # [C, R] of Eq. 10 of SAMARL, but for the team's arrival
    ended: NDArray[np.bool_]  # [C, R] the robot arrives or collides


def command_set(sizes: Commands, kinematics: Kinematics) -> NDArray[np.float32]:
    """All commands, [C, A]."""
    turns = np.linspace(-1.0, 1.0, sizes.turns)
    if kinematics is Kinematics.acceleration_heading:
        found = [(push, 0.0, turn) for push in LONGITUDINAL for turn in turns]
        return np.array(found, np.float32)
    if kinematics is Kinematics.unicycle:
        speeds = np.linspace(-1.0, 1.0, sizes.speeds)  # -1 is standing
        return np.array([(speed, turn) for speed in speeds for turn in turns], np.float32)
    angle = np.arange(sizes.directions) * (2.0 * math.pi / sizes.directions)
    speed = np.arange(1, sizes.speeds + 1) / sizes.speeds
    ways = speed[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return np.concatenate([np.zeros((1, 2)), ways.reshape(-1, 2)]).astype(np.float32)


def look_ahead(
    tracks: Tracks,
    active: NDArray[np.bool_],
    target: NDArray[np.float32],
    commands: NDArray[np.float32],
    scenario: Scenario,
) -> Outcomes:
    """What every command leads to within one step.

    Args:
        tracks: what the robots of E worlds know, [E, N, ...].
        active: [E, N] the R robots to look ahead for, in this order.
        target: [E, N, 2] progress is towards it, m in the body frame.
        commands: [C, A] in [-1, 1].
        scenario: dynamics and reward. Walls are not foreseen.
    """
    robots = np.flatnonzero(active)
    shape = len(commands), len(robots)
    own, humans, humans_known, others, others_known = (
        np.empty((*shape, *kept.shape[2:]), kept.dtype) for kept in tracks
    )
    reward, ended = np.empty(shape, np.float32), np.empty(shape, np.bool_)
    _look_ahead(
        len(robots), robots, *tracks, target, commands, kernel_parameters(scenario),
        own, humans, humans_known, others, others_known, reward, ended,
    )  # fmt: skip
    return Outcomes(Tracks(own, humans, humans_known, others, others_known), reward, ended)


@kernel
def _look_ahead(
    chunks,
    who,
    ego,
    humans,
    humans_known,
    robots,
    robots_known,
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
    total, n = who.shape[0], ego.shape[1]
    for chunk in prange(chunks):
        for r in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            e, i = who[r] // n, who[r] % n
            own = ego[e, i]
            goal_x, goal_y = own[GOAL_X], own[GOAL_Y]
            target_x, target_y = target[e, i, 0], target[e, i, 1]
            target_distance = math.sqrt(target_x * target_x + target_y * target_y)
            for c in range(commands.shape[0]):
                x, y, vx, vy, turn = move(
                    _ZERO, _ZERO, own[VELOCITY_X], own[VELOCITY_Y], _ZERO, commands[c], p
                )
                _turn_own(own, x, y, vx, vy, turn, p, next_ego[c, r])
                next_humans_known[c, r] = humans_known[e, i]
                next_robots_known[c, r] = robots_known[e, i]
                hit_human, gap = _turn_others(
                    own, humans[e, i], humans_known[e, i], x, y, vx, vy, turn, p, next_humans[c, r]
                )
                hit_robot, _ = _turn_others(
                    own, robots[e, i], robots_known[e, i], x, y, vx, vy, turn, p, next_robots[c, r]
                )
                collided = hit_human or hit_robot
                dx, dy = goal_x - x, goal_y - y
                left, ends = math.sqrt(dx * dx + dy * dy), collided and p.collisions_end
                arrived = not ends and left < p.robot_radius
                dx, dy = target_x - x, target_y - y
                progress = target_distance - math.sqrt(dx * dx + dy * dy)
                parts = step_reward_parts(collided, arrived, False, True, gap, progress, left, p)
                reward[c, r] = sum_of_parts(parts)
                ended[c, r] = ends or arrived


@function
def _turn_own(own, x, y, vx, vy, turn, p, out):
    """The robot's own state after it has moved to (x, y) and turned, in its new body frame."""
    cos, sin = math.cos(turn), math.sin(turn)
    for k in range(own.shape[0]):
        out[k] = own[k]
    for px, py in ((GOAL_X, GOAL_Y), (ORIGIN_X, ORIGIN_Y)):
        out[px], out[py] = untransform(cos, sin, x, y, own[px], own[py])
    out[VELOCITY_X], out[VELOCITY_Y] = unrotate(cos, sin, vx, vy)
    out[HEADING_COS], out[HEADING_SIN] = rotate(cos, sin, own[HEADING_COS], own[HEADING_SIN])
    out[TIME] = own[TIME] + _ONE / np.float32(p.time_limit_steps)


@function
def _turn_others(own, others, known, x, y, vx, vy, turn, p, out):
    """Where the others [M, 6] are then, in the new body frame; their age stays as it is.

    Returns whether one of them is hit on the way, and the surface distance to the nearest after it.
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
