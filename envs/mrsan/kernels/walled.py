"""What differs in places with walls: the functions that kernels call instead of the open ones.

People walk along routes, past walls and never through one; robots touch walls, and their progress
is measured along their routes.
"""

import math
from functools import cache

import numpy as np

from mrsan.kernels import function, kernel, rng
from mrsan.kernels.habits import PATIENCE, stands, walks_along
from mrsan.kernels.obstacle_orca import near_walls, wall_lines
from mrsan.kernels.orca import orca_velocity
from mrsan.kernels.people import changes_goal, list_agents
from mrsan.kernels.routes import UPDATE_EVERY
from mrsan.kernels.sensing import observe
from mrsan.kernels.walls import is_clear, sees, wall_count
from mrsan.kernels.zones import (
    draw_goal_in_zones,
    is_in_zone,
    join_goal,
    next_point,
    remaining_route,
    update_route,
)

SPACIOUS = np.float32(1.0)  # m, surface distance to a wall from which people keep all their space
SLOW = np.float32(0.2)  # m/s, below which a person who wants to walk is held up
LONGEST_PATIENCE = np.float32(4.0)  # s, after which a person who is held up turns back

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TINY = np.float32(1e-6)
_SLACK = np.float32(1e-3)  # m, by which people may come closer to a wall than their radius
_ROUNDING = np.float32(1e-5)  # m


@function
def is_in_sight(state, e, x, y, dx, dy):
    """Return whether no wall hides what is at (x + dx, y + dy) from (x, y)."""
    return sees(state.walls[e], wall_count(state.place[e]), x, y, dx, dy)


@function
def robot_touches_wall(state, e, x, y, dx, dy, p):
    """Return whether a robot that moves from (x, y) by (dx, dy) touches a wall."""
    count = wall_count(state.place[e])
    return not is_clear(state.walls[e], count, x, y, dx, dy, p.robot_radius)


@function
def progress_along_route(state, e, i, progress, p):
    """Update the route of robot `i`; return by how much its rest has become shorter, m."""
    x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
    goal_x, goal_y = state.robot_goal[e, i, 0], state.robot_goal[e, i, 1]
    agent = state.human_radius.shape[1] + i
    update_route(state, e, agent, x, y, goal_x, goal_y)
    before = state.route_left[e, i]
    state.route_left[e, i] = remaining_route(state, e, agent, x, y, goal_x, goal_y)
    return before - state.route_left[e, i]


@function
def orca_crowd_past_walls(
    agents, count, i, preferred_x, preferred_y, max_speed, p, settings, scratch
):
    """Optimal reciprocal collision avoidance, also of walls.

    Without walls `people.orca_crowd` is a hundredth faster: the compiler knows that there are none.
    """
    return orca_velocity(
        agents,
        count,
        i,
        preferred_x,
        preferred_y,
        max_speed,
        settings.neighbor_distance,
        settings.max_neighbors,
        settings.time_horizon,
        p.time_step,
        scratch,
        scratch.wall_counts[1],
    )


@function
def walk_along_routes(
    state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
):
    """Choose the velocities of people among walls; arguments as in `people.walk_to_goals`.

    So that people do not jam in doors and corridors, they keep their goals while they pass through,
    come closer to each other near walls, and turn back when they have been held up for too long.
    """
    count = list_agents(state, e, p, present, agents)
    position, goal = state.human_position, state.human_goal
    key, step = state.key[e], state.clock[e]
    is_interval = step > 0 and step % p.goal_change_steps == 0
    goal_changed = False  # of the person before
    for row in range(present.shape[0]):
        j = present[row]
        x, y, speed = position[e, j, 0], position[e, j, 1], state.human_speed[e, j]
        old_x, old_y = goal[e, j, 0], goal[e, j, 1]
        dx, dy = old_x - x, old_y - y
        renew = dx * dx + dy * dy < state.human_radius[e, j] * state.human_radius[e, j]
        if is_interval and is_in_zone(state, e, x, y):
            renew = renew or changes_goal(key, j, step, p)
        turns_back = _loses_patience(state, e, j, key, step, p)
        if walks_along(key, j, p) and state.human_present[e, j - 1]:
            if goal_changed:
                join_goal(state, e, j)
        elif renew or turns_back:
            if not draw_goal_in_zones(state, e, j, key, step, turns_back, p):
                goal[e, j, 0], goal[e, j, 1] = old_x, old_y
        goal_changed = goal[e, j, 0] != old_x or goal[e, j, 1] != old_y
        if (step + j) % UPDATE_EVERY == 0:
            update_route(state, e, j, x, y, goal[e, j, 0], goal[e, j, 1])
        to_x, to_y = next_point(state, e, j, goal[e, j, 0], goal[e, j, 1])
        dx, dy = to_x - x, to_y - y
        scale = speed / max(math.sqrt(dx * dx + dy * dy), _TINY)
        if stands(key, j, step, p):
            scale = _ZERO
        _list_near_walls(state, e, j, p, scratch)
        _update_space(state, e, j, p, scratch)
        velocities[row, 0], velocities[row, 1] = crowd_velocity(
            agents, count, row, dx * scale, dy * scale, speed, p, settings, scratch
        )
        if _is_near_wall(state, e, j, p, scratch):
            avoid_walls(state, e, j, p, velocities[row], scratch)


