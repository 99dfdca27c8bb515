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

from mrsan.kernels import function, separate
from mrsan.kernels.passages import ahead_of, aside_of, crossing, distance_from_way
from mrsan.kernels.team import MACRO_ACTION, PRIORITY, THROUGH
from mrsan.kernels.walls import is_clear, wall_count
from mrsan.passages import BLOCKED_LENGTH, BLOCKED_MARGIN
from samarl.planning.path_rollouts import write_route

DRIVE, WAIT, GO, HOLD = range(4)  # macro actions; WAIT and GO with the mouth where a robot enters
MODES = 4
CLAIM = 2.5  # m, from the mouth, besides the length of the passage
BY_RULE, QUEUE, ENTER = range(-1, 2)  # choices before a passage
STUCK = 8  # steps, after which a learned choice may turn a robot back that is inside

_FACE_TO_FACE = 1.6  # m, from a team-mate at which a robot that is stuck gives way
_YIELD_STEPS = 16  # for which it does
_YIELD_DISTANCES = (0.7, 1.1, 1.5)  # m, of the places to which it may move
_YIELD_DIRECTIONS = 16
_CHOICE_STEPS = 16  # after which a choice ends at the latest

_FOLLOW = 1.5  # m, before the mouth, from where on the next one may follow
_RELEASE = 1.0  # m, before the end of the passage, from where on robots no longer hold up others
_BEFORE, _BEYOND, _ASIDE = 0.3, 0.75, 0.3  # m, where a passage is entered and left
_GOAL_ASIDE = 0.6  # m, from its goal, at which a robot must pass it to its place
_AT_PLACE = 0.3  # m, at which a robot has reached its queue place
_TAKEN = 0.7  # m, from a parked robot, within which a place is not free
_PARKED = 0.05  # m/s, below which team-mates who do not go count as parked
_FAR = 1e9


class Mouths(NamedTuple):
    """The mouths of the passages of a world, or of all worlds, one world after the other.

    Numbers of mouths and passages are those in their world.
    """

    position: np.ndarray  # [K, 2] m
    outward: np.ndarray  # [K, 2]
    width: np.ndarray  # [K] m
    passage: np.ndarray  # [K] its number in the world
    length: np.ndarray  # [K] of its passage, m
    first_place: np.ndarray  # [K] the first of its queue places ...
    last_place: np.ndarray  # [K] ... and the one after the last
    places: np.ndarray  # [Q, 2] queue places, m


class Memory(NamedTuple):
    """What robots do and believe."""

    pose: np.ndarray  # [E, N, 5] position, velocity and heading in the world frame
    goal: np.ndarray  # [E, N, 2] m
    arrived: np.ndarray  # [E, N] bool
    is_new: np.ndarray  # [E, N] bool, its way has to be examined
    mode: np.ndarray  # [E, N]
    entry: np.ndarray  # [E, N] mouth at which it enters its next passage; -1: there is none
    exit: np.ndarray  # [E, N] mouth at which it leaves it; -1: its goal is inside
    inside: np.ndarray  # [E, N] bool
    ahead: np.ndarray  # [E, N] passages on the rest of its route, as bits
    queued: np.ndarray  # [E, N] mouth beside which it has a place; -1: none
    place: np.ndarray  # [E, N, 2] m
    stuck: np.ndarray  # [E, N] steps
    yields: np.ndarray  # [E, N] steps for which it still lets a team-mate pass, at its place
    macro_action: np.ndarray  # [E, N] what they tell, see `number_of_mode`
    known: np.ndarray  # [E, N, N] bool, whether robot i has heard of robot j
    belief: np.ndarray  # [E, N, N, 7] what it believes: MESSAGE_FEATURES in the world frame
    choice: np.ndarray  # [E, N] BY_RULE, QUEUE or ENTER
    due: np.ndarray  # [E, N] bool, whether a new choice has to be made
    age: np.ndarray  # [E, N] steps since the last choice
    event: np.ndarray  # [E, N] number of the situation in which it was made; -1: there is none


