"""People who react to robots and walk in groups: the functions that kernels call instead.

Without reactions and groups none of this is compiled into the step, see `mrsan.crowds.step_kernel`.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.groups import (
    CENTRE_X,
    CENTRE_Y,
    draw_group,
    group_velocity,
    offset_in_circle,
    size_of_group,
    talking_radius,
    talks,
)
from mrsan.kernels.habits import place_beside
from mrsan.kernels.layout import CIRCLE, widened
from mrsan.kernels.people import walk_to_goals
from mrsan.kernels.reactions import IMPASSIVE, draw_reaction, react
from mrsan.kernels.sensing import always_in_sight
from mrsan.kernels.social_state import ELAPSED, GROUP, NO_GROUP, REACTION
from mrsan.kernels.spawn import MOST_ATTEMPTS, NOT_PLACED, draw_traits, has_room, place_on_floor
from mrsan.kernels.walled import is_in_sight, walk_along_routes
from mrsan.kernels.walled_spawn import place_human_in_zone

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_TWO_PI = np.float32(2.0 * math.pi)


class _World(NamedTuple):
    """What `social_velocity` needs besides the arguments of a crowd model."""

    settings: Any  # those of `mrsan.crowds.social_settings`
    state: Any
    e: int
    present: Any  # numbers of the people who are present
    crowd_velocity: Any  # the crowd model
    in_sight: Any  # whether no wall hides one point from another


@function
def walk_socially(
    state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
):
    """Choose the velocities of social people; arguments as in `people.walk_to_goals`."""
    world = _World(settings, state, e, present, crowd_velocity, always_in_sight)
    walk_to_goals(
        state, e, p, world, recording, present, agents, velocities, scratch, social_velocity
    )


@function
def walk_socially_past_walls(
    state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
):
    """Choose the velocities of social people among walls, likewise."""
    world = _World(settings, state, e, present, crowd_velocity, is_in_sight)
    walk_along_routes(
        state, e, p, world, recording, present, agents, velocities, scratch, social_velocity
    )


@function
def social_velocity(agents, count, i, preferred_x, preferred_y, max_speed, p, world, scratch):
    """Return the next velocity of person `i` by the crowd model of `world`.

    The group and the reaction of the person change the preferred velocity and the agents whom the
    crowd model avoids. Arguments as in `mrsan.crowds.register_crowd`; `world` is a `_World`.
    """
    state, e, present = world.state, world.e, world.present
    settings, crowd_velocity = world.settings, world.crowd_velocity
    j, people = present[i], present.shape[0]
    if state.human_social[e, j, GROUP] != NO_GROUP:
        preferred_x, preferred_y = group_velocity(
            state, e, j, present, preferred_x, preferred_y, max_speed, p, settings
        )
    preferred_x, preferred_y, max_speed, avoids_robots = react(
        state, e, j, preferred_x, preferred_y, max_speed, p, settings, world.in_sight
    )
    _set_margins(state, e, j, present, agents, True)
    if state.human_social[e, j, REACTION] == IMPASSIVE:
        for row in range(people, count):
            agents[row, 2] = agents[row, 3] = _ZERO
    vx, vy = crowd_velocity(
        agents,
        count if avoids_robots else people,
        i,
        preferred_x,
        preferred_y,
        max_speed,
        p,
        settings,
        scratch,
    )
    for row in range(people, count):
        agents[row, 2] = state.robot_velocity[e, row - people, 0]
        agents[row, 3] = state.robot_velocity[e, row - people, 1]
    _set_margins(state, e, j, present, agents, False)
    return vx, vy


@function
def _set_margins(state, e, j, present, agents, decides):
    """Set the margin round the other members of the group of human `j`.

    While `j` decides it cancels the margin of `j` itself, as members come closer than others.
    """
    social = state.human_social[e]
    if social[j, GROUP] == NO_GROUP:
        return
    for row in range(present.shape[0]):
        k = present[row]
        if k != j and social[k, GROUP] == social[j, GROUP]:
            margin = -state.human_space[e, j] if decides else state.human_space[e, k]
            agents[row, 4] = state.human_radius[e, k] + margin


@function
def _begin_person(state, e, j, key, settings):
    """Draw the reaction and the group of human `j`, and forget those of the last episode."""
    social = state.human_social[e]
    if j == 0:
        for k in range(social.shape[0]):
            social[k, REACTION], social[k, ELAPSED], social[k, GROUP] = 0, 0, NO_GROUP
    draw_reaction(social, j, key, settings)
    draw_group(social, j, key, settings)


@function
def place_reacting_in_zone(state, e, j, key, layout, p, settings, occupied, candidates, marked):
    """Draw the start of human `j` among walls, as `walled_spawn.place_human_in_zone`."""
    _begin_person(state, e, j, key, settings)
    return place_human_in_zone(state, e, j, key, layout, p, settings, occupied, candidates, marked)


@function
def place_in_group(state, e, j, key, layout, p, settings, occupied, candidates, marked):
    """Draw the start of human `j`, alone or in a group, as `spawn.place_on_floor`."""
    _begin_person(state, e, j, key, settings)
    group = state.human_social[e, j, GROUP]
    if group != NO_GROUP and talks(key, group, settings):
        draw_traits(state, e, j, key, p)
        placed = _place_in_circle(state, e, j, key, group, layout, p, settings)
        return marked if placed else NOT_PLACED
    if group in (NO_GROUP, j):
        return place_on_floor(state, e, j, key, layout, p, settings, occupied, candidates, marked)
    draw_traits(state, e, j, key, p)
    state.human_speed[e, j] = state.human_speed[e, group]
    position, goal = state.human_position[e], state.human_goal[e]
    for attempt in range(MOST_ATTEMPTS):
        place_beside(position, goal, state.human_radius[e], j, key, attempt)
        if has_room(state, e, j, j - 1, p):
            goal[j, 0], goal[j, 1] = goal[group, 0], goal[group, 1]
            return marked
    return NOT_PLACED


@function
def _place_in_circle(state, e, j, key, group, layout, p, settings):
    """Place human `j` in a circle of people who talk; return success.

    The first member draws a centre where all have room and that is clear of the robots' goals.
    """
    position, goal = state.human_position[e], state.human_goal[e]
    size = size_of_group(key, group, position.shape[0], settings)
    radius = talking_radius(size, p, settings)
    first_x, first_y = offset_in_circle(key, group, 0, size, radius)
    placed = True
    if j == group:
        placed = False
        for attempt in range(MOST_ATTEMPTS):
            x, y = _draw_centre(key, group, attempt, layout, p)
            if _is_clear(state, e, j, x, y, radius, p):
                position[j, 0], position[j, 1], placed = x + first_x, y + first_y, True
                break
    else:
        dx, dy = offset_in_circle(key, group, j - group, size, radius)
        position[j, 0] = position[group, 0] - first_x + dx
        position[j, 1] = position[group, 1] - first_y + dy
    goal[j, 0], goal[j, 1] = position[j, 0], position[j, 1]
    return placed


@function
def _draw_centre(key, group, attempt, layout, p):
    """Draw the centre of a group that talks: inside the circle of starts, or on the floor."""
    share_x = rng.uniform(key, rng.GROUP, group, attempt, CENTRE_X)
    share_y = rng.uniform(key, rng.GROUP, group, attempt, CENTRE_Y)
    if layout == CIRCLE:
        away, angle = widened(p.circle_radius, attempt) * math.sqrt(share_x), _TWO_PI * share_y
        return away * math.cos(angle), away * math.sin(angle)
    side = widened(p.floor_size, attempt)
    return side * (share_x - _HALF), side * (share_y - _HALF)


@function
def _is_clear(state, e, j, x, y, radius, p):
    """Return whether a circle of people round (x, y) is clear of robots, goals and others."""
    outer = radius + p.human_radius_max + p.spawn_clearance
    start, goal, apart = state.robot_position[e], state.robot_goal[e], outer + 2 * p.robot_radius
    for i in range(start.shape[0]):
        dx, dy = start[i, 0] - x, start[i, 1] - y
        to_goal_x, to_goal_y = goal[i, 0] - x, goal[i, 1] - y
        nearest = min(dx * dx + dy * dy, to_goal_x * to_goal_x + to_goal_y * to_goal_y)
        if nearest < apart * apart:
            return False
    for k in range(j):
        dx, dy = state.human_position[e, k, 0] - x, state.human_position[e, k, 1] - y
        gap = outer + state.human_radius[e, k]
        if dx * dx + dy * dy < gap * gap:
            return False
    return True
