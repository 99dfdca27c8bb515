"""Optimal reciprocal collision avoidance (van den Berg et al., 2011), as in the RVO2 library.

An agent is a row `[px, py, vx, vy, radius]`. A line is four numbers: the permitted velocities lie
to the left of the direction (DX, DY) through the point (PX, PY).

Agents and lines are stored as columns, one for each of their numbers, so that vector instructions
compute the lines of all neighbours at once. Those begin at line `MOST_WALLS`, and the lines of
walls lie directly before them: a place that the compiler knows is three times faster.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from mrsan.kernels import allocating, function
from mrsan.kernels.walls import MOST_SEGMENTS

MOST = 80  # agents at most
MOST_WALLS = 32  # wall segments at most
_ROOM = MOST + MOST_WALLS
PX, PY, DX, DY = 0, _ROOM, 2 * _ROOM, 3 * _ROOM  # of line k: lines[PX + k] and so on
_LANES = 16  # lines are computed in vectors of this length

_EPSILON = np.float32(1e-5)
_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_FAR = np.float32(np.inf)
_SAMPLE = 8  # agents from whose distances the search radius is estimated
_REACHES = 8  # search radii tried before all within `neighbor_distance` are ranked
_SPARE = np.float32(1.4)  # the estimate aims at this multiple of the neighbours needed


class Scratch(NamedTuple):
    """Working arrays of crowd models."""

    distances: Any  # [2, A] squared distances of all agents, of the near ones
    places: Any  # [2, A] rows of the near agents, their ranks
    nearest: Any  # [A, 5] the neighbours, nearest first
    lines: Any  # lines of the walls up to `MOST_WALLS`, then those of the neighbours
    projected: Any  # lines projected on another
    wall_lines: Any  # lines of the near walls
    wall_counts: Any  # [2] number of near walls, of lines of walls
    wall_points: Any  # [MOST_WALLS, 2] nearest points of the near walls, nearest first, m
    wall_numbers: Any  # [MOST_WALLS] numbers of the near walls
    wall_distances: Any  # [MOST_WALLS] their squared distances, m^2
    all_wall_distances: Any  # [MOST_SEGMENTS] of all walls, m^2


@allocating
def allocate_orca_scratch(most):
    """Return an array for up to `most` agents, and scratch arrays for `orca_velocity`."""
    room = (most + _LANES - 1) // _LANES * _LANES
    agents = np.zeros((5, room), np.float32).T
    return agents, Scratch(
        np.empty((2, room), np.float32),
        np.empty((2, room), np.uint32),
        np.zeros((5, room), np.float32).T,
        np.empty(4 * _ROOM, np.float32),
        np.empty(4 * _ROOM, np.float32),
        np.empty(4 * _ROOM, np.float32),
        np.zeros(2, np.int32),
        np.empty((MOST_WALLS, 2), np.float32),
        np.empty(MOST_WALLS, np.int32),
        np.empty(MOST_WALLS, np.float32),
        np.empty(MOST_SEGMENTS, np.float32),
    )


@function
def orca_velocity(
    agents,
    count,
    i,
    preferred_x,
    preferred_y,
    max_speed,
    neighbor_distance,
    max_neighbors,
    time_horizon,
    time_step,
    scratch,
    walls=0,
):
    """Return the next velocity of agent `i` among the first `count` rows of `agents`.

    Args:
        agents: [A, 5] positions, velocities and radii (m, m/s), from `allocate_orca_scratch`.
        count: number of rows of `agents` in use.
        i: the row of the agent that decides.
        preferred_x: preferred velocity, x (m/s).
        preferred_y: preferred velocity, y (m/s).
        max_speed: speed limit (m/s).
        neighbor_distance: agents farther away are ignored (m).
        max_neighbors: largest number of neighbours considered, nearest first.
        time_horizon: time for which the velocity must be free of collisions (s).
        time_step: length of a step (s).
        scratch: from `allocate_orca_scratch`.
        walls: number of lines that `obstacle_orca.wall_lines` has written into `scratch`.
    """
    distances, places, nearest = scratch.distances, scratch.places, scratch.nearest
    lines, projected = scratch.lines, scratch.projected
    n = _find_nearest(
        agents, count, i, neighbor_distance, max_neighbors, distances, places, nearest
    )
    _half_planes(agents, i, nearest, n, time_horizon, time_step, lines)
    first, end = MOST_WALLS - walls, MOST_WALLS + n
    _copy_lines(scratch.wall_lines, 0, lines, first, walls)
    x, y, failed = _linear_program_2(lines, first, end, max_speed, preferred_x, preferred_y, False)
    if failed < end:
        x, y = _linear_program_3(lines, projected, first, end, failed, max_speed, x, y)
    return x, y


@function
def _copy_lines(source, source_first, target, target_first, count):
    for k in range(count):
        a, b = source_first + k, target_first + k
        target[PX + b], target[PY + b] = source[PX + a], source[PY + a]
        target[DX + b], target[DY + b] = source[DX + a], source[DY + a]


@function
def _find_nearest(agents, count, i, neighbor_distance, max_neighbors, distances, places, nearest):
    """Write the neighbours of `i` to `nearest`, nearest first; return how many there are."""
    squared, near = distances[0], distances[1]
    rows, rank = places[0], places[1]
    limit = neighbor_distance * neighbor_distance
    x, y = agents[i, 0], agents[i, 1]
    for j in range(count):
        dx, dy = x - agents[j, 0], y - agents[j, 1]
        squared[j] = dx * dx + dy * dy
    reach = limit
    if count > 3 * max_neighbors // 2:
        reach = min(limit, _likely_reach(squared, count, max_neighbors))
    squared[i] = limit  # not its own neighbour
    n = 0
    for attempt in range(_REACHES):  # once there are enough, the reach makes no difference
        n = 0
        for j in range(count):  # without a branch, which would be unpredictable
            near[n], rows[n] = squared[j], j
            n += squared[j] < reach
        if n >= max_neighbors or reach >= limit:
            break
        reach = min(limit, _TWO * reach) if attempt < _REACHES - 2 else limit
    for k in range(n):  # equal distances are ordered by row
        farther = np.uint32(0)  # 32 bits like the ranks, for vector instructions
        for q in range(k):
            is_farther = near[q] > near[k]
            rank[q] += is_farther
            farther += is_farther
        rank[k] = np.uint32(k) - farther
    most = min(n, max_neighbors)
    for k in range(n):
        if rank[k] < most:
            for column in range(5):
                nearest[rank[k], column] = agents[rows[k], column]
    return most


@function
def _likely_reach(squared, count, max_neighbors):
    """Return a squared distance within which probably slightly more than `max_neighbors` lie.

    If agents are uniform on a disc, squared distances are uniform up to twice their mean, which a
    few agents estimate well enough.
    """
    step = (count + _SAMPLE - 1) // _SAMPLE
    total, sampled = _ZERO, 0
    for j in range(0, count, step):
        total += squared[j]
        sampled += 1
    if total == _ZERO:
        return _FAR
    return _TWO * _SPARE * total * np.float32(max_neighbors) / np.float32(sampled * count)


@function
def _half_planes(agents, i, nearest, n, time_horizon, time_step, lines):
    """Write the half-planes of velocities by which agent `i` does its share of each avoidance.

    They begin at line `MOST_WALLS`; lines beyond the first `n` of them are undefined. Both cases
    are computed and one is selected instead of branching, so that the compiler can use vector
    instructions.
    """
    own_x, own_y, own_vx, own_vy = agents[i, 0], agents[i, 1], agents[i, 2], agents[i, 3]
    own_radius = agents[i, 4]
    by_horizon, by_step = _ONE / time_horizon, _ONE / time_step
    for k in range((n + _LANES - 1) // _LANES * _LANES):
        px, py = nearest[k, 0] - own_x, nearest[k, 1] - own_y
        vx, vy = own_vx - nearest[k, 2], own_vy - nearest[k, 3]
        distance_squared = px * px + py * py
        radius = own_radius + nearest[k, 4]
        radius_squared = radius * radius
        colliding = distance_squared <= radius_squared
        # The cut-off disc of the velocity obstacle; agents that overlap must part within one step.
        inverse = by_step if colliding else by_horizon
        wx, wy = vx - inverse * px, vy - inverse * py
        w_squared = wx * wx + wy * wy
        along = wx * px + wy * py
        to_disc = colliding | (
            (along < _ZERO) & (along * along > radius_squared * w_squared)
        )  # or to one of the two legs of the cone
        root = math.sqrt(w_squared if to_disc else distance_squared - radius_squared)
        w = _EPSILON if root <= _ZERO else root
        wx = _EPSILON if root <= _ZERO else wx
        on_left = px * wy - py * wx > _ZERO
        leg_x = px * root - py * radius if on_left else -(px * root + py * radius)
        leg_y = px * radius + py * root if on_left else -(-px * radius + py * root)
        length = w if to_disc else distance_squared
        x, y = (wx if to_disc else leg_x) / length, (wy if to_disc else leg_y) / length
        depth, dot = radius * inverse - w, vx * x + vy * y
        ux = depth * x if to_disc else dot * x - vx
        uy = depth * y if to_disc else dot * y - vy
        lines[PX + MOST_WALLS + k] = own_vx + _HALF * ux
        lines[PY + MOST_WALLS + k] = own_vy + _HALF * uy
        lines[DX + MOST_WALLS + k] = y if to_disc else x
        lines[DY + MOST_WALLS + k] = -x if to_disc else y


@function
def _linear_program_1(lines, first, k, radius, goal_x, goal_y, goal_is_direction):
    """Return (feasible, x, y), the best point on line `k` within the disc and earlier lines."""
    px, py, dx, dy = lines[PX + k], lines[PY + k], lines[DX + k], lines[DY + k]
    dot = px * dx + py * dy
    discriminant = dot * dot + radius * radius - (px * px + py * py)
    if discriminant < _ZERO:
        return False, _ZERO, _ZERO
    root = math.sqrt(discriminant)
    left, right = -dot - root, -dot + root
    for i in range(first, k):
        ex, ey = lines[DX + i], lines[DY + i]
        denominator = dx * ey - dy * ex
        numerator = ex * (py - lines[PY + i]) - ey * (px - lines[PX + i])
        if abs(denominator) <= _EPSILON:
            if numerator < _ZERO:
                return False, _ZERO, _ZERO
            continue
        t = numerator / denominator
        if denominator >= _ZERO:
            right = min(right, t)
        else:
            left = max(left, t)
        if left > right:
            return False, _ZERO, _ZERO
    if goal_is_direction:
        t = right if goal_x * dx + goal_y * dy > _ZERO else left
    else:
        t = min(max(dx * (goal_x - px) + dy * (goal_y - py), left), right)
    return True, px + t * dx, py + t * dy


@function
def _linear_program_2(lines, first, end, radius, goal_x, goal_y, goal_is_direction):
    """Return (x, y, k): the best point within disc and lines; k: the infeasible line, or `end`."""
    speed_squared = goal_x * goal_x + goal_y * goal_y
    if goal_is_direction:
        x, y = goal_x * radius, goal_y * radius
    elif speed_squared > radius * radius:
        speed = math.sqrt(speed_squared)
        x, y = goal_x / speed * radius, goal_y / speed * radius
    else:
        x, y = goal_x, goal_y
    for k in range(first, end):
        dx, dy = lines[DX + k], lines[DY + k]
        if dx * (lines[PY + k] - y) - dy * (lines[PX + k] - x) > _ZERO:
            feasible, new_x, new_y = _linear_program_1(
                lines, first, k, radius, goal_x, goal_y, goal_is_direction
            )
            if not feasible:
                return x, y, k
            x, y = new_x, new_y
    return x, y, end


@function
def _linear_program_3(lines, projected, first, end, failed, radius, x, y):
    """Return the velocity whose largest violation is smallest, if none satisfies all lines.

    The lines of walls stay as they are; only those of other agents are relaxed.
    """
    distance = _ZERO
    _copy_lines(lines, first, projected, first, MOST_WALLS - first)
    for k in range(failed, end):
        px, py = lines[PX + k], lines[PY + k]
        dx, dy = lines[DX + k], lines[DY + k]
        if dx * (py - y) - dy * (px - x) <= distance:
            continue
        m = MOST_WALLS
        for j in range(MOST_WALLS, k):
            qx, qy = lines[PX + j], lines[PY + j]
            ex, ey = lines[DX + j], lines[DY + j]
            determinant = dx * ey - dy * ex
            if abs(determinant) <= _EPSILON:
                if dx * ex + dy * ey > _ZERO:
                    continue
                projected[PX + m], projected[PY + m] = _HALF * (px + qx), _HALF * (py + qy)
            else:
                t = (ex * (py - qy) - ey * (px - qx)) / determinant
                projected[PX + m], projected[PY + m] = px + t * dx, py + t * dy
            ex, ey = ex - dx, ey - dy
            norm = math.sqrt(ex * ex + ey * ey)
            projected[DX + m], projected[DY + m] = ex / norm, ey / norm
            m += 1
        new_x, new_y, infeasible = _linear_program_2(projected, first, m, radius, -dy, dx, True)
        if infeasible == m:  # Otherwise only rounding stands in the way: keep the last point.
            x, y = new_x, new_y
        distance = dx * (py - y) - dy * (px - x)
    return x, y
