"""People who walk along given paths among simulated ones, and routes of agents that were moved."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels import function, kernel
from mrsan.kernels.zones import assign_route, remaining_route


class Paths(NamedTuple):
    """Where people walk, which kernels take in the place of a recording."""

    position: NDArray[np.float32]  # [E, M, T + 1, 2] at each step; NaN: the person is simulated


@cache
def follow_paths(choose: Any) -> Any:
    """Return `choose` (see `people.walk_to_goals`) with other velocities for people on paths."""

    @function
    def choose_velocities(
        state, e, p, settings, recording, present, agents, velocities, scratch, crowd_velocity
    ):
        choose(
            state,
            e,
            p,
            settings,
            recording,
            present,
            agents,
            velocities,
            scratch,
            crowd_velocity,
        )
        following = state.clock[e] + 1
        for row in range(present.shape[0]):
            j = present[row]
            if np.isnan(recording.position[e, j, following, 0]):
                continue
            for k in range(2):
                way = recording.position[e, j, following, k] - state.human_position[e, j, k]
                velocities[row, k] = way / p.time_step

    return choose_velocities


@kernel
def find_routes(first, last, agents, state):
    """Find the routes of agents in places with walls after they or their goals were moved.

    Args:
        first: the first world.
        last: the world after the last one.
        agents: [E, M + N] bool, which of them; people first.
        state: the worlds.
    """
    people = state.human_radius.shape[1]
    for e in range(first, last):
        for agent in range(agents.shape[1]):
            if not agents[e, agent]:
                continue
            if agent < people:
                x, y = state.human_position[e, agent, 0], state.human_position[e, agent, 1]
                goal_x, goal_y = state.human_goal[e, agent, 0], state.human_goal[e, agent, 1]
                assign_route(state, e, agent, x, y, goal_x, goal_y)
                continue
            i = agent - people
            x, y = state.robot_position[e, i, 0], state.robot_position[e, i, 1]
            goal_x, goal_y = state.robot_goal[e, i, 0], state.robot_goal[e, i, 1]
            assign_route(state, e, agent, x, y, goal_x, goal_y)
            state.route_left[e, i] = remaining_route(state, e, agent, x, y, goal_x, goal_y)