@function
def _list_near_walls(state, e, j, p, scratch):
    """Write the walls near human `j`, and their ORCA lines, into `scratch`."""
    x, y = state.human_position[e, j, 0], state.human_position[e, j, 1]
    vx, vy = state.human_velocity[e, j, 0], state.human_velocity[e, j, 1]
    radius, horizon = state.human_radius[e, j], p.time_horizon_obstacles
    reach = horizon * state.human_speed[e, j] + radius
    near_walls(state.walls[e], wall_count(state.place[e]), x, y, reach, scratch)
    wall_lines(state.walls[e], x, y, vx, vy, radius, horizon, scratch)


@function
def _update_space(state, e, j, p, scratch):
    """Set the space that human `j` keeps from the next step on: none at a wall."""
    share = _ONE
    if scratch.wall_counts[0] > 0:
        gap = math.sqrt(scratch.wall_distances[0]) - state.human_radius[e, j]
        share = min(max(gap / SPACIOUS, _ZERO), _ONE)
    state.human_space[e, j] = share * p.human_safety_space


@function
def _loses_patience(state, e, j, key, step, p):
    """Count the steps for which human `j` has been held up; return whether it turns back."""
    vx, vy = state.human_velocity[e, j, 0], state.human_velocity[e, j, 1]
    if vx * vx + vy * vy >= SLOW * SLOW or stands(key, j, step, p):
        state.human_held_up[e, j] = 0
        return False
    state.human_held_up[e, j] += 1
    share = rng.uniform(key, rng.HABITS, j, step, PATIENCE)
    patience = LONGEST_PATIENCE * (_HALF + _HALF * share)
    if np.float32(state.human_held_up[e, j]) * p.time_step < patience:
        return False
    state.human_held_up[e, j] = 0
    return True


@function
def _is_near_wall(state, e, j, p, scratch):
    """Return whether human `j` could reach one of the near walls in this step."""
    if scratch.wall_counts[0] == 0:
        return False
    reach = state.human_radius[e, j] + state.human_speed[e, j] * p.time_step
    return scratch.wall_distances[0] < reach * reach


@function
def avoid_walls(state, e, j, p, velocity, scratch):
    """Change a velocity of human `j` that would lead into a wall: along the wall, or to a stop."""
    walls, count = state.walls[e], wall_count(state.place[e])
    x, y, dt = state.human_position[e, j, 0], state.human_position[e, j, 1], p.time_step
    radius = state.human_radius[e, j] - _SLACK
    distance = math.sqrt(scratch.wall_distances[0])
    radius = min(radius, distance - _ROUNDING)
    if is_clear(walls, count, x, y, velocity[0] * dt, velocity[1] * dt, radius):
        return
    if distance > _ZERO:
        away_x = (x - scratch.wall_points[0, 0]) / distance
        away_y = (y - scratch.wall_points[0, 1]) / distance
        into = min(velocity[0] * away_x + velocity[1] * away_y, _ZERO)
        velocity[0] -= into * away_x
        velocity[1] -= into * away_y
        if is_clear(walls, count, x, y, velocity[0] * dt, velocity[1] * dt, radius):
            return
    velocity[0] = velocity[1] = _ZERO


@cache
def observe_past_walls() -> kernel:
    """Return the kernel that observes the agents that no wall hides."""
    return observe.variant("walled", is_in_sight=is_in_sight)
