"""What robots perceive of walls: nearest segments, and the ranges of a lidar."""

import math

import numpy as np

from mrsan.kernels import function, kernel, rng, separate
from mrsan.kernels.walls import (
    END_X,
    END_Y,
    MOST_SEGMENTS,
    START_X,
    START_Y,
    front_distances,
    wall_count,
)
from mrsan.kernels.zones import next_point
from mrsan.se2 import unrotate

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_FAR = np.float32(np.inf)
_AGENTS = 1024  # rays at most, for distinct random numbers


@kernel
def observe_walls(first, last, worlds, state, limit, segments, mask):
    """Write the walls nearest to each robot, in its body frame, nearest first.

    Args:
        first: the first world.
        last: the world after the last one.
        worlds: [E] bool, the worlds to observe.
        state: the worlds.
        limit: distance beyond which walls are not seen, m.
        segments: [E, N, K, 4], written: start and end of each; zero where the mask is False.
        mask: [E, N, K] bool, written.
    """
    n, most = mask.shape[1], mask.shape[2]
    numbers = np.empty(most + 1, np.int32)
    distances = np.empty(most + 1, np.float32)
    of_all = np.empty(MOST_SEGMENTS, np.float32)
    for e in range(first, last):
        if worlds[e]:
            for i in range(n):
                _nearest_segments(
                    state, e, i, limit, segments[e, i], mask[e, i], numbers, distances, of_all
                )


@function
def _wall_count(state, e):
    return wall_count(state.place[e]) if state.place.shape[1] > 0 else 0


@function
def _nearest_segments(state, e, i, limit, segments, mask, numbers, distances, of_all):
    walls, count, most = state.walls[e], _wall_count(state, e), mask.shape[0]
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    cos, sin = math.cos(state.robot_heading[e, i]), math.sin(state.robot_heading[e, i])
    front_distances(walls, count, x, y, of_all)
    n = 0
    for k in range(count):
        squared = of_all[k]
        if squared > limit * limit or (n == most and squared >= distances[most - 1]):
            continue
        row = n
        while row > 0 and squared < distances[row - 1]:
            numbers[row], distances[row] = numbers[row - 1], distances[row - 1]
            row -= 1
        numbers[row], distances[row] = k, squared
        n = min(n + 1, most)
    for slot in range(most):
        mask[slot] = slot < n
        if slot < n:
            k = numbers[slot]
            segments[slot, 0], segments[slot, 1] = unrotate(
                cos, sin, walls[START_X, k] - x, walls[START_Y, k] - y
            )
            segments[slot, 2], segments[slot, 3] = unrotate(
                cos, sin, walls[END_X, k] - x, walls[END_Y, k] - y
            )
        else:
            segments[slot, 0] = segments[slot, 1] = segments[slot, 2] = segments[slot, 3] = _ZERO


@kernel
def observe_route(first, last, worlds, state, known, route):
    """Write where the route of each robot leads next in its body frame, [E, N, 2], m.

    That is the next corner, or the goal if it can be reached straight on or if the map is not
    known.
    """
    n = route.shape[1]
    for e in range(first, last):
        if worlds[e]:
            for i in range(n):
                _write_route(state, e, i, known, route[e, i])


@function
def _write_route(state, e, i, known, route):
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    cos, sin = math.cos(state.robot_heading[e, i]), math.sin(state.robot_heading[e, i])
    to_x, to_y = state.robot_goal[e, i, 0], state.robot_goal[e, i, 1]
    if known and state.place.shape[1] > 0:
        to_x, to_y = next_point(state, e, state.human_radius.shape[1] + i, to_x, to_y)
    route[0], route[1] = unrotate(cos, sin, to_x - x, to_y - y)


