"""Cheapest of a fixed set of plans, simulated against the predicted motion of others."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.fields import required
from mrsan.kernels import function, kernel
from mrsan.kernels.walls import WALL_ROWS, way_distance
from mrsan.parameters import kernel_parameters
from samarl.observations.route import next_point
from samarl.planning.offset_predictor import gather_offsets
from samarl.planning.velocity_control import (
    gather_rows,
    step_robot,
    track_rotated_velocity,
    track_velocity,
)
from samarl.planning.walls import gather_walls, seen_walls

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TWO_PI = np.float32(2.0 * math.pi)
_ROUNDING = np.float32(1e-3)
WALL_MARGIN = np.float32(0.02)  # m, distance that plans keep from walls


@dataclass
class Plans:
    """Parameters of the set of plans and of their cost.

    A plan drives in one direction at one speed for some time and then towards the goal. The set
    is fixed, not random, so that the action is a function of the observation.
    """

    horizon: float = required(0.01, 100.0, unit="s", help="simulated time")
    directions: int = required(1, 360, help="directions that are tried")
    speeds: int = required(1, 20, help="speeds that are tried")
    holds: int = required(
        1, 20, help="hold times that are tried: the whole horizon, a half, a third, ..."
    )
    human_margin: float = required(0.0, 5.0, unit="m", help="margin added to the radius of people")
    robot_margin: float = required(0.0, 5.0, unit="m", help="margin added to the radius of robots")
    comfort: float = required(0.0, 5.0, unit="m", help="surface distance without cost")
    comfort_weight: float = required(0.0, 1e6, help="cost per second at contact")
    collision_weight: float = required(0.0, 1e6, help="cost of a collision")
    collision_discount: float = required(0.0, 1.0, help="discount of later collisions, per second")


class PlanParameters(NamedTuple):
    """`Plans` in the kernels' units: float32 and steps."""

    horizon: int
    directions: int
    speeds: int
    holds: int
    human_margin: np.float32
    robot_margin: np.float32
    comfort: np.float32
    comfort_weight: np.float32  # per step
    collision_weight: np.float32
    collision_discount: np.float32  # per step


def plan_parameters(plans: Plans, scenario: Scenario) -> PlanParameters:
    """Return the parameters of the plans for the time step of a scenario."""
    return PlanParameters(
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
    )


