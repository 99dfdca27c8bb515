"""A fixed set of plans, simulated against predictions of those who are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mrsan import Scenario
from mrsan.features import GOAL_X, GOAL_Y
from mrsan.fields import required
from mrsan.kernels import function, kernel
from mrsan.parameters import kernel_parameters
from samarl.planning.foresight import gather_aside
from samarl.planning.tracking import gather, move, steer, track_velocity

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)
_ROUNDING = np.float32(1e-3)


@dataclass
class Plans:
    """A set of plans, and what they cost.

    A plan drives in one direction at one speed for a while and then towards the goal. The set
    is fixed, not random, so a decision is a function of what is known.
    """

    horizon: float = required(0.01, 100.0, unit="s", help="duration of a plan")
    directions: int = required(1, 360, help="directions that are tried")
    speeds: int = required(1, 20, help="speeds that are tried")
    holds: int = required(
        1, 20, help="durations that are tried: the horizon, half of it, a third, ..."
    )
    human_margin: float = required(0.0, 5.0, unit="m", help="margin added to the radius of people")
    robot_margin: float = required(0.0, 5.0, unit="m", help="margin added to the radius of robots")
    comfort: float = required(0.0, 5.0, unit="m", help="distance that costs nothing")
    comfort_weight: float = required(0.0, 1e6, help="cost per second at contact")
    collision_weight: float = required(0.0, 1e6, help="cost of a collision")
    collision_discount: float = required(0.0, 1.0, help="discount of later collisions, per second")


def first_action(
    plans: Plans, known: Sequence[NDArray[Any]], scenario: Scenario, aside: NDArray[np.float32]
) -> NDArray[np.float32]:
    """The first action of every robot's cheapest plan, [E, N, A].

    Args:
        plans: the set, and what it costs.
        known: `Observation.perception` or `Tracks`: all of them go on at constant velocity.
        scenario: the dynamics.
        aside: by how much people will be elsewhere, as `Foresight.update` says.
    """
    worlds, robots = known[0].shape[:2]
    action = np.empty((worlds, robots, scenario.action_size), np.float32)
    _choose(
        worlds,
        *known,
        aside,
        kernel_parameters(scenario),
        max(1, scenario.steps(plans.horizon)),
        plans.directions,
        plans.speeds,
        plans.holds,
        np.float32(plans.human_margin),
        np.float32(plans.robot_margin),
        np.float32(plans.comfort),
        np.float32(plans.comfort_weight * scenario.time_step),
        np.float32(plans.collision_weight),
        np.float32(plans.collision_discount**scenario.time_step),
        action,
    )
    return action


@kernel
def _choose(
    chunks,
    ego,
    humans,
    humans_visible,
    robots,
    robots_visible,
    aside,
    p,
    horizon,
    directions,
    speeds,
    holds,
    human_margin,
    robot_margin,
    comfort,
    comfort_weight,
    collision_weight,
    collision_discount,
    action,
):
    total = ego.shape[0]
    for chunk in prange(chunks):
        rows = np.empty((1 + humans.shape[2] + robots.shape[2], 5), np.float32)
        bends = np.zeros((rows.shape[0], aside.shape[3], 2), np.float32)
        attempt = np.empty(action.shape[2], np.float32)
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            for i in range(ego.shape[1]):
                count = gather(
                    ego[e, i],
                    humans[e, i],
                    humans_visible[e, i],
                    robots[e, i],
                    robots_visible[e, i],
                    human_margin,
                    robot_margin,
                    rows,
                )
                gather_aside(humans_visible[e, i], aside[e, i], bends)
                speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
                goal_x, goal_y = ego[e, i, GOAL_X], ego[e, i, GOAL_Y]
                goal_angle = math.atan2(goal_y, goal_x)
                cheapest = np.float32(np.inf)
                for plan in range(directions * speeds * holds + 1):
                    direction = np.float32(plan % directions) / np.float32(directions)
                    angle = goal_angle + _TWO_PI * direction
                    wanted = p.robot_speed * np.float32(plan // directions % speeds + 1)
                    wanted /= np.float32(speeds)
                    hold = max(horizon // (plan // (directions * speeds) + 1), 1)
                    if plan == directions * speeds * holds:  # stand still
                        wanted, hold = _ZERO, horizon
                    vx, vy = wanted * math.cos(angle), wanted * math.sin(angle)
                    cost = _cost(
                        rows,
                        bends,
                        count,
                        goal_x,
                        goal_y,
                        vx,
                        vy,
                        horizon,
                        hold,
                        comfort,
                        comfort_weight,
                        collision_weight,
                        collision_discount,
                        cheapest,
                        attempt,
                        p,
                    )
                    if cost < cheapest:
                        cheapest = cost
                        track_velocity(vx, vy, speed, action[e, i], p)


@function
def _cost(
    rows,
    bends,
    count,
    goal_x,
    goal_y,
    plan_vx,
    plan_vy,
    horizon,
    hold,
    comfort,
    comfort_weight,
    collision_weight,
    collision_discount,
    cheapest,
    action,
    p,
):
    """What a plan costs: time, distance left, discomfort, a discounted collision.

    It gives up as soon as it is clear that the plan will cost more than the cheapest so far.
    """
    x, y, vx, vy, heading = _ZERO, _ZERO, rows[0, 2], rows[0, 3], _ZERO
    cost = _ZERO
    left = _ZERO
    discount = _ONE
    least_collision = collision_weight * collision_discount ** np.float32(horizon)
    for k in range(1, horizon + 1):
        wanted_x, wanted_y = plan_vx, plan_vy
        dx, dy = goal_x - x, goal_y - y
        if k > hold:
            scale = p.robot_speed / max(math.sqrt(dx * dx + dy * dy), np.float32(1e-6))
            wanted_x, wanted_y = dx * scale, dy * scale
        steer(vx, vy, heading, wanted_x, wanted_y, action, p)
        x, y, vx, vy, heading = move(x, y, vx, vy, heading, action, p)
        time, later = np.float32(k) * p.time_step, min(k, bends.shape[1] - 1)
        gap = np.float32(np.inf)
        for j in range(1, count):
            ax = rows[j, 0] + rows[j, 2] * time + bends[j, later, 0] - x
            ay = rows[j, 1] + rows[j, 3] * time + bends[j, later, 1] - y
            gap = min(gap, math.sqrt(ax * ax + ay * ay) - rows[j, 4])
        gap -= p.robot_radius
        if gap < _ZERO:
            return cost + collision_weight * discount
        if gap < comfort:
            cost += comfort_weight * discount * (_ONE - gap / comfort)
        discount *= collision_discount
        dx, dy = goal_x - x, goal_y - y
        left = math.sqrt(dx * dx + dy * dy)
        if left < p.robot_radius:
            return cost + p.robot_speed * time
        # It will cost at least the way that is left, or a collision at the end of the horizon.
        way = p.robot_speed * time + left - p.robot_radius - _ROUNDING
        if cost + min(way, least_collision) >= cheapest:
            return np.float32(np.inf)
    return cost + p.robot_speed * time + left