@function
def map_of_world(known_maps, e):
    """Return the walls, the place, the corners and their distances of world `e`."""
    return (
        known_maps.walls[e],
        known_maps.place[e],
        known_maps.corners[e],
        known_maps.corner_distance[e],
    )


@function
def mouths_of_world(mouths, first_mouth, e):
    """Return the mouths of world `e`, which are those from `first_mouth[e]` on."""
    first, last = first_mouth[e], first_mouth[e + 1]
    return Mouths(
        mouths.position[first:last],
        mouths.outward[first:last],
        mouths.width[first:last],
        mouths.passage[first:last],
        mouths.length[first:last],
        mouths.first_place[first:last],
        mouths.last_place[first:last],
        mouths.places,
    )


@function
def is_blocked(mouths, k, x, y):
    """Return whether a robot parked at (x, y) blocks mouth `k`."""
    ahead = ahead_of(mouths, k, x, y)
    return -0.1 <= ahead < BLOCKED_LENGTH and aside_of(mouths, k, x, y) < (
        0.5 * mouths.width[k] + BLOCKED_MARGIN
    )


@separate
def _examine_way(e, i, mouths, memory, known_map, cost, path):
    """Find the passages on the route of robot `i`: those ahead, and where it enters the next."""
    pose, goal = memory.pose[e, i], memory.goal[e, i]
    count = write_route(*known_map, pose[0], pose[1], goal[0], goal[1], cost, path, 0)
    memory.is_new[e, i], memory.inside[e, i] = False, False
    memory.entry[e, i] = memory.exit[e, i] = memory.queued[e, i] = -1
    memory.ahead[e, i], memory.mode[e, i] = 0, DRIVE
    enters, leaves, entry, leave = _FAR, _FAR, -1, -1
    for s in range(count):
        ax, ay = (path[s - 1, 0], path[s - 1, 1]) if s > 0 else (pose[0], pose[1])
        for k in range(len(mouths.width)):
            share, outwards = crossing(mouths, k, ax, ay, path[s, 0], path[s, 1])
            if share > 1.0:
                continue
            memory.ahead[e, i] |= 1 << min(mouths.passage[k], 62)
            if outwards and s + share < leaves:
                leaves, leave = s + share, k
            elif not outwards and s + share < enters:
                enters, entry = s + share, k
    if leave >= 0 and leaves < enters - 1e-6:  # it begins inside
        for k in range(len(mouths.width)):
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
        for k in range(len(mouths.width)):
            if k == entry or mouths.passage[k] != mouths.passage[entry]:
                continue
            share, outwards = crossing(mouths, k, ax, ay, path[s, 0], path[s, 1])
            if share <= 1.0 and outwards and enters - 1e-6 <= s + share < leaves:
                leaves = s + share
                memory.exit[e, i] = k


@separate
def look_ahead(e, i, mouths, memory, known_map, cost, path):
    """Note which passage robot `i` comes to or is in, and whether a choice is due."""
    if memory.is_new[e, i]:
        _examine_way(e, i, mouths, memory, known_map, cost, path)
    if memory.arrived[e, i]:
        memory.mode[e, i], memory.entry[e, i], memory.queued[e, i] = DRIVE, -1, -1
        memory.ahead[e, i], memory.inside[e, i] = 0, False
    elif memory.entry[e, i] >= 0:
        _pass(e, i, mouths, memory, known_map, cost, path)
    memory.age[e, i] += 1
    event = _event(e, i, mouths, memory)
    due = event != memory.event[e, i] or memory.age[e, i] >= _CHOICE_STEPS
    memory.due[e, i] = event >= 0 and due
    memory.event[e, i] = event
    if memory.due[e, i]:
        memory.age[e, i] = 0


