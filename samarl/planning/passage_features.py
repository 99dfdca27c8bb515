"""What the learned macro level knows of a passage, of its robot, of people and of team-mates.

Positions are given as the distance before the mouth where the robot enters its next passage,
the distance beyond the mouth where it leaves it, and the distance beside the axis of the first,
positive on the robot's own side.
"""

from __future__ import annotations

import math

from mrsan.features import OTHER_VELOCITY_X, OTHER_VELOCITY_Y, OTHER_X, OTHER_Y
from mrsan.kernels import function, kernel
from mrsan.kernels.passages import ahead_of
from mrsan.kernels.team import PRIORITY, THROUGH
from mrsan.se2 import rotate, transform
from samarl.planning.right_of_way import (
    ENTER,
    MODES,
    QUEUE,
    WAIT,
    believed_mode,
    distance_to,
    is_blocked,
    mouths_of_world,
)

OWN = 42  # numbers about a robot itself, its passage, and the people that it sees
MATE = 18  # about each team-mate; the first is 1 if the robot knows of it
TRUTH = 8  # about each team-mate, for the critic only
TOLD = slice(3, 3 + MODES)  # of a team-mate's numbers, its macro action

_LENGTH, _STEPS = 5.0, 16.0  # scales, m and steps
_PERSON = 5  # numbers about one person
_FIRST_PERSON = OWN - 4 * _PERSON  # nearest before the passage, nearest beyond it, two inside
_FAR = 5.0  # m, from a mouth, beyond which people do not count


@kernel
def write_features(
    first, last, ego, humans, humans_visible, all_mouths, first_mouth, memory, own, mates, truth
):
    """Write the features of all robots for which a choice is due; others keep theirs.

    Args:
        first: first world to work on.
        last: the one after the last.
        ego: [E, N, 11] what robots observe.
        humans: [E, N, M, 5] likewise.
        humans_visible: [E, N, M] likewise.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`.
        own: [E, N, OWN], written.
        mates: [E, N, N - 1, MATE], written: what robots believe of each other.
        truth: [E, N, N - 1, MATE + TRUTH], written: the same as it is, for the critic.
    """
    for e in range(first, last):
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        for i in range(memory.pose.shape[1]):
            if not memory.due[e, i]:
                continue
            _write_own(e, i, mouths, memory, own[e, i])
            _write_people(
                e, i, ego[e, i], humans[e, i], humans_visible[e, i], mouths, memory, own[e, i]
            )
            for j in range(memory.pose.shape[1]):
                if j == i:
                    continue
                slot = j - (j > i)
                mates[e, i, slot, :], truth[e, i, slot, :] = 0.0, 0.0
                out = mates[e, i, slot]
                if memory.known[e, i, j]:
                    other = memory.belief[e, i, j]
                    mode, mouth = believed_mode(mouths, memory, e, i, j)
                    through, priority = other[THROUGH], other[PRIORITY]
                    _write_mate(
                        e,
                        i,
                        other,
                        mode,
                        mouth,
                        through,
                        priority,
                        mouths,
                        memory,
                        mates[e, i, slot],
                    )
                through = 1.0 if memory.arrived[e, j] or memory.ahead[e, j] == 0 else 0.0
                mode, mouth = memory.mode[e, j], memory.entry[e, j]
                priority = memory.belief[e, j, j, PRIORITY]
                pose, out = memory.pose[e, j], truth[e, i, slot]
                _write_mate(e, i, pose, mode, mouth, through, priority, mouths, memory, out)
                _write_truth(e, j, mouths, memory, out)


@function
def _exit(e, i, mouths, memory):
    """Return the position and the outward direction of the mouth where robot `i` leaves."""
    entry, leave = memory.entry[e, i], memory.exit[e, i]
    k = leave if leave >= 0 else entry
    x, y = mouths.position[k, 0], mouths.position[k, 1]
    ux, uy = mouths.outward[k, 0], mouths.outward[k, 1]
    if leave < 0:  # its goal is inside: the far end, straight on
        length = mouths.length[entry]
        return x - length * ux, y - length * uy, -ux, -uy
    return x, y, ux, uy


