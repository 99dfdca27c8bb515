"""Right of way: who may pass a door or corridor now, and where the others wait.

One direction at a time: a robot goes if nobody is on the way through in the other direction, and if
it is the first of those who wait or follows somebody through. The others queue beside the mouth. A
robot whose goal blocks a mouth waits beside it until everybody who needs the passage is through.

Everything is in the world frame. Each robot decides on what it believes of its team-mates: what
they told, or, if `central`, the truth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

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

DRIVE, WAIT, GO, HOLD = range(4)  # macro actions; WAIT and GO with the mouth where a robot enters
MODES = 4

_POINTS = 128  # of a path
_APPROACH = 0.45  # m, of the points before and behind a passage through which robots drive
_NEAR_WALL = 4.5  # m, farther than a rollout leads
_AT_GOAL, _AT_PLACE = 0.12, 0.25  # m, distances at which robots stop
_CLAIM = 2.5  # m, from the mouth, besides the length of the passage
_FOLLOW = 1.5  # m, before the mouth, from where on the next one may follow
_RELEASE = 1.0  # m, before the end of the passage, from where on robots no longer hold up others
_BEFORE, _BEYOND, _ASIDE = 0.3, 0.75, 0.3  # m, where a passage is entered and left
_BLOCKED, _BLOCKED_ASIDE = 1.5, 0.65  # m, before and beside a mouth, where parked robots block it
_STUCK = 10  # steps, after which a robot comes closer to people
_PREDICTED = 3  # steps for which team-mates who share no plans move
_GOAL_ASIDE = 0.6  # m, from its goal, at which a robot must pass it to its place
_TAKEN = 0.7  # m, from a parked robot, within which a place is not free
_PARKED = 0.05  # m/s, below which team-mates who do not go count as parked
_ROUND, _CLEAR = 0.12, 0.06  # m, at which paths lead round them, and that paths keep from them
_FAR = 1e9


class Mouths(NamedTuple):
    """The mouths of the passages of all worlds, those of world e from `first[e]` on."""

    first: np.ndarray  # [E + 1]
    position: np.ndarray  # [K, 2] m
    outward: np.ndarray  # [K, 2]
    width: np.ndarray  # [K] m
    passage: np.ndarray  # [K] its number in the world
    length: np.ndarray  # [K] of its passage, m
    first_place: np.ndarray  # [K + 1]
    places: np.ndarray  # [Q, 2] queue places, m


class Memory(NamedTuple):
    """What robots do and believe."""

    is_new: np.ndarray  # [E, N] bool, its way has to be examined
    mode: np.ndarray  # [E, N]
    entry: np.ndarray  # [E, N] mouth at which it enters its next passage; -1: there is none
    exit: np.ndarray  # [E, N] mouth at which it leaves it; -1: its goal is inside
    inside: np.ndarray  # [E, N] bool
    ahead: np.ndarray  # [E, N] passages on the rest of its route, as bits
    queued: np.ndarray  # [E, N] mouth beside which it has a place; -1: none
    place: np.ndarray  # [E, N, 2] m
    stuck: np.ndarray  # [E, N] steps
    told: np.ndarray  # [E, N] what they tell, see `_own_words`
    known: np.ndarray  # [E, N, N] bool, whether robot i has heard of robot j
    belief: np.ndarray  # [E, N, N, 7] what it believes: MESSAGE_FEATURES in the world frame


class Settings(NamedTuple):
    """Numbers of the planner."""

    central: bool
    people: float  # cost per metre of a discomfort
    people_inside: float  # the same on the way through a passage
    robots: float
    gap: float  # m, kept from people in the next step if possible
    stuck_gap: float  # m, the same of robots that have stood for long


@kernel
def act(
    first,
    last,
    ego,
    humans,
    humans_visible,
    robots,
    robots_visible,
    messages,
    messages_received,
    priority,
    place,
    walls,
    corners,
    distance,
    mouths,
    memory,
    settings,
    p,
    action,
):
    """Write the actions of all robots [E, N, A], and update their memory.

    Args:
        first: first world to work on.
        last: the one after the last.
        ego: [E, N, 11], and so on: what robots observe.
        humans: likewise.
        humans_visible: likewise.
        robots: likewise.
        robots_visible: likewise.
        messages: [E, N, N - 1, 7], `mrsan.sensors.team.MESSAGE_FEATURES`.
        messages_received: [E, N, N - 1] bool.
        priority: [E, N, 1] their own priorities.
        place: [E, 9], and so on: the map that robots know.
        walls: likewise.
        corners: likewise.
        distance: likewise.
        mouths: `Mouths`.
        memory: `Memory`, updated.
        settings: `Settings`.
        p: the scenario's parameters.
        action: [E, N, A], written.
    """
    n, m = ego.shape[1], humans.shape[2]
    pose, goal = np.zeros((n, 5)), np.zeros((n, 2))
    arrived, decided = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
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
    scratch = np.zeros(action.shape[2], np.float32), np.zeros((STEPS + 1, 2))
    for e in range(first, last):
        for i in range(n):
            _write_pose(ego[e, i], pose[i], goal[i])
            arrived[i] = _length(goal[i], pose[i]) < p.robot_radius
        _believe(
            e,
            ego,
            pose,
            arrived,
            robots,
            robots_visible,
            messages,
            messages_received,
            priority,
            mouths,
            memory,
            settings.central,
            p.time_step,
        )
        known_map = walls[e], place[e], corners[e], distance[e]
        for i in range(n):
            _update_mode(e, i, pose, goal, arrived, mouths, memory, known_map, settings, cost, path)
        present[:] = False
        if settings.central:
            for i in range(n):
                _see(ego[e, i], pose[i], humans[e, i], humans_visible[e, i], people, present)
        for i in range(n):
            decided[i] = arrived[i]
            _brake(pose[i], p.time_step, plan_stops[i])
            for t in range(STEPS + 1):
                plans[i, t, 0], plans[i, t, 1] = plan_stops[i, 0], plan_stops[i, 1]
            plans[i, 0, 0], plans[i, 0, 1] = pose[i, 0], pose[i, 1]
            action[e, i, :] = 0.0
        for _ in range(n):
            i = _next_to_plan(e, pose, decided, memory)
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
            tolerance = _AT_GOAL if at_goal else _AT_PLACE
            columns = near_walls_of(walls[e], place[e], pose[i, 0], pose[i, 1], _NEAR_WALL, near)
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
                others,
                weights,
                p,
                scratch,
                action[e, i],
                plans[i],
            )
            decided[i] = True
            plan_stops[i, 0] = 1.5 * plans[i, 1, 0] - 0.5 * plans[i, 0, 0]
            plan_stops[i, 1] = 1.5 * plans[i, 1, 1] - 0.5 * plans[i, 0, 1]
            _count_standstill(e, i, pose[i], at_goal, memory)
        for i in range(n):
            memory.told[e, i] = _own_words(e, i, mouths, memory)


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
def _brake(pose, dt, out):
    """Write where a robot stands that brakes now."""
    out[0], out[1] = pose[0] + 0.5 * dt * pose[2], pose[1] + 0.5 * dt * pose[3]


@function
def _believe(
    e,
    ego,
    pose,
    arrived,
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
    n = pose.shape[0]
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
                out[THROUGH] = 1.0 if arrived[j] else 0.0
                out[MACRO_ACTION] = _own_words(e, j, mouths, memory)
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


@function
def _ahead(mouths, k, x, y):
    """Return how far (x, y) is before mouth `k`, m; negative inside."""
    dx, dy = x - mouths.position[k, 0], y - mouths.position[k, 1]
    return dx * mouths.outward[k, 0] + dy * mouths.outward[k, 1]


@function
def _aside(mouths, k, x, y):
    """Return how far (x, y) is beside the axis of mouth `k`, m."""
    dx, dy = x - mouths.position[k, 0], y - mouths.position[k, 1]
    return abs(dy * mouths.outward[k, 0] - dx * mouths.outward[k, 1])


@function
def _is_blocked(mouths, k, x, y):
    """Return whether a robot parked at (x, y) blocks mouth `k`."""
    ahead = _ahead(mouths, k, x, y)
    return -0.1 <= ahead < _BLOCKED and _aside(mouths, k, x, y) < (
        0.5 * mouths.width[k] + _BLOCKED_ASIDE
    )


@function
def _crossing(mouths, k, ax, ay, bx, by):
    """Return at which share of the way from a to b it crosses mouth `k`, outwards or inwards.

    Returns the share, above 1 if it does not, and whether it leads outwards.
    """
    before, after = _ahead(mouths, k, ax, ay), _ahead(mouths, k, bx, by)
    if before * after > 0.0 or before == after:
        return 2.0, False
    share = before / (before - after)
    x, y = ax + share * (bx - ax), ay + share * (by - ay)
    if _aside(mouths, k, x, y) > 0.5 * mouths.width[k]:
        return 2.0, False
    return share, after > before


@separate
def _examine_way(e, i, pose, goal, mouths, memory, known_map, cost, path):
    """Find the passages on the route of robot `i`: those ahead, and where it enters the next."""
    walls, place, corners, distance = known_map
    count = write_route(
        walls, place, corners, distance, pose[0], pose[1], goal[0], goal[1], cost, path, 0
    )
    memory.is_new[e, i], memory.inside[e, i] = False, False
    memory.entry[e, i] = memory.exit[e, i] = memory.queued[e, i] = -1
    memory.ahead[e, i], memory.mode[e, i] = 0, DRIVE
    first, last = mouths.first[e], mouths.first[e + 1]
    enters, leaves, entry, leave = _FAR, _FAR, -1, -1
    for s in range(count):
        ax, ay = (path[s - 1, 0], path[s - 1, 1]) if s > 0 else (pose[0], pose[1])
        for k in range(first, last):
            share, outwards = _crossing(mouths, k, ax, ay, path[s, 0], path[s, 1])
            if share > 1.0:
                continue
            memory.ahead[e, i] |= 1 << min(mouths.passage[k], 62)
            if outwards and s + share < leaves:
                leaves, leave = s + share, k
            elif not outwards and s + share < enters:
                enters, entry = s + share, k
    if leave >= 0 and leaves < enters - 1e-6:  # it begins inside
        for k in range(first, last):
            if k != leave and mouths.passage[k] == mouths.passage[leave]:
                memory.entry[e, i] = k
        memory.exit[e, i] = leave
        if memory.entry[e, i] >= 0:
            memory.inside[e, i], memory.mode[e, i] = True, GO
        return
    if entry < 0:
        return
    memory.entry[e, i] = entry
    leaves = _FAR
    for s in range(count):
        ax, ay = (path[s - 1, 0], path[s - 1, 1]) if s > 0 else (pose[0], pose[1])
        for k in range(first, last):
            if k == entry or mouths.passage[k] != mouths.passage[entry]:
                continue
            share, outwards = _crossing(mouths, k, ax, ay, path[s, 0], path[s, 1])
            if share <= 1.0 and outwards and enters - 1e-6 <= s + share < leaves:
                leaves = s + share
                memory.exit[e, i] = k


@separate
def _update_mode(e, i, pose, goal, arrived, mouths, memory, known_map, settings, cost, path):
    """Decide what robot `i` does: drive, wait, go or hold off its goal."""
    if memory.is_new[e, i]:
        _examine_way(e, i, pose[i], goal[i], mouths, memory, known_map, cost, path)
    if arrived[i]:
        memory.mode[e, i], memory.entry[e, i], memory.queued[e, i] = DRIVE, -1, -1
        memory.ahead[e, i], memory.inside[e, i] = 0, False
    elif memory.entry[e, i] >= 0:
        _pass(e, i, pose[i], goal[i], mouths, memory, known_map, cost, path)
    if not arrived[i]:
        if memory.entry[e, i] < 0:
            k = _held_off(e, i, goal[i], mouths, memory, settings.central)
            memory.mode[e, i] = HOLD if k >= 0 else DRIVE
            _queue(e, i, k, pose, goal, arrived, mouths, memory, settings.central)
        elif not memory.inside[e, i]:
            memory.mode[e, i] = _mode_before(e, i, pose[i], mouths, memory, settings.central)
        if memory.entry[e, i] >= 0:
            k = memory.entry[e, i] if memory.mode[e, i] == WAIT else -1
            if k < 0 and memory.ahead[e, i] & (memory.ahead[e, i] - 1) == 0:  # the last passage
                k = _held_off(e, i, goal[i], mouths, memory, settings.central)
            _queue(e, i, k, pose, goal, arrived, mouths, memory, settings.central)
    if settings.central:  # the next ones to decide know
        for j in range(pose.shape[0]):
            memory.belief[e, j, i, MACRO_ACTION] = _own_words(e, i, mouths, memory)


@function
def _pass(e, i, pose, goal, mouths, memory, known_map, cost, path):
    """Note that robot `i` has entered its passage, or has left it."""
    entry, leave = memory.entry[e, i], memory.exit[e, i]
    enters = _ahead(mouths, entry, pose[0], pose[1]) < _BEFORE
    enters &= _aside(mouths, entry, pose[0], pose[1]) < 0.5 * mouths.width[entry] + 0.1
    memory.inside[e, i] |= enters and memory.mode[e, i] == GO
    if memory.inside[e, i] and leave >= 0:
        ahead = _ahead(mouths, leave, pose[0], pose[1])
        aside = _aside(mouths, leave, pose[0], pose[1])
        if ahead > _BEYOND or (ahead > 0.2 and aside > 0.5 * mouths.width[leave] + _ASIDE):
            _examine_way(e, i, pose, goal, mouths, memory, known_map, cost, path)


@function
def _told(mouths, memory, e, i, j):
    """Return the mode and the mouth (-1: none) of robot `j`, as robot `i` believes."""
    told = int(memory.belief[e, i, j, MACRO_ACTION])
    mouth = mouths.first[e] + told // MODES - 1
    if told < MODES or mouth >= mouths.first[e + 1]:
        return told % MODES, -1
    return told % MODES, mouth


@function
def _own_words(e, i, mouths, memory):
    """Return what robot `i` tells: its mode and 4 times one more than its mouth in the world."""
    entry = memory.entry[e, i]
    return memory.mode[e, i] + MODES * (entry - mouths.first[e] + 1 if entry >= 0 else 0)


@function
def _to_mouth(mouths, k, x, y):
    return math.hypot(x - mouths.position[k, 0], y - mouths.position[k, 1])


@function
def _goes_before(e, i, j, own, other, mouth, mouths, memory, central):
    """Return whether robot `j` goes before robot `i`, which is at a distance `own` of its mouth."""
    if central:  # the nearest first
        distance = _to_mouth(mouths, mouth, other[0], other[1])
        return distance < own or (distance == own and j < i)
    return other[PRIORITY] > memory.belief[e, i, i, PRIORITY]


@separate
def _mode_before(e, i, pose, mouths, memory, central):
    """Return whether robot `i` before its next passage waits, goes, or need not decide yet."""
    entry, mode_now = memory.entry[e, i], memory.mode[e, i]
    own = _to_mouth(mouths, entry, pose[0], pose[1])
    if mode_now == DRIVE and own > _CLAIM + mouths.length[entry]:
        return DRIVE
    follows = False
    for j in range(memory.known.shape[1]):
        if j == i or not memory.known[e, i, j]:
            continue
        mode, mouth = _told(mouths, memory, e, i, j)
        if mode != GO or mouth < 0 or mouths.passage[mouth] != mouths.passage[entry]:
            continue
        other = memory.belief[e, i, j]
        before = _ahead(mouths, mouth, other[0], other[1])
        if mouth == entry:
            follows = True
            if mode_now != GO and before > _FOLLOW:
                return WAIT
        elif central and before < 0.0 and _ahead(mouths, entry, other[0], other[1]) > -_RELEASE:
            continue  # it is about to come out
        elif mode_now != GO or before < _BEFORE:
            return WAIT
        elif _goes_before(e, i, j, own, other, mouth, mouths, memory, central):
            return WAIT  # both have set off at the same moment
    if mode_now == GO:
        return GO
    for j in range(memory.known.shape[1]):
        if j == i or not memory.known[e, i, j]:
            continue
        mode, mouth = _told(mouths, memory, e, i, j)
        if mode != WAIT or mouth < 0 or mouths.passage[mouth] != mouths.passage[entry]:
            continue
        if follows and mouth != entry:
            continue
        other = memory.belief[e, i, j]
        if _goes_before(e, i, j, own, other, mouth, mouths, memory, central):
            return WAIT
    return GO


@separate
def _held_off(e, i, goal, mouths, memory, central):
    """Return the mouth that robot `i` would block at its goal while others need it, or -1."""
    for k in range(mouths.first[e], mouths.first[e + 1]):
        if not _is_blocked(mouths, k, goal[0], goal[1]):
            continue
        for j in range(memory.known.shape[1]):
            if j == i or not memory.known[e, i, j]:
                continue
            if central:
                if memory.ahead[e, j] >> min(mouths.passage[k], 62) & 1:
                    return k
            elif (
                memory.belief[e, i, j, THROUGH] < 0.5 and _told(mouths, memory, e, i, j)[0] != HOLD
            ):
                return k
    return -1


@function
def _is_parked(e, i, j, mouths, memory):
    """Return whether robot `i` believes that robot `j` stands where it is."""
    if j == i or not memory.known[e, i, j]:
        return False
    other = memory.belief[e, i, j]
    return math.hypot(other[2], other[3]) < _PARKED and _told(mouths, memory, e, i, j)[0] != GO


@separate
def _queue(e, i, k, pose, goal, arrived, mouths, memory, central):
    """Choose a place for robot `i` beside mouth `k`, unless it has a free one; -1: none."""
    is_free = True
    for j in range(memory.known.shape[1]):
        if _is_parked(e, i, j, mouths, memory):
            other, own = memory.belief[e, i, j], memory.place[e, i]
            is_free &= math.hypot(other[0] - own[0], other[1] - own[1]) > _TAKEN
    if k < 0 or (memory.queued[e, i] == k and is_free):
        memory.queued[e, i] = k
        return
    memory.queued[e, i] = k
    best = np.inf
    memory.place[e, i, 0], memory.place[e, i, 1] = pose[i, 0], pose[i, 1]
    mouth_x, mouth_y = mouths.position[k, 0], mouths.position[k, 1]
    for q in range(mouths.first_place[k], mouths.first_place[k + 1]):
        x, y = mouths.places[q, 0], mouths.places[q, 1]
        cost = 0.6 * math.hypot(x - pose[i, 0], y - pose[i, 1])
        cost += math.hypot(x - mouth_x, y - mouth_y)
        if _ahead(mouths, k, goal[i, 0], goal[i, 1]) > 0.0:  # it must not arrive on its way
            gap = _from_way(goal[i, 0], goal[i, 1], mouth_x, mouth_y, x, y)
            cost += 20.0 * max(0.9 - gap, 0.0) + (100.0 if gap < _GOAL_ASIDE else 0.0)
        for j in range(memory.known.shape[1]):
            if j == i or not memory.known[e, i, j]:
                continue
            other = memory.belief[e, i, j]
            if central and not arrived[j]:
                cost += 40.0 * max(1.1 - math.hypot(x - goal[j, 0], y - goal[j, 1]), 0.0)
                if _ahead(mouths, k, goal[j, 0], goal[j, 1]) > 0.0:
                    gap = _from_way(x, y, mouth_x, mouth_y, goal[j, 0], goal[j, 1])
                    cost += 20.0 * max(0.9 - gap, 0.0)
                if memory.queued[e, j] >= 0:
                    place = memory.place[e, j]
                    cost += 40.0 * max(1.0 - math.hypot(x - place[0], y - place[1]), 0.0)
            else:
                speed = math.hypot(other[2], other[3])
                if speed < 0.1:
                    cost += 40.0 * max(1.0 - math.hypot(x - other[0], y - other[1]), 0.0)
        if cost < best:
            best = cost
            memory.place[e, i, 0], memory.place[e, i, 1] = x, y


@function
def _from_way(x, y, ax, ay, bx, by):
    """Return the distance of (x, y) from the way from a to b, m."""
    dx, dy = bx - ax, by - ay
    share = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-9)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(x - ax - share * dx, y - ay - share * dy)


@separate
def _write_path(e, i, pose, goal, mouths, memory, known_map, cost, path):
    """Write the path of robot `i`; return the number of its points."""
    walls, place, corners, distance = known_map
    x, y, to_x, to_y = pose[0], pose[1], goal[0], goal[1]
    if memory.queued[e, i] >= 0:
        to_x, to_y = memory.place[e, i, 0], memory.place[e, i, 1]
    entry, leave, count = memory.entry[e, i], memory.exit[e, i], 0
    if entry >= 0 and leave >= 0 and memory.mode[e, i] != WAIT:
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
            if not _is_parked(e, i, j, mouths, memory):
                continue
            x, y = memory.belief[e, i, j, 0], memory.belief[e, i, j, 1]
            if math.hypot(x - pose[0], y - pose[1]) > _NEAR_WALL - 1.5:
                continue
            if min(math.hypot(x - ax, y - ay), math.hypot(x - bx, y - by)) < least:
                continue
            if _from_way(x, y, ax, ay, bx, by) >= least:
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
        if _is_parked(e, i, j, mouths, memory):
            other = memory.belief[e, i, j]
            if math.hypot(x - other[0], y - other[1]) < 2.0 * p.robot_radius + 0.04:
                return False
    return True


@function
def _next_to_plan(e, pose, decided, memory):
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
    if passes and (memory.inside[e, i] or _to_mouth(mouths, entry, pose[0], pose[1]) < _CLAIM):
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