@separate
def update_mode(e, i, mouths, memory, known_map, radius, central):
    """Decide what robot `i` does: drive, wait, go or hold off its goal, or give way."""
    if not memory.arrived[e, i]:
        if memory.entry[e, i] < 0:
            k = _held_off(e, i, mouths, memory, central)
            memory.mode[e, i] = HOLD if k >= 0 else DRIVE
            _queue(e, i, k, mouths, memory, central)
        elif memory.choice[e, i] == BY_RULE:
            if not memory.inside[e, i]:
                memory.mode[e, i] = _mode_before(e, i, mouths, memory, central)
        elif memory.event[e, i] >= 0:
            memory.mode[e, i] = GO if memory.choice[e, i] == ENTER else WAIT
        if memory.entry[e, i] >= 0:
            k = memory.entry[e, i] if memory.mode[e, i] == WAIT else -1
            if k < 0 and memory.ahead[e, i] & (memory.ahead[e, i] - 1) == 0:  # the last passage
                k = _held_off(e, i, mouths, memory, central)
            _queue(e, i, k, mouths, memory, central)
        _give_way(e, i, memory, known_map, radius)
    if central:  # the next ones to decide know
        for j in range(memory.known.shape[1]):
            memory.belief[e, j, i, MACRO_ACTION] = number_of_mode(e, i, mouths, memory)


@function
def _give_way(e, i, memory, known_map, radius):
    """Let robot `i` move out of the way of a team-mate with which it is stuck face to face."""
    pose = memory.pose[e, i]
    if memory.queued[e, i] >= 0 or memory.mode[e, i] != DRIVE or memory.entry[e, i] >= 0:
        memory.yields[e, i] = 0
        return
    if memory.yields[e, i] > 0:
        memory.yields[e, i] -= 1
        return
    if memory.stuck[e, i] < STUCK:
        return
    nearest, facing = _FACE_TO_FACE, -1
    for j in range(memory.known.shape[1]):
        if j == i or not memory.known[e, i, j]:
            continue
        other = memory.belief[e, i, j]
        gap = math.hypot(other[0] - pose[0], other[1] - pose[1])
        if gap < nearest and other[PRIORITY] > memory.belief[e, i, i, PRIORITY]:
            nearest, facing = gap, j
    if facing < 0:
        return
    other = memory.belief[e, i, facing]
    ux, uy = (pose[0] - other[0]) / nearest, (pose[1] - other[1]) / nearest
    walls, place, _, _ = known_map
    best = -np.inf
    for d in range(_YIELD_DIRECTIONS):
        angle = 2.0 * math.pi * d / _YIELD_DIRECTIONS
        for distance in _YIELD_DISTANCES:
            dx, dy = distance * math.cos(angle), distance * math.sin(angle)
            along, aside = dx * ux + dy * uy, abs(dy * ux - dx * uy)
            gap = math.hypot(pose[0] + dx - other[0], pose[1] + dy - other[1])
            value = min(aside, 1.0) + 0.5 * along - 0.1 * distance
            if gap < nearest or value <= best:
                continue
            if not is_clear(walls, wall_count(place), pose[0], pose[1], dx, dy, radius + 0.05):
                continue
            best = value
            memory.place[e, i, 0], memory.place[e, i, 1] = pose[0] + dx, pose[1] + dy
    if best > -np.inf:
        memory.yields[e, i], memory.stuck[e, i] = _YIELD_STEPS, 0


