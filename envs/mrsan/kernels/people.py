"""How people choose their next velocities: towards their goals, none at all, or as recorded.

Each function is one way for the whole crowd of a world; `mrsan.crowds` says which one a crowd
model uses, and gives `walk_to_goals` the function that decides for a single person.
"""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.kernels.habits import come_and_go, stands, walks_along
from mrsan.kernels.layout import draw_goal, layout_of
from mrsan.kernels.orca import orca_velocity
from mrsan.kernels.recorded import follow, recorded_velocity
from mrsan.kernels.social_force import social_force_velocity

# Distance over which the social force of walls falls to 1/e, m. With the range of the force between
# people nobody would pass through a door.
WALL_FORCE_RANGE = np.float32(0.1)

_ZERO = np.float32(0.0)
_TINY = np.float32(1e-6)


@function
def orca_crowd(agents, count, i, preferred_x, preferred_y, max_speed, p, settings, scratch):
    """Optimal reciprocal collision avoidance; `settings` is `mrsan.crowds.OrcaSettings`."""
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
    )


@function
def social_force_crowd(agents, count, i, preferred_x, preferred_y, max_speed, p, settings, scratch):
    """Social forces; `settings` is `mrsan.crowds.SocialForceSettings`."""
    return social_force_velocity(
        agents,
        count,
        i,
        preferred_x,
        preferred_y,
        max_speed,
        settings.relaxation_time,
        settings.force_strength,
        settings.force_range,
        settings.force_strength,
        WALL_FORCE_RANGE,
        p.time_step,
        scratch,
    )


@function
def enter_and_leave(state, e, p, recording):
    """Update which simulated people are present."""
    if p.people_come_and_go:
        come_and_go(state, e, p)


@function
def follow_recording(state, e, p, recording):
    """Update which recorded people are present."""
    follow(state, e, recording, p)


@function
def walk_to_goals(
    state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
):
    """Choose the velocities of people who walk to goals, all of them from the same state.

    Args:
        state: the worlds.
        e: which of them.
        p: the scenario's parameters.
        settings: those of the crowd model.
        recording: not used.
        present: numbers of the people who are present.
        agents: room for the rows `[px, py, vx, vy, radius]` of all agents whom people avoid.
        velocities: [M, 2], written: a row for each person present, m/s.
        scratch: room for `crowd_velocity` to work in.
        crowd_velocity: the crowd model, see `mrsan.crowds.register_crowd`.
    """
    count = list_agents(state, e, p, present, agents)
    position, goal, radius = state.human_position, state.human_goal, state.human_radius
    key, step = state.key[e], state.clock[e]
    layout = layout_of(key, p)
    goal_change_x = goal_change_y = _ZERO  # of the person before
    is_interval = step > 0 and step % p.goal_change_steps == 0
    for row in range(present.shape[0]):
        j = present[row]
        x, y, speed = position[e, j, 0], position[e, j, 1], state.human_speed[e, j]
        dx, dy = goal[e, j, 0] - x, goal[e, j, 1] - y
        renew = dx * dx + dy * dy < radius[e, j] * radius[e, j]
        renew = renew or (is_interval and changes_goal(key, j, step, p))
        old_x, old_y = goal[e, j, 0], goal[e, j, 1]
        if walks_along(key, j, p) and state.human_present[e, j - 1]:
            goal[e, j, 0], goal[e, j, 1] = old_x + goal_change_x, old_y + goal_change_y
        elif renew:
            goal[e, j, 0], goal[e, j, 1] = draw_goal(
                x, y, old_x, old_y, key, j, step, speed, layout, p
            )
        goal_change_x, goal_change_y = goal[e, j, 0] - old_x, goal[e, j, 1] - old_y
        dx, dy = goal[e, j, 0] - x, goal[e, j, 1] - y
        scale = speed / max(math.sqrt(dx * dx + dy * dy), _TINY)
        if stands(key, j, step, p):
            scale = _ZERO
        velocities[row, 0], velocities[row, 1] = crowd_velocity(
            agents, count, row, dx * scale, dy * scale, speed, p, settings, scratch
        )


@function
def changes_goal(key, j, step, p):
    """Return whether human `j` changes its goal at an interval."""
    return rng.uniform(key, rng.GOAL_CHANGE, j, step, 0) < rng.uniform_between(
        p.goal_change_probability,
        p.goal_change_probability_max,
        key,
        rng.HUMAN_TRAITS,
        j,
        0,
        2,
    )


@function
def list_agents(state, e, p, present, agents):
    """Write the rows of all agents whom people avoid, people first; return how many."""
    position, velocity = state.human_position, state.human_velocity
    robot_position, robot_velocity = state.robot_position, state.robot_velocity
    count = present.shape[0]
    for row in range(count):
        j = present[row]
        agents[row, 0], agents[row, 1] = position[e, j, 0], position[e, j, 1]
        agents[row, 2], agents[row, 3] = velocity[e, j, 0], velocity[e, j, 1]
        agents[row, 4] = state.human_radius[e, j] + state.human_space[e, j]
    if p.people_see_robots:
        for i in range(robot_position.shape[1]):
            agents[count, 0], agents[count, 1] = robot_position[e, i, 0], robot_position[e, i, 1]
            agents[count, 2], agents[count, 3] = robot_velocity[e, i, 0], robot_velocity[e, i, 1]
            agents[count, 4] = p.robot_radius + p.human_safety_space
            count += 1
    return count


@function
def stand_still(
    state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
):
    """Choose no motion; arguments as in `walk_to_goals`."""
    velocities[: present.shape[0], :] = _ZERO


@function
def walk_as_recorded(
    state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
):
    """Choose the velocities to the recorded positions; arguments as in `walk_to_goals`."""
    for row in range(present.shape[0]):
        velocities[row, 0], velocities[row, 1] = recorded_velocity(
            state, e, present[row], recording, p
        )
