"""How a team drives by the right of way: what robots believe of each other, and their paths."""

from __future__ import annotations

import math

import numpy as np

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
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.kernels import function, kernel, separate
from mrsan.kernels.team import MACRO_ACTION, PRIORITY, THROUGH
from mrsan.kernels.walls import WALL_ROWS, is_clear
from mrsan.se2 import rotate, transform
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
    distance_from_way,
    distance_to,
    is_parked,
    look_ahead,
    mouths_of_world,
    number_of_mode,
    update_mode,
)
from samarl.planning.velocity_control import track_rotated_velocity

_POINTS = 128  # of a path
_APPROACH = 0.45  # m, of the points before and behind a passage through which robots drive
_NEAR_WALL = 4.5  # m, farther than a rollout leads
_AT_GOAL, _AT_PLACE = 0.12, 0.25  # m, distances at which robots stop
_ALONE = 1.0  # m, surface distance from which on nobody disturbs a robot that stands
_STUCK = 10  # steps, after which a robot comes closer to people
_PREDICTED = 3  # steps for which team-mates who share no plans move
_ROUND, _CLEAR = 0.12, 0.06  # m, at which paths lead round them, and that paths keep from them


@kernel
def perceive(
    first,
    last,
    ego,
    robots,
    robots_visible,
    messages,
    messages_received,
    priority,
    place,
    walls,
    corners,
    distance,
    all_mouths,
    first_mouth,
    memory,
    central,
    p,
):
    """Update where robots are, what they believe of each other, and which passages they come to.

    Args:
        first: first world to work on.
        last: the one after the last.
        ego: [E, N, 11], and so on: what robots observe.
        robots: likewise.
        robots_visible: likewise.
        messages: [E, N, N - 1, 7], `mrsan.sensors.team.MESSAGE_FEATURES`.
        messages_received: [E, N, N - 1] bool.
        priority: [E, N, 1] their own priorities.
        place: [E, 9], and so on: the map that robots know.
        walls: likewise.
        corners: likewise.
        distance: likewise.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`, updated.
        central: whether robots know the truth of each other.
        p: the scenario's parameters.
    """
    path, cost = np.zeros((_POINTS, 2)), np.zeros(corners.shape[2], np.float32)
    for e in range(first, last):
        known_map = walls[e], place[e], corners[e], distance[e]
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        for i in range(ego.shape[1]):
            _write_pose(ego[e, i], memory.pose[e, i], memory.goal[e, i])
            from_goal = _length(memory.goal[e, i], memory.pose[e, i])
            memory.arrived[e, i] = from_goal < p.robot_radius
        _believe(
            e,
            ego,
            robots,
            robots_visible,
            messages,
            messages_received,
            priority,
            mouths,
            memory,
            central,
            p.time_step,
        )
        for i in range(ego.shape[1]):
            look_ahead(e, i, mouths, memory, known_map, cost, path)


