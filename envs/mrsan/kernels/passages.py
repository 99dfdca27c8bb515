"""What robots perceive of the next passages on their routes."""

import math
from typing import NamedTuple

import numpy as np

from mrsan.features import OTHER_VELOCITY_X, OTHER_VELOCITY_Y, OTHER_X, OTHER_Y
from mrsan.kernels import function, kernel
from mrsan.kernels.routes import X, Y, following_corner
from mrsan.se2 import transform, unrotate, untransform

# Features of a passage, `mrsan.sensors.passages.PASSAGE_FEATURES`.
_MOUTH_X, _MOUTH_Y, _AXIS_X, _AXIS_Y, _DISTANCE, _LENGTH = range(6)
_WIDTH, _INSIDE, _OCCUPANTS, _FLOW, _PEOPLE = range(6, 11)

NEAR = 2.5  # m, from the way through a passage, within which people count as near
_TIE = 1e-6  # m, between the mouths of a door, which are at one point
_FAR = np.inf


class Mouths(NamedTuple):
    """The passages of E worlds; those of world e are from `first[e]` and `first_way[e]` on."""

    first: np.ndarray  # [E + 1]
    position: np.ndarray  # [K, 2] m
    outward: np.ndarray  # [K, 2]
    width: np.ndarray  # [K] m
    passage: np.ndarray  # [K] its number in the world
    length: np.ndarray  # [K] of its passage, m
    first_way: np.ndarray  # [E + 1]
    way: np.ndarray  # [S, 2, 2] ends of the straight ways through passages, m
    way_passage: np.ndarray  # [S]


@function
def ahead_of(mouths, k, x, y):
    """Return how far (x, y) is before mouth `k`, m; negative inside."""
    dx, dy = x - mouths.position[k, 0], y - mouths.position[k, 1]
    return dx * mouths.outward[k, 0] + dy * mouths.outward[k, 1]


@function
def aside_of(mouths, k, x, y):
    """Return how far (x, y) is beside the axis of mouth `k`, m."""
    dx, dy = x - mouths.position[k, 0], y - mouths.position[k, 1]
    return abs(dy * mouths.outward[k, 0] - dx * mouths.outward[k, 1])


@function
def crossing(mouths, k, ax, ay, bx, by):
    """Return at which share of the way from a to b it crosses mouth `k`, outwards or inwards.

    Returns the share, above 1 if it does not, and whether it leads outwards.
    """
    before, after = ahead_of(mouths, k, ax, ay), ahead_of(mouths, k, bx, by)
    if before * after > 0.0 or before == after:
        return 2.0, False
    share = before / (before - after)
    x, y = ax + share * (bx - ax), ay + share * (by - ay)
    if aside_of(mouths, k, x, y) > 0.5 * mouths.width[k]:
        return 2.0, False
    return share, after > before


@function
def distance_from_way(x, y, ax, ay, bx, by):
    """Return the distance of (x, y) from the way from a to b, m."""
    dx, dy = bx - ax, by - ay
    share = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-9)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(x - ax - share * dx, y - ay - share * dy)


@kernel
def observe_passages(
    first,
    last,
    worlds,
    state,
    mouths,
    humans,
    humans_visible,
    robots,
    robots_visible,
    messages,
    received,
    features,
    mask,
):
    """Write the next passages on the routes of the robots of some worlds.

    Args:
        first: the first world.
        last: the world after the last one.
        worlds: [E] bool, the worlds to observe.
        state: the worlds.
        mouths: `Mouths`.
        humans: [E, N, M, 5] what robots perceive of people.
        humans_visible: [E, N, M] bool, likewise.
        robots: [E, N, N - 1, 5] of other robots.
        robots_visible: [E, N, N - 1] bool, likewise.
        messages: [E, N, N - 1, 7] what they tell; nothing without `Scenario.team_messages`.
        received: [E, N, N - 1] bool, likewise.
        features: [E, N, K, 11], written: `mrsan.sensors.passages.PASSAGE_FEATURES`.
        mask: [E, N, K] bool, written: whether there are so many passages on the route.
    """
    n, slots = mask.shape[1], mask.shape[2]
    most = mouths.position.shape[0]
    distance, mouth, leaves = np.empty(most), np.empty(most, np.int64), np.empty(most, np.bool_)
    for e in range(first, last):
        if not worlds[e]:
            continue
        for i in range(n):
            _find_ahead(state, e, i, mouths, distance, mouth, leaves)
            for slot in range(slots):
                out = features[e, i, slot]
                out[:] = np.float32(0.0)
                p = _nearest(mouths.first[e + 1] - mouths.first[e], distance)
                mask[e, i, slot] = p >= 0
                if p < 0:
                    continue
                k, out[_DISTANCE], distance[p] = mouth[p], distance[p], _FAR
                out[_INSIDE] = leaves[p]
                _write_mouth(state, e, i, mouths, k, out)
                for j in range(humans_visible.shape[2]):
                    if humans_visible[e, i, j]:
                        _count(state, e, i, mouths, k, humans[e, i, j], True, out)
                for j in range(robots_visible.shape[2]):
                    if robots_visible[e, i, j]:
                        _count(state, e, i, mouths, k, robots[e, i, j], False, out)
                    elif j < received.shape[2] and received[e, i, j]:
                        _count(state, e, i, mouths, k, messages[e, i, j], False, out)
                if out[_OCCUPANTS] > 0.0:
                    out[_FLOW] /= out[_OCCUPANTS]


