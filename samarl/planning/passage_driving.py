"""How a team drives by the right of way: where robots are sent, and their paths."""

from __future__ import annotations

import math

import numpy as np

from mrsan.features import OTHER_RADIUS
from mrsan.kernels import function, kernel, separate
from mrsan.kernels.passages import distance_from_way
from mrsan.kernels.walls import WALL_ROWS, is_clear
from samarl.planning.path_rollouts import (
    STEPS,
    Others,
    Weights,
    near_walls_of,
    plan,
    write_rest,
    write_route,
)
from samarl.planning.right_of_way import (
    CLAIM,
    WAIT,
    distance_to,
    is_parked,
    map_of_world,
    mouths_of_world,
    number_of_mode,
    update_mode,
)
from samarl.planning.team_beliefs import POINTS, length_between, write_track
from samarl.planning.velocity_control import track_rotated_velocity

_APPROACH = 0.45  # m, of the points before and behind a passage through which robots drive
_NEAR_WALL = 4.5  # m, farther than a rollout leads
_AT_GOAL, _AT_PLACE = 0.12, 0.25  # m, distances at which robots stop
_ALONE = 1.0  # m, surface distance from which on nobody disturbs a robot that stands
_STUCK = 10  # steps, after which a robot comes closer to people
_PREDICTED = 3  # steps for which team-mates who share no plans move
_PEOPLE, _PEOPLE_INSIDE, _ROBOTS = 6.0, 0.5, 8.0  # cost per metre too close; inside a passage
_GAP, _STUCK_GAP = 0.1, 0.03  # m, kept from people in the next step if possible; if it is stuck
_ROUND, _CLEAR = 0.12, 0.06  # m, at which paths lead round them, and that paths keep from them


@kernel
def drive(
    first,
    last,
    ego,
    humans,
    humans_visible,
    known_maps,
    all_mouths,
    first_mouth,
    memory,
    central,
    p,
    action,
):
    """Write the actions of all robots [E, N, A] after they have perceived and chosen.

    Args:
        first: first world to work on.
        last: the one after the last.
        ego: [E, N, 11], and so on: what robots observe.
        humans: likewise.
        humans_visible: likewise.
        known_maps: `KnownMap` of all worlds.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`, updated.
        central: whether robots know the truth of each other.
        p: the scenario's parameters.
        action: [E, N, A], written.
    """
    n, m = ego.shape[1], humans.shape[2]
    decided = np.zeros(n, np.bool_)
    people, present = np.zeros((m, 5)), np.zeros(m, np.bool_)
    expected, stops, counts = (
        np.zeros((n, STEPS + 1, 2)),
        np.zeros((n, 2)),
        np.ones(n, np.bool_),
    )
    plans, plan_stops = np.zeros((n, STEPS + 1, 2)), np.zeros((n, 2))
    path, rest, cost = (
        np.zeros((POINTS, 2)),
        np.zeros(POINTS),
        np.zeros(known_maps.corners.shape[2], np.float32),
    )
    near = np.zeros((WALL_ROWS, known_maps.walls.shape[2] + 1), np.float32)
    actions = action.shape[2]
    scratch = (
        np.zeros(actions, np.float32),
        np.zeros(actions, np.float32),
        np.zeros((STEPS + 1, 2)),
    )
    for e in range(first, last):
        known_map = map_of_world(known_maps, e)
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        pose, goal = memory.pose[e], memory.goal[e]
        for i in range(n):
            update_mode(e, i, mouths, memory, known_map, p.robot_radius, central)
        present[:] = False
        if central:
            for i in range(n):
                _see(ego[e, i], pose[i], humans[e, i], humans_visible[e, i], people, present)
        for i in range(n):
            decided[i] = memory.arrived[e, i]
            _brake(pose[i], p.time_step, plan_stops[i])
            for t in range(STEPS + 1):
                plans[i, t, 0], plans[i, t, 1] = plan_stops[i, 0], plan_stops[i, 1]
            plans[i, 0, 0], plans[i, 0, 1] = pose[i, 0], pose[i, 1]
            action[e, i, :] = 0.0
        for _ in range(n):
            i = _next_to_plan(e, decided, memory)
            if i < 0:
                break
            if central:
                others = Others(plans, plan_stops, counts, people, present)
            else:
                _expect(e, i, memory, p.time_step, expected, stops, counts)
                _brake(pose[i], p.time_step, stops[i])
                present[:] = False
                _see(ego[e, i], pose[i], humans[e, i], humans_visible[e, i], people, present)
                others = Others(expected, stops, counts, people, present)
            length = _write_path(e, i, mouths, memory, known_map, cost, path)
            at_goal = length_between(path[length - 1], goal[i]) < 1e-6
            decided[i] = True
            if not at_goal and _stands(i, pose, path[length - 1], others, p):
                track_rotated_velocity(
                    pose[i, 2], pose[i, 3], pose[i, 4], 0.0, 0.0, action[e, i], p, np.float32(0.0)
                )
                memory.stuck[e, i] = max(memory.stuck[e, i] - 2, 0)
                continue
            tolerance = _AT_GOAL if at_goal else _AT_PLACE
            walls, place, _, _ = known_map
            columns, room = near_walls_of(walls, place, pose[i, 0], pose[i, 1], _NEAR_WALL, near)
            length = _go_round(e, i, pose[i], mouths, memory, near, columns, p, path, length)
            write_rest(path, length, rest)
            weights = _weigh(e, i, pose[i], at_goal, mouths, memory)
            plan(
                i,
                pose[i],
                goal[i],
                path,
                length,
                rest,
                tolerance,
                near,
                columns,
                room,
                others,
                weights,
                p,
                scratch,
                action[e, i],
                plans[i],
            )
            plan_stops[i, 0] = 1.5 * plans[i, 1, 0] - 0.5 * plans[i, 0, 0]
            plan_stops[i, 1] = 1.5 * plans[i, 1, 1] - 0.5 * plans[i, 0, 1]
            _count_standstill(e, i, pose[i], at_goal, memory)
        for i in range(n):
            memory.macro_action[e, i] = number_of_mode(e, i, mouths, memory)