@function
def _event(e, i, mouths, memory):
    """Return the number of the situation in which robot `i` has to choose; -1: it has not."""
    entry, pose = memory.entry[e, i], memory.pose[e, i]
    if entry < 0 or (
        memory.inside[e, i] and memory.stuck[e, i] < STUCK and memory.mode[e, i] != WAIT
    ):
        return -1
    own = distance_to(mouths, entry, pose[0], pose[1])
    if memory.mode[e, i] == DRIVE and own > CLAIM + mouths.length[entry]:
        return -1
    along = against = through = 0
    for j in range(memory.known.shape[1]):
        if j == i or not memory.known[e, i, j]:
            continue
        through += memory.belief[e, i, j, THROUGH] > 0.5
        mode, mouth = believed_mode(mouths, memory, e, i, j)
        if mode == GO and mouth >= 0 and mouths.passage[mouth] == mouths.passage[entry]:
            along += mouth == entry
            against += mouth != entry
    place = memory.place[e, i]
    from_place = math.hypot(pose[0] - place[0], pose[1] - place[1])
    waits = memory.mode[e, i] == WAIT and from_place < _AT_PLACE
    number = ((through * 64 + along) * 64 + against) * 8
    return number + 4 * waits + 2 * memory.inside[e, i] + (memory.stuck[e, i] >= STUCK)


@function
def _pass(e, i, mouths, memory, known_map, cost, path):
    """Note that robot `i` has entered its passage, or has left it."""
    pose, entry, leave = memory.pose[e, i], memory.entry[e, i], memory.exit[e, i]
    enters = ahead_of(mouths, entry, pose[0], pose[1]) < _BEFORE
    enters &= aside_of(mouths, entry, pose[0], pose[1]) < 0.5 * mouths.width[entry] + 0.1
    memory.inside[e, i] |= enters and memory.mode[e, i] == GO
    if memory.mode[e, i] == WAIT and ahead_of(mouths, entry, pose[0], pose[1]) > _BEFORE:
        memory.inside[e, i] = False  # it has turned back
    if memory.inside[e, i] and leave >= 0:
        ahead = ahead_of(mouths, leave, pose[0], pose[1])
        aside = aside_of(mouths, leave, pose[0], pose[1])
        if ahead > _BEYOND or (ahead > 0.2 and aside > 0.5 * mouths.width[leave] + _ASIDE):
            _examine_way(e, i, mouths, memory, known_map, cost, path)


@function
def believed_mode(mouths, memory, e, i, j):
    """Return the mode and the mouth (-1: none) of robot `j`, as robot `i` believes."""
    told = int(memory.belief[e, i, j, MACRO_ACTION])
    mouth = told // MODES - 1
    if told < MODES or mouth >= len(mouths.width):
        return told % MODES, -1
    return told % MODES, mouth


@function
def number_of_mode(e, i, mouths, memory):
    """Return what robot `i` tells: its mode and 4 times one more than its mouth in the world."""
    entry = memory.entry[e, i]
    return memory.mode[e, i] + MODES * (entry + 1 if entry >= 0 else 0)


@function
def distance_to(mouths, k, x, y):
    """Return the distance of (x, y) from mouth `k`, m."""
    return math.hypot(x - mouths.position[k, 0], y - mouths.position[k, 1])


@function
def _goes_before(e, i, j, own, other, mouth, mouths, memory, central):
    """Return whether robot `j` goes before robot `i`, which is at a distance `own` of its mouth."""
    if central:  # the nearest first
        distance = distance_to(mouths, mouth, other[0], other[1])
        return distance < own or (distance == own and j < i)
    return other[PRIORITY] > memory.belief[e, i, i, PRIORITY]


