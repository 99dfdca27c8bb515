"""The cheapest of a set of rollouts along a path: exact for the robot, walls and parked robots.

Everything is in the world frame. A rollout keeps the way free that the robot needs to brake after
its first step, so that the robot can always stop before walls and before team-mates who brake too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mrsan.kernels import function, separate
from mrsan.kernels.kinematics import wrap_angle
from mrsan.kernels.routes import X, Y, find_route, following_corner
from mrsan.kernels.walls import WALL_ROWS, is_clear, nearest_point, wall_count
from samarl.planning.velocity_control import step_robot, track_rotated_velocity

STEPS = 14  # of a rollout
_DIRECTIONS = 16
_PURSUITS = 6  # candidates that follow the path
_SPEEDS = (1.0, 0.55, 0.2)  # of these, as shares of the preferred speed
_MODES = 3  # of each direction: turn first at full speed; on an arc at full and at half speed
_CANDIDATES = _PURSUITS + _MODES * _DIRECTIONS + 1  # the last one stops
_TURN_FIRST, _ON_ARC = np.float32(0.2), np.float32(1.2)  # rad, above which it turns in place
_REACHED = 0.3  # m, from a point of the path to the next one
_PASSED = 0.25  # m, beside the way between them where it is behind the robot
_DISCOUNT = 0.93  # per step
# Of the steps after step t, the sum of the discounts, and the same times their number.
_LATER = tuple(math.fsum(_DISCOUNT**s for s in range(t + 1, STEPS)) for t in range(STEPS))
_LATER_STEPS = tuple(
    math.fsum(_DISCOUNT**s * (s - t) for s in range(t + 1, STEPS)) for t in range(STEPS)
)
_CUT = 0.3  # m, by which a robot may shorten its path at a point
_PERSON_STEPS, _PERSON_MOVES = 8, 4  # for which people count, and for which they move
_ROBOT_MARGIN, _ROBOT_COMFORT, _PERSON_COMFORT = 0.03, 0.25, 0.4  # m, surface to surface
_WALL_MARGIN = 0.012  # m
_OWN_GOAL_COST = 60.0  # of arriving while it must not

_ZERO = np.float32(0.0)


class Others(NamedTuple):
    """What one robot expects of everybody else."""

    robots: np.ndarray  # [N, STEPS + 1, 2] predicted positions, m
    stops: np.ndarray  # [N, 2] where they stand if they brake after the first step, m
    counts: np.ndarray  # [N] bool, whether they are known and others
    people: np.ndarray  # [M, 5] position, velocity and radius, m and m/s
    present: np.ndarray  # [M] bool, whether it sees them


class Weights(NamedTuple):
    """How a robot weighs others against its way."""

    people: float  # cost per metre of a discomfort
    robots: float
    gap: float  # m, that is kept from people in the next step if possible
    avoids_goal: bool  # must not arrive yet


@function
def write_route(walls, place, corners, distance, x, y, to_x, to_y, cost, path, count):
    """Append the points of the shortest route from (x, y) to `path` [P, 2]; return their number."""
    corner, following = find_route(walls, place, corners, distance, x, y, to_x, to_y, cost)
    while corner >= 0 and count < path.shape[0] - 1:
        path[count, 0], path[count, 1] = corners[X, corner], corners[Y, corner]
        count += 1
        corner = following
        following = following_corner(place, corners, distance, cost, corner)
    path[count, 0], path[count, 1] = to_x, to_y
    return count + 1


@function
def write_rest(path, count, rest):
    """Write the length of the path from each of its points on, m."""
    rest[count - 1] = 0.0
    for k in range(count - 2, -1, -1):
        rest[k] = rest[k + 1] + math.hypot(path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1])


@function
def following_point(path, count, k, x, y):
    """Return the point of the path to head for, not before point `k`."""
    while k < count - 1:
        dx, dy = x - path[k, 0], y - path[k, 1]
        ux, uy = path[k + 1, 0] - path[k, 0], path[k + 1, 1] - path[k, 1]
        length = max(math.hypot(ux, uy), 1e-9)
        along, aside = (dx * ux + dy * uy) / length, abs(dy * ux - dx * uy) / length
        if not (math.hypot(dx, dy) < _REACHED or (along > 0.0 and aside < _PASSED)):
            break
        k += 1
    return k


@separate
def near_walls_of(walls, place, x, y, reach, near):
    """Copy the walls within reach into `near`.

    Returns the number of columns to examine, and the distance of the nearest wall, m.
    """
    count, nearest = 0, reach
    for k in range(wall_count(place)):
        px, py = nearest_point(walls, k, x, y)
        gap = math.hypot(px - x, py - y)
        nearest = min(nearest, gap)
        if gap < reach and count < near.shape[1]:
            for row in range(WALL_ROWS):
                near[row, count] = walls[row, k]
            count += 1
    return count, nearest


@function
def _candidate(index, bearing, to_x, to_y, p):
    """Return the desired velocity of a candidate, and the angle above which it turns in place."""
    if index < _PURSUITS:
        speed = p.robot_speed * _SPEEDS[index // 2]
        scale = speed / max(math.hypot(to_x, to_y), 1e-6)
        return to_x * scale, to_y * scale, _TURN_FIRST if index % 2 == 0 else _ON_ARC
    if index == _CANDIDATES - 1:
        return 0.0, 0.0, _ON_ARC
    mode = (index - _PURSUITS) % _MODES
    angle = bearing + 2.0 * math.pi * ((index - _PURSUITS) // _MODES) / _DIRECTIONS
    speed = p.robot_speed * (1.0 if mode < 2 else 0.5)
    turn = _TURN_FIRST if mode == 0 else _ON_ARC
    return speed * math.cos(angle), speed * math.sin(angle), turn


@separate
def plan(
    i,
    pose,
    goal,
    path,
    count,
    rest,
    tolerance,
    walls,
    seen,
    room,
    others,
    weights,
    p,
    scratch,
    action,
    best_way,
):
    """Write the first action of the cheapest rollout of robot `i`, and where it leads.

    Args:
        i: the robot.
        pose: [5] position, velocity and heading.
        goal: [2] its goal, which it may have to avoid, m.
        path: [P, 2] the points that it follows, `count` of them.
        count: likewise.
        rest: [P] length of the path from each point on, m.
        tolerance: distance at which the end of the path is reached, m.
        walls: [12, K] the walls near the robot, `seen` of them.
        seen: likewise.
        room: distance of the nearest wall, m.
        others: what it expects of others, `Others`.
        weights: `Weights`.
        p: the scenario's parameters.
        scratch: twice [A], and [STEPS + 1, 2], room to work in.
        action: [A], written.
        best_way: [STEPS + 1, 2], written.
    """
    trial, first, way = scratch
    x0, y0 = pose[0], pose[1]
    k0 = following_point(path, count, 0, x0, y0)
    bearing = math.atan2(path[k0, 1] - y0, path[k0, 0] - x0)
    cheapest, radius = np.inf, p.robot_radius + _WALL_MARGIN
    stands = math.hypot(pose[2], pose[3]) < 0.01
    for index in range(_CANDIDATES):
        x, y, vx, vy, heading = x0, y0, pose[2], pose[3], pose[4]
        k, cost, discount = k0, 0.0, 1.0
        way[0, 0], way[0, 1] = x, y
        possible = True
        for t in range(STEPS):
            to_x, to_y = path[k, 0] - x, path[k, 1] - y
            wish_x, wish_y, angle = _candidate(index, bearing, to_x, to_y, p)
            if k == count - 1 and math.hypot(to_x, to_y) < tolerance:
                wish_x = wish_y = 0.0
            if index == _CANDIDATES - 1 and t == 0 and stands:  # it turns towards its path
                wish_x, wish_y, angle = 1e-3 * to_x, 1e-3 * to_y, _ZERO
            track_rotated_velocity(vx, vy, heading, wish_x, wish_y, trial, p, angle)
            new_x, new_y, new_vx, new_vy, new_heading = step_robot(x, y, vx, vy, heading, trial, p)
            if t == 0:
                for a in range(first.shape[0]):
                    first[a] = trial[a]
                stop_x = new_x + 0.5 * new_vx * p.time_step
                stop_y = new_y + 0.5 * new_vy * p.time_step
                possible = _is_possible(
                    i, x, y, new_x, new_y, stop_x, stop_y, walls, seen, others, p
                )
                if not possible:
                    break
                cost += _near_people(x, y, new_x, new_y, stop_x, stop_y, others, weights.gap, p)
            elif math.hypot(new_x - x0, new_y - y0) + radius > room and not is_clear(
                walls, seen, x, y, new_x - x, new_y - y, radius
            ):
                new_x, new_y, new_vx, new_vy = x, y, 0.0, 0.0
                cost += 0.5
            x, y, vx, vy, heading = new_x, new_y, new_vx, new_vy, wrap_angle(new_heading)
            way[t + 1, 0], way[t + 1, 1] = x, y
            k = following_point(path, count, k, x, y)
            left = math.hypot(path[k, 0] - x, path[k, 1] - y) + rest[k]
            cost += discount * left
            cost += discount * _discomfort(i, t, x, y, others, weights, p)
            from_goal = math.hypot(x - goal[0], y - goal[1])
            if weights.avoids_goal and t < _PERSON_STEPS and from_goal < p.robot_radius + 0.04:
                cost += _OWN_GOAL_COST
            discount *= _DISCOUNT
            least = (left - _CUT) * _LATER[t] - p.robot_speed * p.time_step * _LATER_STEPS[t]
            if cost + max(least, 0.0) >= cheapest:
                cost = np.inf
                break
        if not possible or cost >= cheapest:
            continue
        cheapest = cost
        for t in range(STEPS + 1):
            best_way[t, 0], best_way[t, 1] = way[t, 0], way[t, 1]
        for a in range(first.shape[0]):
            action[a] = first[a]
    if cheapest == np.inf:
        track_rotated_velocity(pose[2], pose[3], pose[4], 0.0, 0.0, action, p, _ON_ARC)
        for t in range(STEPS + 1):
            best_way[t, 0], best_way[t, 1] = others.stops[i, 0], others.stops[i, 1]


@function
def _is_possible(i, x, y, new_x, new_y, stop_x, stop_y, walls, seen, others, p):
    """Return whether the robot may move to a point if it brakes to a stop at another after that."""
    radius = p.robot_radius + _WALL_MARGIN
    if not is_clear(walls, seen, x, y, new_x - x, new_y - y, radius):
        return False
    if not is_clear(walls, seen, new_x, new_y, stop_x - new_x, stop_y - new_y, radius):
        return False
    least = 2.0 * p.robot_radius + _ROBOT_MARGIN
    for j in range(others.counts.shape[0]):
        if j == i or not others.counts[j]:
            continue
        here_x, here_y = others.robots[j, 0, 0], others.robots[j, 0, 1]
        next_x, next_y = others.robots[j, 1, 0], others.robots[j, 1, 1]
        end_x, end_y = others.stops[j, 0], others.stops[j, 1]
        now = math.hypot(x - here_x, y - here_y)
        middle = math.hypot(
            0.5 * (x + new_x - here_x - next_x), 0.5 * (y + new_y - here_y - next_y)
        )
        after = math.hypot(new_x - next_x, new_y - next_y)
        end = math.hypot(stop_x - end_x, stop_y - end_y)
        end = min(end, math.hypot(stop_x - next_x, stop_y - next_y))
        end = min(end, math.hypot(new_x - end_x, new_y - end_y))
        parts = end > now + 1e-3 and after > 2.0 * p.robot_radius + 0.005
        if min(middle, min(after, end)) < least and not parts:
            return False
    return True


@function
def _near_people(x, y, new_x, new_y, stop_x, stop_y, others, gap, p):
    """Return the cost of the next step for coming closer to people than `gap`."""
    cost, dt = 0.0, p.time_step
    for m in range(others.people.shape[0]):
        if not others.present[m]:
            continue
        person = others.people[m]
        reach = p.robot_radius + person[4]
        vx, vy = person[2] * dt, person[3] * dt
        middle = math.hypot(
            0.5 * (x + new_x) - person[0] - 0.5 * vx, 0.5 * (y + new_y) - person[1] - 0.5 * vy
        )
        after = math.hypot(new_x - person[0] - vx, new_y - person[1] - vy)
        end = math.hypot(stop_x - person[0] - 2.0 * vx, stop_y - person[1] - 2.0 * vy)
        nearest = min(middle, min(after, end + 0.05)) - reach
        if nearest < gap:
            cost += 3000.0 * (gap - nearest) + 500.0
    return cost


@function
def _discomfort(i, t, x, y, others, weights, p):
    """Return the cost of being close to others at the end of step `t`."""
    cost = 0.0
    for j in range(others.counts.shape[0]):
        if j == i or not others.counts[j]:
            continue
        gap = math.hypot(x - others.robots[j, t + 1, 0], y - others.robots[j, t + 1, 1])
        gap -= 2.0 * p.robot_radius
        if gap < _ROBOT_COMFORT:
            cost += weights.robots * (_ROBOT_COMFORT - gap) * (4.0 if gap < 0.05 else 1.0)
    if t < _PERSON_STEPS:
        time = min(t + 1, _PERSON_MOVES) * p.time_step
        for m in range(others.people.shape[0]):
            if not others.present[m]:
                continue
            person = others.people[m]
            gap = math.hypot(x - person[0] - person[2] * time, y - person[1] - person[3] * time)
            gap -= p.robot_radius + person[4]
            if gap < _PERSON_COMFORT:
                cost += weights.people * (_PERSON_COMFORT - gap) * (4.0 if gap < 0.1 else 1.0)
    return cost