@kernel
def direct(
    first,
    last,
    known_maps,
    all_mouths,
    first_mouth,
    memory,
    central,
    p,
    target,
    following,
):
    """Write where robots have to go, for a driver that follows a route by itself.

    Args:
        first: first world to work on.
        last: the one after the last.
        known_maps: `KnownMap` of all worlds.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`, updated.
        central: whether robots know the truth of each other.
        p: the scenario's parameters.
        target: [E, N, 2] their goals or their queue places in the world frame, written, m.
        following: [E, N, 2] the next point of the way there, written, m.
    """
    path, cost = np.zeros((POINTS, 2)), np.zeros(known_maps.corners.shape[2], np.float32)
    for e in range(first, last):
        known_map = map_of_world(known_maps, e)
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        pose, goal = memory.pose[e], memory.goal[e]
        for i in range(pose.shape[0]):
            update_mode(e, i, mouths, memory, known_map, p.robot_radius, central)
        for i in range(pose.shape[0]):
            to = _target(e, i, memory)
            x, y = pose[i, 0], pose[i, 1]
            write_route(*known_map, x, y, to[0], to[1], cost, path, 0)
            target[e, i, 0], target[e, i, 1] = to[0], to[1]
            following[e, i, 0], following[e, i, 1] = path[0, 0], path[0, 1]
            _count_standstill(e, i, pose[i], length_between(to, goal[i]) < 1e-6, memory)
            memory.macro_action[e, i] = number_of_mode(e, i, mouths, memory)


@function
def _see(ego, pose, humans, visible, people, present):
    """Add the people that a robot sees."""
    for j in range(visible.shape[0]):
        if visible[j]:
            write_track(ego, pose, humans[j], people[j])
            people[j, 4], present[j] = humans[j, OTHER_RADIUS], True


@function
def _stands(i, pose, place, others, p):
    """Return whether robot `i` stands at its place, with nobody near."""
    x, y = pose[i, 0], pose[i, 1]
    stands = math.hypot(pose[i, 2], pose[i, 3]) < 0.01
    stands &= length_between(place, pose[i]) < _AT_PLACE
    for j in range(pose.shape[0]):
        gap = math.hypot(others.robots[j, 0, 0] - x, others.robots[j, 0, 1] - y)
        stands &= j == i or not others.counts[j] or gap > 2.0 * p.robot_radius + _ALONE
    for h in range(others.present.shape[0]):
        gap = math.hypot(others.people[h, 0] - x, others.people[h, 1] - y)
        stands &= not others.present[h] or gap > p.robot_radius + others.people[h, 4] + _ALONE
    return stands


@function
def _brake(pose, dt, out):
    """Write where a robot stands that brakes now."""
    out[0], out[1] = pose[0] + 0.5 * dt * pose[2], pose[1] + 0.5 * dt * pose[3]


@function
def _expect(e, i, memory, dt, expected, stops, counts):
    """Write where robot `i` expects those who do not share their plans."""
    for j in range(counts.shape[0]):
        counts[j] = memory.known[e, i, j]
        other = memory.belief[e, i, j]
        for t in range(STEPS + 1):
            time = dt * min(t, _PREDICTED)
            expected[j, t, 0], expected[j, t, 1] = (
                other[0] + time * other[2],
                other[1] + time * other[3],
            )
        stops[j, 0], stops[j, 1] = other[0] + 1.5 * dt * other[2], other[1] + 1.5 * dt * other[3]


@function
def _target(e, i, memory):
    """Return the point to which robot `i` is sent: its place or its goal."""
    if memory.queued[e, i] >= 0 or memory.yields[e, i] > 0:
        return memory.place[e, i, 0], memory.place[e, i, 1]
    return memory.goal[e, i, 0], memory.goal[e, i, 1]