@function
def _beyond(e, i, mouths, memory, x, y):
    """Return how far (x, y) is beyond the passage of robot `i`, m; negative: not yet."""
    ex, ey, ux, uy = _exit(e, i, mouths, memory)
    return (x - ex) * ux + (y - ey) * uy


@function
def _beside(e, i, mouths, memory, x, y):
    """Return how far (x, y) is beside the axis of the mouth where robot `i` enters, signed, m."""
    k, pose = memory.entry[e, i], memory.pose[e, i]
    mx, my = mouths.position[k, 0], mouths.position[k, 1]
    ux, uy = mouths.outward[k, 0], mouths.outward[k, 1]
    side = 1.0 if ux * (pose[1] - my) - uy * (pose[0] - mx) >= 0.0 else -1.0
    return side * (ux * (y - my) - uy * (x - mx))


@function
def _way_left(e, i, mouths, memory):
    """Return the length of the way of robot `i` through its passage to its goal, m."""
    entry, pose, goal = memory.entry[e, i], memory.pose[e, i], memory.goal[e, i]
    if entry < 0:
        return math.hypot(goal[0] - pose[0], goal[1] - pose[1])
    ex, ey, _, _ = _exit(e, i, mouths, memory)
    rest = math.hypot(goal[0] - ex, goal[1] - ey)
    if memory.inside[e, i]:
        return rest + math.hypot(pose[0] - ex, pose[1] - ey)
    return rest + mouths.length[entry] + distance_to(mouths, entry, pose[0], pose[1])


@function
def _blocks(e, i, mouths, memory):
    """Return 1 if robot `i` would block the mouth where it leaves its passage at its goal."""
    leave, goal = memory.exit[e, i], memory.goal[e, i]
    return 1.0 if leave >= 0 and is_blocked(mouths, leave, goal[0], goal[1]) else 0.0


@function
def _write_own(e, i, mouths, memory, out):
    """Write the numbers about robot `i` and its passage."""
    entry, pose, goal = memory.entry[e, i], memory.pose[e, i], memory.goal[e, i]
    out[0] = memory.belief[e, i, i, PRIORITY]
    out[1] = mouths.length[entry] / _LENGTH
    out[2] = 5.0 * min(mouths.width[entry] - 1.15, 1.0)
    out[3] = distance_to(mouths, entry, pose[0], pose[1]) / _LENGTH
    out[4] = ahead_of(mouths, entry, pose[0], pose[1]) / _LENGTH
    out[5] = _beyond(e, i, mouths, memory, pose[0], pose[1]) / _LENGTH
    out[6] = _beside(e, i, mouths, memory, pose[0], pose[1]) / 3.0
    out[7] = memory.inside[e, i]
    out[8] = _beyond(e, i, mouths, memory, goal[0], goal[1]) / _LENGTH
    out[9] = abs(_beside(e, i, mouths, memory, goal[0], goal[1])) / 3.0
    out[10] = _blocks(e, i, mouths, memory)
    out[11] = _way_left(e, i, mouths, memory) / 10.0
    out[12] = math.hypot(pose[2], pose[3])
    out[13] = min(memory.stuck[e, i], 16) / _STEPS
    out[14] = memory.choice[e, i] == ENTER
    out[15] = memory.choice[e, i] == QUEUE
    waits = memory.mode[e, i] == WAIT
    place = memory.place[e, i]
    out[16] = waits
    out[17] = math.hypot(place[0] - pose[0], place[1] - pose[1]) / _LENGTH if waits else 0.0
    out[18] = out[19] = out[20] = out[21] = 0.0
    for j in range(memory.known.shape[1]):
        if j == i or not memory.known[e, i, j]:
            continue
        _, mouth = believed_mode(mouths, memory, e, i, j)
        out[18] += memory.belief[e, i, j, THROUGH] / 3.0
        if mouth >= 0 and mouths.passage[mouth] == mouths.passage[entry]:
            out[19 if mouth == entry else 20] += 1.0 / 3.0
        else:
            out[21] += 1.0 / 3.0


@function
def _write_person(e, i, out, near, ahead, beside, velocity, mouths, memory):
    """Write the numbers about a person."""
    k = memory.entry[e, i]
    ux, uy = mouths.outward[k, 0], mouths.outward[k, 1]
    out[0], out[1], out[2] = 1.0, near / 3.0, ahead / _LENGTH
    out[3] = abs(beside) / 2.0
    out[4] = -velocity[0] * ux - velocity[1] * uy