def first_action(
    plans: Plans,
    tracks: Observation,
    scenario: Scenario,
    predicted_offset: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the first action of every robot's cheapest plan, [E, N, A].

    Args:
        plans: parameters of the plans and of their cost.
        tracks: what the robots observe or track; everybody moves at constant velocity.
        scenario: the dynamics.
        predicted_offset: people's offsets from constant velocity, see `OffsetPredictor.update`.
    """
    worlds, robots = tracks.ego.shape[:2]
    action = np.empty((worlds, robots, scenario.action_size), np.float32)
    plan = plan_parameters(plans, scenario)
    _first_action(
        worlds,
        *tracks.agents,
        *seen_walls(tracks),
        np.ascontiguousarray(next_point(tracks)),
        predicted_offset,
        kernel_parameters(scenario),
        plan,
        action,
    )
    return action


@kernel
def _first_action(
    first,
    last,
    ego,
    humans,
    humans_visible,
    robots,
    robots_visible,
    segments,
    segments_visible,
    targets,
    predicted_offset,
    p,
    plans,
    action,
):
    rows = np.empty((1 + humans.shape[2] + robots.shape[2], 5), np.float32)
    row_offset = np.zeros((rows.shape[0], predicted_offset.shape[3], 2), np.float32)
    walls = np.empty((WALL_ROWS, segments.shape[2] + 1), np.float32)
    scratch_action = np.empty(action.shape[2], np.float32)
    for e in range(first, last):
        for i in range(ego.shape[1]):
            count = gather_rows(
                ego[e, i],
                humans[e, i],
                humans_visible[e, i],
                robots[e, i],
                robots_visible[e, i],
                plans.human_margin,
                plans.robot_margin,
                rows,
            )
            gather_offsets(humans_visible[e, i], predicted_offset[e, i], row_offset)
            seen = gather_walls(segments[e, i], segments_visible[e, i], walls)
            _choose_action(
                rows,
                row_offset,
                count,
                walls,
                seen,
                targets[e, i, 0],
                targets[e, i, 1],
                plans,
                scratch_action,
                action[e, i],
                p,
            )


@function
def _choose_action(
    rows, row_offset, count, walls, seen, goal_x, goal_y, plans, scratch_action, action, p
):
    """Write the first action of the cheapest plan of one robot."""
    speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
    goal_angle = math.atan2(goal_y, goal_x)
    cheapest = np.float32(np.inf)
    for index in range(plans.directions * plans.speeds * plans.holds + 1):
        vx, vy, hold = _plan(index, goal_angle, plans, p)
        cost = _cost(
            rows,
            row_offset,
            count,
            walls,
            seen,
            goal_x,
            goal_y,
            vx,
            vy,
            hold,
            plans,
            cheapest,
            scratch_action,
            p,
        )
        if cost < cheapest:
            cheapest = cost
            track_velocity(vx, vy, speed, action, p)


@function
def _plan(index, goal_angle, plans, p):
    """Return the velocity of a plan (m/s) and for how many steps it is held; the last one waits."""
    direction = np.float32(index % plans.directions) / np.float32(plans.directions)
    angle = goal_angle + _TWO_PI * direction
    speed = p.robot_speed * np.float32(index // plans.directions % plans.speeds + 1)
    speed /= np.float32(plans.speeds)
    hold = max(plans.horizon // (index // (plans.directions * plans.speeds) + 1), 1)
    if index == plans.directions * plans.speeds * plans.holds:
        speed, hold = _ZERO, plans.horizon
    return speed * math.cos(angle), speed * math.sin(angle), hold


@function
def _cost(
    rows,
    row_offset,
    count,
    walls,
    seen,
    goal_x,
    goal_y,
    plan_vx,
    plan_vy,
    hold,
    plans,
    cheapest,
    action,
    p,
):
    """Return the cost of a plan: time, remaining distance, discomfort and a discounted collision.

    The cost is infinite as soon as the plan can no longer be cheaper than `cheapest`.
    """
    x, y, vx, vy, heading = _ZERO, _ZERO, rows[0, 2], rows[0, 3], _ZERO
    cost = _ZERO
    remaining = _ZERO
    discount = _ONE
    cheapest_collision = plans.collision_weight * plans.collision_discount ** np.float32(
        plans.horizon
    )
    for k in range(1, plans.horizon + 1):
        desired_x, desired_y = plan_vx, plan_vy
        dx, dy = goal_x - x, goal_y - y
        if k > hold:
            scale = p.robot_speed / max(math.sqrt(dx * dx + dy * dy), np.float32(1e-6))
            desired_x, desired_y = dx * scale, dy * scale
        track_rotated_velocity(vx, vy, heading, desired_x, desired_y, action, p)
        old_x, old_y = x, y
        x, y, vx, vy, heading = step_robot(x, y, vx, vy, heading, action, p)
        if seen > 0:
            distance = way_distance(walls, seen, old_x, old_y, x - old_x, y - old_y)
            if distance < p.robot_radius + WALL_MARGIN:
                return cost + plans.collision_weight * discount
        time, offset_step = np.float32(k) * p.time_step, min(k, row_offset.shape[1] - 1)
        gap = np.float32(np.inf)
        for j in range(1, count):
            ax = rows[j, 0] + rows[j, 2] * time + row_offset[j, offset_step, 0] - x
            ay = rows[j, 1] + rows[j, 3] * time + row_offset[j, offset_step, 1] - y
            gap = min(gap, math.sqrt(ax * ax + ay * ay) - rows[j, 4])
        gap -= p.robot_radius
        if gap < _ZERO:
            return cost + plans.collision_weight * discount
        if gap < plans.comfort:
            cost += plans.comfort_weight * discount * (_ONE - gap / plans.comfort)
        discount *= plans.collision_discount
        dx, dy = goal_x - x, goal_y - y
        remaining = math.sqrt(dx * dx + dy * dy)
        if remaining < p.robot_radius:
            # Its target may be a corner of the route: it must be able to stop before a wall beyond.
            stop = np.float32(0.5) * math.sqrt(vx * vx + vy * vy) / p.max_acceleration  # s
            if seen > 0 and (
                way_distance(walls, seen, x, y, stop * vx, stop * vy) < p.robot_radius + WALL_MARGIN
            ):
                return cost + plans.collision_weight * discount
            return cost + p.robot_speed * time
        # The rest costs at least the remaining distance or a collision at the end of the horizon.
        path_cost = p.robot_speed * time + remaining - p.robot_radius - _ROUNDING
        if cost + min(path_cost, cheapest_collision) >= cheapest:
            return np.float32(np.inf)
    return cost + p.robot_speed * time + remaining