@separate
def _mode_before(e, i, mouths, memory, central):
    """Return whether robot `i` before its next passage waits, goes, or need not decide yet."""
    entry, mode_now, pose = memory.entry[e, i], memory.mode[e, i], memory.pose[e, i]
    own = distance_to(mouths, entry, pose[0], pose[1])
    if mode_now == DRIVE and own > CLAIM + mouths.length[entry]:
        return DRIVE
    follows = False
    for j in range(memory.known.shape[1]):
        if j == i or not memory.known[e, i, j]:
            continue
        mode, mouth = believed_mode(mouths, memory, e, i, j)
        if mode != GO or mouth < 0 or mouths.passage[mouth] != mouths.passage[entry]:
            continue
        other = memory.belief[e, i, j]
        before = ahead_of(mouths, mouth, other[0], other[1])
        if mouth == entry:
            follows = True
            if mode_now != GO and before > _FOLLOW:
                return WAIT
        elif central and before < 0.0 and ahead_of(mouths, entry, other[0], other[1]) > -_RELEASE:
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
        mode, mouth = believed_mode(mouths, memory, e, i, j)
        if mode != WAIT or mouth < 0 or mouths.passage[mouth] != mouths.passage[entry]:
            continue
        if follows and mouth != entry:
            continue
        other = memory.belief[e, i, j]
        if _goes_before(e, i, j, own, other, mouth, mouths, memory, central):
            return WAIT
    return GO


@separate
def _held_off(e, i, mouths, memory, central):
    """Return the mouth that robot `i` would block at its goal while others need it, or -1."""
    goal = memory.goal[e, i]
    for k in range(len(mouths.width)):
        if not is_blocked(mouths, k, goal[0], goal[1]):
            continue
        for j in range(memory.known.shape[1]):
            if j == i or not memory.known[e, i, j]:
                continue
            if central:
                needs = memory.ahead[e, j] >> min(mouths.passage[k], 62) & 1 == 1
            else:
                mode = believed_mode(mouths, memory, e, i, j)[0]
                needs = memory.belief[e, i, j, THROUGH] < 0.5 and mode != HOLD
            if needs:
                return k
    return -1


@function
def is_parked(e, i, j, mouths, memory):
    """Return whether robot `i` believes that robot `j` stands where it is."""
    if j == i or not memory.known[e, i, j]:
        return False
    other, mode = memory.belief[e, i, j], believed_mode(mouths, memory, e, i, j)[0]
    return math.hypot(other[2], other[3]) < _PARKED and mode != GO


@separate
def _queue(e, i, k, mouths, memory, central):
    """Choose a place for robot `i` beside mouth `k`, unless it has a free one; -1: none."""
    pose, goal, is_free = memory.pose[e, i], memory.goal[e, i], True
    for j in range(memory.known.shape[1]):
        if is_parked(e, i, j, mouths, memory):
            other, own = memory.belief[e, i, j], memory.place[e, i]
            is_free &= math.hypot(other[0] - own[0], other[1] - own[1]) > _TAKEN
    if k < 0 or (memory.queued[e, i] == k and is_free):
        memory.queued[e, i] = k
        return
    memory.queued[e, i] = k
    best = np.inf
    memory.place[e, i, 0], memory.place[e, i, 1] = pose[0], pose[1]
    mouth_x, mouth_y = mouths.position[k, 0], mouths.position[k, 1]
    for q in range(mouths.first_place[k], mouths.last_place[k]):
        x, y = mouths.places[q, 0], mouths.places[q, 1]
        cost = 0.6 * math.hypot(x - pose[0], y - pose[1])
        cost += math.hypot(x - mouth_x, y - mouth_y)
        if ahead_of(mouths, k, goal[0], goal[1]) > 0.0:  # it must not arrive on its way
            gap = distance_from_way(goal[0], goal[1], mouth_x, mouth_y, x, y)
            cost += 20.0 * max(0.9 - gap, 0.0) + (100.0 if gap < _GOAL_ASIDE else 0.0)
        for j in range(memory.known.shape[1]):
            if j == i or not memory.known[e, i, j]:
                continue
            other = memory.belief[e, i, j]
            other_goal = memory.goal[e, j]
            if central and not memory.arrived[e, j]:
                cost += 40.0 * max(1.1 - math.hypot(x - other_goal[0], y - other_goal[1]), 0.0)
                if ahead_of(mouths, k, other_goal[0], other_goal[1]) > 0.0:
                    gap = distance_from_way(x, y, mouth_x, mouth_y, other_goal[0], other_goal[1])
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