@function
def _write_people(e, i, ego, humans, visible, mouths, memory, out):
    """Write the nearest person before the passage and beyond it, and two inside."""
    out[_FIRST_PERSON:] = 0.0
    entry, pose = memory.entry[e, i], memory.pose[e, i]
    cos, sin = math.cos(pose[4]), math.sin(pose[4])
    ex, ey, _, _ = _exit(e, i, mouths, memory)
    nearest_before, nearest_beyond, inside = _FAR, _FAR, 0
    for h in range(visible.shape[0]):
        if not visible[h]:
            continue
        x, y = transform(cos, sin, pose[0], pose[1], humans[h, OTHER_X], humans[h, OTHER_Y])
        vx, vy = humans[h, OTHER_VELOCITY_X], humans[h, OTHER_VELOCITY_Y]
        vx, vy = rotate(cos, sin, vx, vy)
        velocity = vx + pose[2], vy + pose[3]
        before = ahead_of(mouths, entry, x, y)
        beyond = _beyond(e, i, mouths, memory, x, y)
        beside = _beside(e, i, mouths, memory, x, y)
        if before <= 0.3 and beyond <= 0.3 and abs(beside) < 0.5 * mouths.width[entry] + 0.2:
            if inside < 2:
                first = _FIRST_PERSON + (2 + inside) * _PERSON
                near = math.hypot(x - pose[0], y - pose[1])
                _write_person(e, i, out[first:], near, -before, beside, velocity, mouths, memory)
                inside += 1
        elif before > 0.0:
            near = distance_to(mouths, entry, x, y)
            if near < nearest_before:
                nearest_before = near
                first = _FIRST_PERSON
                _write_person(e, i, out[first:], near, before, beside, velocity, mouths, memory)
        elif beyond > 0.0:
            near = math.hypot(x - ex, y - ey)
            if near < nearest_beyond:
                nearest_beyond = near
                first = _FIRST_PERSON + _PERSON
                _write_person(e, i, out[first:], near, beyond, beside, velocity, mouths, memory)


@function
def _write_mate(e, i, pose, mode, mouth, through, priority, mouths, memory, out):
    """Write the numbers about a team-mate of robot `i`: what it believes, or what is true."""
    entry = memory.entry[e, i]
    x, y, own = pose[0], pose[1], memory.pose[e, i]
    out[0] = 1.0
    out[1], out[2] = priority, priority > memory.belief[e, i, i, PRIORITY]
    out[3 + mode] = 1.0
    same = mouth >= 0 and mouths.passage[mouth] == mouths.passage[entry]
    out[7], out[8] = same and mouth == entry, same and mouth != entry
    out[9] = through
    out[10] = ahead_of(mouths, entry, x, y) / _LENGTH
    out[11] = _beyond(e, i, mouths, memory, x, y) / _LENGTH
    out[12] = _beside(e, i, mouths, memory, x, y) / 3.0
    out[13] = distance_to(mouths, mouth, x, y) / _LENGTH if mouth >= 0 else 0.0
    ux, uy = mouths.outward[entry, 0], mouths.outward[entry, 1]
    out[14] = -pose[2] * ux - pose[3] * uy
    out[15] = math.hypot(pose[2], pose[3])
    out[16] = math.hypot(x - own[0], y - own[1]) / _LENGTH
    out[17] = distance_to(mouths, entry, x, y) / _LENGTH


@function
def _write_truth(e, j, mouths, memory, out):
    """Write what only the critic knows of robot `j`."""
    out[MATE] = memory.arrived[e, j]
    out[MATE + 1] = _way_left(e, j, mouths, memory) / 10.0 if not memory.arrived[e, j] else 0.0
    out[MATE + 2] = _blocks(e, j, mouths, memory)
    out[MATE + 3] = min(memory.stuck[e, j], 16) / _STEPS
    out[MATE + 4] = memory.age[e, j] / _STEPS if memory.entry[e, j] >= 0 else 0.0
    out[MATE + 5] = memory.inside[e, j]
    out[MATE + 6] = memory.choice[e, j] == ENTER
    out[MATE + 7] = memory.queued[e, j] >= 0
