"""Optimal reciprocal collision avoidance (van den Berg et al., 2011), as the RVO2 library does it.

An agent is a row `[px, py, vx, vy, radius]`. A line is a row `[px, py, dx, dy]`: the permitted
velocities lie to the left of the direction `d` through the point `p`.
"""

import math

import numpy as np

from mrsan.kernels import function

_EPSILON = np.float32(1e-5)
_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)


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
    neighbors,
    lines,
    projected,
):
    """New velocity of agent `i` among the first `count` rows of `agents`.

    Args:
        agents: [A, 5] position, velocity and radius (m, m/s).
        count: number of rows of `agents` in use.
        i: the row of the agent that decides.
        preferred_x: preferred velocity, x (m/s).
        preferred_y: preferred velocity, y (m/s).
        max_speed: speed limit (m/s).
        neighbor_distance: only agents nearer than this count (m).
        max_neighbors: only so many of the nearest count.
        time_horizon: for how long the velocity must be safe (s).
        time_step: length of a step (s).
        neighbors: scratch, [max_neighbors, 2].
        lines: scratch, [max_neighbors, 4].
        projected: scratch, [max_neighbors, 4].
    """
    n = _nearest(agents, count, i, neighbor_distance, max_neighbors, neighbors)
    for k in range(n):
        _half_plane(agents, i, int(neighbors[k, 1]), time_horizon, time_step, lines, k)
    x, y, failed = _linear_program_2(lines, n, max_speed, preferred_x, preferred_y, False)
    if failed < n:
        x, y = _linear_program_3(lines, projected, n, failed, max_speed, x, y)
    return x, y


@function
def _nearest(agents, count, i, neighbor_distance, max_neighbors, neighbors):
    """Fill `neighbors` with (squared distance, row), nearest first; return how many."""
    n = 0
    x, y = agents[i, 0], agents[i, 1]
    limit = neighbor_distance * neighbor_distance
    for j in range(count):
        dx, dy = x - agents[j, 0], y - agents[j, 1]
        distance = dx * dx + dy * dy
        if j == i or distance >= limit:
            continue
        if n < max_neighbors:
            n += 1
        k = n - 1
        while k > 0 and distance < neighbors[k - 1, 0]:
            neighbors[k, 0] = neighbors[k - 1, 0]
            neighbors[k, 1] = neighbors[k - 1, 1]
            k -= 1
        neighbors[k, 0] = distance
        neighbors[k, 1] = j
        if n == max_neighbors:
            limit = neighbors[n - 1, 0]
    return n


@function
def _half_plane(agents, i, j, time_horizon, time_step, lines, k):
    """The velocities of `i` that share the avoidance of `j` fairly."""
    px, py = agents[j, 0] - agents[i, 0], agents[j, 1] - agents[i, 1]
    vx, vy = agents[i, 2] - agents[j, 2], agents[i, 3] - agents[j, 3]
    distance_squared = px * px + py * py
    radius = agents[i, 4] + agents[j, 4]
    radius_squared = radius * radius
    colliding = distance_squared <= radius_squared
    # The cut-off disc of the velocity obstacle; agents that overlap must part within one step.
    inverse = _ONE / time_step if colliding else _ONE / time_horizon
    wx, wy = vx - inverse * px, vy - inverse * py
    w_squared = wx * wx + wy * wy
    along = wx * px + wy * py
    if colliding or (along < _ZERO and along * along > radius_squared * w_squared):
        w = math.sqrt(w_squared)
        if w <= _ZERO:
            w, wx = _EPSILON, _EPSILON
        nx, ny = wx / w, wy / w
        dx, dy = ny, -nx
        ux, uy = (radius * inverse - w) * nx, (radius * inverse - w) * ny
    else:  # One of the two legs of the cone.
        leg = math.sqrt(distance_squared - radius_squared)
        if px * wy - py * wx > _ZERO:
            dx = (px * leg - py * radius) / distance_squared
            dy = (px * radius + py * leg) / distance_squared
        else:
            dx = -(px * leg + py * radius) / distance_squared
            dy = -(-px * radius + py * leg) / distance_squared
        dot = vx * dx + vy * dy
        ux, uy = dot * dx - vx, dot * dy - vy
    lines[k, 0] = agents[i, 2] + _HALF * ux
    lines[k, 1] = agents[i, 3] + _HALF * uy
    lines[k, 2] = dx
    lines[k, 3] = dy


@function
def _linear_program_1(lines, k, radius, goal_x, goal_y, goal_is_direction):
    """Best point on line `k` within the disc and the lines before it: (feasible, x, y)."""
    px, py, dx, dy = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
    dot = px * dx + py * dy
    discriminant = dot * dot + radius * radius - (px * px + py * py)
    if discriminant < _ZERO:
        return False, _ZERO, _ZERO
    root = math.sqrt(discriminant)
    left, right = -dot - root, -dot + root
    for i in range(k):
        denominator = dx * lines[i, 3] - dy * lines[i, 2]
        numerator = lines[i, 2] * (py - lines[i, 1]) - lines[i, 3] * (px - lines[i, 0])
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
def _linear_program_2(lines, n, radius, goal_x, goal_y, goal_is_direction):
    """Point nearest the goal within the disc and all lines: (x, y, first line that failed or n)."""
    speed_squared = goal_x * goal_x + goal_y * goal_y
    if goal_is_direction:
        x, y = goal_x * radius, goal_y * radius
    elif speed_squared > radius * radius:
        speed = math.sqrt(speed_squared)
        x, y = goal_x / speed * radius, goal_y / speed * radius
    else:
        x, y = goal_x, goal_y
    for k in range(n):
        if lines[k, 2] * (lines[k, 1] - y) - lines[k, 3] * (lines[k, 0] - x) > _ZERO:
            feasible, new_x, new_y = _linear_program_1(
                lines, k, radius, goal_x, goal_y, goal_is_direction
            )
            if not feasible:
                return x, y, k
            x, y = new_x, new_y
    return x, y, n


@function
def _linear_program_3(lines, projected, n, first, radius, x, y):
    """No velocity satisfies all lines: the one that violates the worst of them least."""
    distance = _ZERO
    for k in range(first, n):
        px, py = lines[k, 0], lines[k, 1]
        dx, dy = lines[k, 2], lines[k, 3]
        if dx * (py - y) - dy * (px - x) <= distance:
            continue
        m = 0
        for j in range(k):
            qx, qy = lines[j, 0], lines[j, 1]
            ex, ey = lines[j, 2], lines[j, 3]
            determinant = dx * ey - dy * ex
            if abs(determinant) <= _EPSILON:
                if dx * ex + dy * ey > _ZERO:
                    continue
                projected[m, 0], projected[m, 1] = _HALF * (px + qx), _HALF * (py + qy)
            else:
                t = (ex * (py - qy) - ey * (px - qx)) / determinant
                projected[m, 0], projected[m, 1] = px + t * dx, py + t * dy
            ex, ey = ex - dx, ey - dy
            norm = math.sqrt(ex * ex + ey * ey)
            projected[m, 2], projected[m, 3] = ex / norm, ey / norm
            m += 1
        new_x, new_y, failed = _linear_program_2(projected, m, radius, -dy, dx, True)
        if failed == m:  # Otherwise only rounding stands in the way: keep the last point.
            x, y = new_x, new_y
        distance = dx * (py - y) - dy * (px - x)
    return x, y