@separate
def _write_path(e, i, mouths, memory, known_map, cost, path):
    """Write the path of robot `i`; return the number of its points."""
    x, y, to = memory.pose[e, i, 0], memory.pose[e, i, 1], _target(e, i, memory)
    gives_way = memory.yields[e, i] > 0
    entry, leave, count = memory.entry[e, i], memory.exit[e, i], 0
    if entry >= 0 and leave >= 0 and memory.mode[e, i] != WAIT and not gives_way:
        for k in (entry, leave):
            if k == entry and memory.inside[e, i]:
                continue
            by_x = mouths.position[k, 0] + _APPROACH * mouths.outward[k, 0]
            by_y = mouths.position[k, 1] + _APPROACH * mouths.outward[k, 1]
            count = write_route(*known_map, x, y, by_x, by_y, cost, path, count)
            x, y = by_x, by_y
    return write_route(*known_map, x, y, to[0], to[1], cost, path, count)


@separate
def _go_round(e, i, pose, mouths, memory, walls, seen, p, path, count):
    """Add points to a path that lead round parked team-mates nearby; return their number."""
    ax, ay, k = pose[0], pose[1], 0
    least = 2.0 * p.robot_radius + _CLEAR
    while k < count and count < path.shape[0] - 1 and k < 8:
        bx, by = path[k, 0], path[k, 1]
        for j in range(memory.known.shape[1]):
            if not is_parked(e, i, j, mouths, memory):
                continue
            x, y = memory.belief[e, i, j, 0], memory.belief[e, i, j, 1]
            if math.hypot(x - pose[0], y - pose[1]) > _NEAR_WALL - 1.5:
                continue
            if min(math.hypot(x - ax, y - ay), math.hypot(x - bx, y - by)) < least:
                continue
            if distance_from_way(x, y, ax, ay, bx, by) >= least:
                continue
            length = math.hypot(bx - ax, by - ay)
            nx, ny = (ay - by) / length, (bx - ax) / length
            side = 1.0 if (ax - x) * nx + (ay - y) * ny >= 0.0 else -1.0
            to_x = to_y = 0.0
            possible = False
            for _ in range(2):
                reach = side * (2.0 * p.robot_radius + _ROUND)
                to_x, to_y = x + reach * nx, y + reach * ny
                possible = _has_room(e, i, to_x, to_y, mouths, memory, walls, seen, p)
                if possible:
                    break
                side = -side
            if possible:
                for s in range(count, k, -1):
                    path[s, 0], path[s, 1] = path[s - 1, 0], path[s - 1, 1]
                path[k, 0], path[k, 1] = to_x, to_y
                count += 1
                break
        ax, ay = path[k, 0], path[k, 1]
        k += 1
    return count


@function
def _has_room(e, i, x, y, mouths, memory, walls, seen, p):
    """Return whether there is room for robot `i` at (x, y)."""
    if not is_clear(walls, seen, x, y, 0.0, 0.0, p.robot_radius + 0.03):
        return False
    for j in range(memory.known.shape[1]):
        if is_parked(e, i, j, mouths, memory):
            other = memory.belief[e, i, j]
            if math.hypot(x - other[0], y - other[1]) < 2.0 * p.robot_radius + 0.04:
                return False
    return True


@function
def _next_to_plan(e, decided, memory):
    """Return the robot that plans next: those on the way first; -1 if all have."""
    best, robot = 4, -1
    for i in range(decided.shape[0]):
        rank = 2
        if memory.inside[e, i]:
            rank = 0
        elif memory.entry[e, i] < 0:
            rank = 1
        elif memory.mode[e, i] == WAIT:
            rank = 3
        if not decided[i] and rank < best:
            best, robot = rank, i
    return robot


@function
def _weigh(e, i, pose, at_goal, mouths, memory):
    """Return how robot `i` weighs others."""
    people, gap, entry = _PEOPLE, _GAP, memory.entry[e, i]
    passes = entry >= 0 and memory.mode[e, i] != WAIT
    if passes and (memory.inside[e, i] or distance_to(mouths, entry, pose[0], pose[1]) < CLAIM):
        people = _PEOPLE_INSIDE
    if memory.stuck[e, i] > _STUCK:
        people, gap = min(people, _PEOPLE_INSIDE), _STUCK_GAP
    return Weights(people, _ROBOTS, gap, not at_goal and memory.mode[e, i] != WAIT)


@function
def _count_standstill(e, i, pose, at_goal, memory):
    """Count the steps for which robot `i` could not drive on."""
    if at_goal and math.hypot(pose[2], pose[3]) < 0.1:
        memory.stuck[e, i] += 1
    else:
        memory.stuck[e, i] = max(memory.stuck[e, i] - 2, 0)