@kernel
def scan(first, last, worlds, state, q, cosines, sines, ranges):
    """Write the ranges of each robot's lidar.

    Args:
        first: the first world.
        last: the world after the last one.
        worlds: [E] bool, the worlds to observe.
        state: the worlds.
        q: the lidar, see `mrsan.sensors.walls.LidarParameters`.
        cosines: [L] of the angles of the rays in the body frame.
        sines: [L] likewise.
        ranges: [E, N, L], written, m; the greatest range where nothing is hit.
    """
    n, rays = ranges.shape[1], ranges.shape[2]
    directions = np.empty((2, rays), np.float32)
    fractions = np.empty((2, rays), np.float32)  # the ranges as numerators and denominators
    of_all = np.empty(MOST_SEGMENTS, np.float32)
    for e in range(first, last):
        if worlds[e]:
            for i in range(n):
                cos = math.cos(state.robot_heading[e, i])
                sin = math.sin(state.robot_heading[e, i])
                for ray in range(rays):
                    directions[0, ray] = cos * cosines[ray] - sin * sines[ray]
                    directions[1, ray] = sin * cosines[ray] + cos * sines[ray]
                _scan_walls(state, e, i, q, directions, fractions, of_all, ranges[e, i])
                if q.sees_agents:
                    _scan_agents(state, e, i, q, directions[0], directions[1], ranges[e, i])
                _disturb(state, e, i, q, ranges[e, i])


@function
def _scan_walls(state, e, i, q, directions, fractions, of_all, ranges):
    across, determinant = fractions[0], fractions[1]
    walls, count = state.walls[e], _wall_count(state, e)
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    for ray in range(ranges.shape[0]):
        across[ray], determinant[ray] = q.range, _ONE
    front_distances(walls, count, x, y, of_all)
    for k in range(count):
        if of_all[k] > q.range * q.range:
            continue
        ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
        ux, uy = walls[END_X, k] - walls[START_X, k], walls[END_Y, k] - walls[START_Y, k]
        _shorten_rays(directions[0], directions[1], across, determinant, ax, ay, ux, uy)
    for ray in range(ranges.shape[0]):
        ranges[ray] = across[ray] / determinant[ray]


@separate
def _shorten_rays(ray_x, ray_y, across, determinant, ax, ay, ux, uy):
    """Shorten the rays that a wall from (ax, ay) along (ux, uy), which faces the robot, stops."""
    own_across = ay * ux - ax * uy  # positive, as the wall faces the robot
    for ray in range(ray_x.shape[0]):
        dx, dy = ray_x[ray], ray_y[ray]
        own = dy * ux - dx * uy  # positive: the ray meets the front of the line
        share = ay * dx - ax * dy  # of the segment, where they meet, times `own`
        hit = (share >= _ZERO) & (share <= own) & (own > _ZERO)
        nearer = hit & (own_across * determinant[ray] < across[ray] * own)
        across[ray] = own_across if nearer else across[ray]
        determinant[ray] = own if nearer else determinant[ray]


@function
def _scan_agents(state, e, i, q, ray_x, ray_y, ranges):
    """Shorten the rays that people and other robots stop."""
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    people = state.human_radius.shape[1]
    for j in range(people + state.robot_heading.shape[1]):
        if j == people + i or (j < people and not state.human_present[e, j]):
            continue
        if j < people:
            px, py = state.human_position[e, j, 0] - x, state.human_position[e, j, 1] - y
            radius = state.human_radius[e, j]
        else:
            px = state.robot_position[e, j - people, 0] - x
            py = state.robot_position[e, j - people, 1] - y
            radius = q.robot_radius
        for ray in range(ranges.shape[0]):
            along = px * ray_x[ray] + py * ray_y[ray]
            across = px * ray_y[ray] - py * ray_x[ray]
            inside = radius * radius - across * across
            distance = max(along - math.sqrt(max(inside, _ZERO)), _ZERO)
            nearer = (inside > _ZERO) & (along > _ZERO) & (distance < ranges[ray])
            ranges[ray] = distance if nearer else ranges[ray]


@function
def _disturb(state, e, i, q, ranges):
    """Add noise to the ranges, and lose some: those have the greatest range."""
    key, step = state.key[e], state.clock[e]
    if q.noise > _ZERO or q.noise_share > _ZERO:
        for ray in range(ranges.shape[0]):
            sigma = q.noise + q.noise_share * ranges[ray]
            error = rng.nearly_normal(key, rng.LIDAR, i * _AGENTS + ray, step, 0)
            noisy = min(max(ranges[ray] + sigma * error, _ZERO), q.range)
            ranges[ray] = noisy if ranges[ray] < q.range else q.range
    if q.dropout > _ZERO:
        for ray in range(ranges.shape[0]):
            draw = rng.uniform(key, rng.LIDAR, i * _AGENTS + ray, step, 2)
            ranges[ray] = q.range if draw < q.dropout else ranges[ray]