@kernel
def drive(
    first,
    last,
    ego,
    humans,
    humans_visible,
    place,
    walls,
    corners,
    distance,
    all_mouths,
    first_mouth,
    memory,
    settings,
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
        place: [E, 9], and so on: the map that robots know.
        walls: likewise.
        corners: likewise.
        distance: likewise.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`, updated.
        settings: `Settings`.
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
        np.zeros((_POINTS, 2)),
        np.zeros(_POINTS),
        np.zeros(corners.shape[2], np.float32),
    )
    near = np.zeros((WALL_ROWS, walls.shape[2] + 1), np.float32)
    actions = action.shape[2]
    scratch = (
        np.zeros(actions, np.float32),
        np.zeros(actions, np.float32),
        np.zeros((STEPS + 1, 2)),
    )
    for e in range(first, last):
        known_map = walls[e], place[e], corners[e], distance[e]
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        pose, goal = memory.pose[e], memory.goal[e]
        for i in range(n):
            update_mode(e, i, mouths, memory, known_map, p.robot_radius, settings.central)
        present[:] = False
        if settings.central:
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
            if settings.central:
                others = Others(plans, plan_stops, counts, people, present)
            else:
                _expect(e, i, memory, p.time_step, expected, stops, counts)
                _brake(pose[i], p.time_step, stops[i])
                present[:] = False
                _see(ego[e, i], pose[i], humans[e, i], humans_visible[e, i], people, present)
                others = Others(expected, stops, counts, people, present)
            length = _write_path(e, i, pose[i], goal[i], mouths, memory, known_map, cost, path)
            at_goal = _length(path[length - 1], goal[i]) < 1e-6
            decided[i] = True
            if not at_goal and _stands(i, pose, path[length - 1], others, p):
                track_rotated_velocity(
                    pose[i, 2], pose[i, 3], pose[i, 4], 0.0, 0.0, action[e, i], p, np.float32(0.0)
                )
                memory.stuck[e, i] = max(memory.stuck[e, i] - 2, 0)
                continue
            tolerance = _AT_GOAL if at_goal else _AT_PLACE
            columns, room = near_walls_of(
                walls[e], place[e], pose[i, 0], pose[i, 1], _NEAR_WALL, near
            )
            length = _go_round(e, i, pose[i], mouths, memory, near, columns, p, path, length)
            write_rest(path, length, rest)
            weights = _weigh(e, i, pose[i], at_goal, mouths, memory, settings)
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
    place,
    walls,
    corners,
    distance,
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
        place: [E, 9], and so on: the map that robots know.
        walls: likewise.
        corners: likewise.
        distance: likewise.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`, updated.
        central: whether robots know the truth of each other.
        p: the scenario's parameters.
        target: [E, N, 2] their goals or their queue places in the world frame, written, m.
        following: [E, N, 2] the next point of the way there, written, m.
    """
    path, cost = np.zeros((_POINTS, 2)), np.zeros(corners.shape[2], np.float32)
    for e in range(first, last):
        known_map = walls[e], place[e], corners[e], distance[e]
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        pose, goal = memory.pose[e], memory.goal[e]
        for i in range(pose.shape[0]):
            update_mode(e, i, mouths, memory, known_map, p.robot_radius, central)
        for i in range(pose.shape[0]):
            to = goal[i]
            if memory.queued[e, i] >= 0 or memory.yields[e, i] > 0:
                to = memory.place[e, i]
            x, y = pose[i, 0], pose[i, 1]
            write_route(*known_map, x, y, to[0], to[1], cost, path, 0)
            target[e, i, 0], target[e, i, 1] = to[0], to[1]
            following[e, i, 0], following[e, i, 1] = path[0, 0], path[0, 1]
            _count_standstill(e, i, pose[i], _length(to, goal[i]) < 1e-6, memory)
            memory.macro_action[e, i] = number_of_mode(e, i, mouths, memory)


@function
def _length(a, b):
    return math.hypot(a[0] - b[0], a[1] - b[1])


@function
def _write_pose(ego, pose, goal):
    """Write a robot's pose [5] and goal [2] in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    x, y = rotate(cos, sin, ego[ORIGIN_X], ego[ORIGIN_Y])
    pose[0], pose[1] = -x, -y
    pose[2], pose[3] = rotate(cos, sin, ego[VELOCITY_X], ego[VELOCITY_Y])
    pose[4] = math.atan2(sin, cos)
    goal[0], goal[1] = transform(cos, sin, -x, -y, ego[GOAL_X], ego[GOAL_Y])


@function
def _write_track(ego, pose, track, out):
    """Write an observed agent's position and velocity [4] in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    out[0], out[1] = transform(cos, sin, pose[0], pose[1], track[OTHER_X], track[OTHER_Y])
    vx, vy = track[OTHER_VELOCITY_X], track[OTHER_VELOCITY_Y]
    out[2], out[3] = transform(cos, sin, pose[2], pose[3], vx, vy)


@function
def _see(ego, pose, humans, visible, people, present):
    """Add the people that a robot sees."""
    for j in range(visible.shape[0]):
        if visible[j]:
            _write_track(ego, pose, humans[j], people[j])
            people[j, 4], present[j] = humans[j, OTHER_RADIUS], True


@function
def _stands(i, pose, place, others, p):
    """Return whether robot `i` stands at its place, with nobody near."""
    x, y = pose[i, 0], pose[i, 1]
    stands = math.hypot(pose[i, 2], pose[i, 3]) < 0.01 and _length(place, pose[i]) < _AT_PLACE
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
def _believe(
    e,
    ego,
    robots,
    robots_visible,
    messages,
    received,
    priority,
    mouths,
    memory,
    central,
    dt,
):
    """Update what the robots believe of each other: the truth, messages, or what they see."""
    n, pose = ego.shape[1], memory.pose[e]
    for i in range(n):
        memory.belief[e, i, i, PRIORITY] = priority[e, i, 0]
        for j in range(n):
            if i == j:
                continue
            slot = j - (j > i)
            out = memory.belief[e, i, j]
            if central:
                memory.known[e, i, j] = True
                for f in range(4):
                    out[f] = pose[j, f]
                out[THROUGH] = 1.0 if memory.arrived[e, j] else 0.0
                out[MACRO_ACTION] = number_of_mode(e, j, mouths, memory)
            elif slot < received.shape[2] and received[e, i, slot]:
                memory.known[e, i, j] = True
                _write_track(ego[e, i], pose[i], messages[e, i, slot], out)
                for f in range(PRIORITY, MACRO_ACTION + 1):
                    out[f] = messages[e, i, slot, f]
            elif robots_visible[e, i, slot]:
                if not memory.known[e, i, j]:
                    out[PRIORITY], out[THROUGH], out[MACRO_ACTION] = 0.0, 1.0, 0.0
                memory.known[e, i, j] = True
                _write_track(ego[e, i], pose[i], robots[e, i, slot], out)
            elif memory.known[e, i, j]:
                out[0] += out[2] * dt
                out[1] += out[3] * dt


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


@separate
def _write_path(e, i, pose, goal, mouths, memory, known_map, cost, path):
    """Write the path of robot `i`; return the number of its points."""
    walls, place, corners, distance = known_map
    x, y, to_x, to_y = pose[0], pose[1], goal[0], goal[1]
    gives_way = memory.yields[e, i] > 0
    if memory.queued[e, i] >= 0 or gives_way:
        to_x, to_y = memory.place[e, i, 0], memory.place[e, i, 1]
    entry, leave, count = memory.entry[e, i], memory.exit[e, i], 0
    if entry >= 0 and leave >= 0 and memory.mode[e, i] != WAIT and not gives_way:
        for k in (entry, leave):
            if k == entry and memory.inside[e, i]:
                continue
            by_x = mouths.position[k, 0] + _APPROACH * mouths.outward[k, 0]
            by_y = mouths.position[k, 1] + _APPROACH * mouths.outward[k, 1]
            count = write_route(
                walls, place, corners, distance, x, y, by_x, by_y, cost, path, count
            )
            x, y = by_x, by_y
    return write_route(walls, place, corners, distance, x, y, to_x, to_y, cost, path, count)


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
def _weigh(e, i, pose, at_goal, mouths, memory, settings):
    """Return how robot `i` weighs others."""
    people, gap, entry = settings.people, settings.gap, memory.entry[e, i]
    passes = entry >= 0 and memory.mode[e, i] != WAIT
    if passes and (memory.inside[e, i] or distance_to(mouths, entry, pose[0], pose[1]) < CLAIM):
        people = settings.people_inside
    if memory.stuck[e, i] > _STUCK:
        people, gap = min(people, settings.people_inside), settings.stuck_gap
    return Weights(people, settings.robots, gap, not at_goal and memory.mode[e, i] != WAIT)


@function
def _count_standstill(e, i, pose, at_goal, memory):
    """Count the steps for which robot `i` could not drive on."""
    if at_goal and math.hypot(pose[2], pose[3]) < 0.1:
        memory.stuck[e, i] += 1
    else:
        memory.stuck[e, i] = max(memory.stuck[e, i] - 2, 0)