@function
def _find_ahead(state, e, i, mouths, distance, mouth, leaves):
    """Find where the rest of the route of robot `i` first crosses each passage.

    Args:
        state: the worlds.
        e: the world.
        i: the robot.
        mouths: `Mouths`.
        distance: [P], written: along the route, by number of the passage; inf: it does not, m.
        mouth: [P], written: the mouth where it does.
        leaves: [P] bool, written: whether it leaves the passage there, as the robot is inside.
    """
    first, last = mouths.first[e], mouths.first[e + 1]
    for k in range(last - first):
        distance[k] = _FAR
    if first == last:
        return
    place, corners, links = state.place[e], state.corners[e], state.corner_distance[e]
    agent = state.human_radius.shape[1] + i
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    corner, length = state.route_corner[e, agent], 0.0
    for _ in range(corners.shape[1] + 1):
        to_x, to_y = state.robot_goal[e, i, 0], state.robot_goal[e, i, 1]
        if corner >= 0:
            to_x, to_y = corners[X, corner], corners[Y, corner]
        way = math.hypot(to_x - x, to_y - y)
        for k in range(first, last):
            share, outwards = crossing(mouths, k, x, y, to_x, to_y)
            p, at = mouths.passage[k], length + share * way
            if share > 1.0 or at > distance[p] + _TIE:
                continue
            if at < distance[p] - _TIE or not outwards:
                distance[p], mouth[p], leaves[p] = at, k, outwards
        if corner < 0:
            break
        x, y, length = to_x, to_y, length + way
        corner = following_corner(place, corners, links, state.route_cost[e, agent], corner)


@function
def _nearest(count, distance):
    """Return the nearest of some passages, or -1 if all are at infinity."""
    best, least = -1, _FAR
    for p in range(count):
        if distance[p] < least:
            best, least = p, distance[p]
    return best


@function
def _write_mouth(state, e, i, mouths, k, out):
    """Write where and how wide mouth `k` is, in the body frame, and how long its passage is."""
    cos, sin = math.cos(state.robot_heading[e, i]), math.sin(state.robot_heading[e, i])
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    mouth_x, mouth_y = mouths.position[k, 0], mouths.position[k, 1]
    out[_MOUTH_X], out[_MOUTH_Y] = untransform(cos, sin, x, y, mouth_x, mouth_y)
    sign = 1.0 if out[_INSIDE] > 0.0 else -1.0
    axis_x, axis_y = sign * mouths.outward[k, 0], sign * mouths.outward[k, 1]
    out[_AXIS_X], out[_AXIS_Y] = unrotate(cos, sin, axis_x, axis_y)
    out[_WIDTH], out[_LENGTH] = mouths.width[k], mouths.length[k]


@function
def _count(state, e, i, mouths, k, track, is_person, out):
    """Count an agent whom robot `i` perceives if it is in or near the passage of mouth `k`."""
    cos, sin = math.cos(state.robot_heading[e, i]), math.sin(state.robot_heading[e, i])
    own_x, own_y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    own_vx, own_vy = state.robot_velocity[e, i, 0], state.robot_velocity[e, i, 1]
    x, y = transform(cos, sin, own_x, own_y, track[OTHER_X], track[OTHER_Y])
    gap = _distance_from_passage(e, mouths, mouths.passage[k], x, y)
    if is_person and gap <= NEAR:
        out[_PEOPLE] += np.float32(1.0)
    if gap > 0.5 * mouths.width[k]:
        return
    out[_OCCUPANTS] += np.float32(1.0)
    vx, vy = track[OTHER_VELOCITY_X], track[OTHER_VELOCITY_Y]
    vx, vy = transform(cos, sin, own_vx, own_vy, vx, vy)
    dx = x - mouths.position[k, 0] - 0.5 * mouths.width[k] * mouths.outward[k, 0]
    dy = y - mouths.position[k, 1] - 0.5 * mouths.width[k] * mouths.outward[k, 1]
    away = (vx * dx + vy * dy) / max(math.hypot(dx, dy), _TIE)
    out[_FLOW] += -away if out[_INSIDE] > 0.0 else away


@function
def _distance_from_passage(e, mouths, passage, x, y):
    """Return the distance of (x, y) from the nearest straight way through a passage, m."""
    least = _FAR
    for s in range(mouths.first_way[e], mouths.first_way[e + 1]):
        if mouths.way_passage[s] != passage:
            continue
        start, end = mouths.way[s, 0], mouths.way[s, 1]
        least = min(least, distance_from_way(x, y, start[0], start[1], end[0], end[1]))
    return least
