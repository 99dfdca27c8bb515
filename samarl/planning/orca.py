"""ORCA for robots: each agent is expected to take half of the responsibility for avoidance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.fields import required
from mrsan.kernels import kernel
from mrsan.kernels.obstacle_orca import near_walls, wall_lines
from mrsan.kernels.orca import allocate_orca_scratch, orca_velocity
from mrsan.kernels.walls import WALL_ROWS
from mrsan.parameters import kernel_parameters
from samarl.observations.route import next_point
from samarl.planning.velocity_control import (
    TURN_IN_PLACE_ANGLE,
    gather_rows,
    preferred_velocity,
    track_velocity,
)
from samarl.planning.walls import gather_walls, seen_walls

_ZERO = np.float32(0.0)

# By which robots keep farther from walls than their radius, as they cannot turn at once, m (chosen
# on validation cases).
WALL_MARGIN = np.float32(0.05)


@dataclass
class OrcaParameters:
    """Parameters of optimal reciprocal collision avoidance (van den Berg et al., 2011)."""

    neighbor_distance: float = required(
        0.1, 1000.0, unit="m", help="agents farther away are ignored"
    )
    max_neighbors: int = required(1, 80, help="largest number of the nearest agents considered")
    time_horizon: float = required(
        0.01, 100.0, unit="s", help="time for which the velocity must be safe"
    )
    safety_space: float = required(0.0, 5.0, unit="m", help="margin added to every radius")


def orca_actions(
    parameters: OrcaParameters, observation: Observation, scenario: Scenario
) -> NDArray[np.float32]:
    """Return the actions [E, N, A] that track every robot's ORCA velocity within its limits."""
    worlds, robots = observation.ego.shape[:2]
    action = np.empty((worlds, robots, scenario.action_size), np.float32)
    _orca(
        worlds,
        *observation.agents,
        *seen_walls(observation),
        np.ascontiguousarray(next_point(observation)),
        kernel_parameters(scenario),
        np.float32(parameters.neighbor_distance),
        parameters.max_neighbors,
        np.float32(parameters.time_horizon),
        np.float32(parameters.safety_space),
        action,
    )
    return action


@kernel
def _orca(
    first,
    last,
    ego,
    humans,
    humans_visible,
    robots,
    robots_visible,
    segments,
    segments_visible,
    targets,
    p,
    neighbor_distance,
    max_neighbors,
    time_horizon,
    safety_space,
    action,
):
    rows, scratch = allocate_orca_scratch(1 + humans.shape[2] + robots.shape[2])
    walls = np.empty((WALL_ROWS, segments.shape[2] + 1), np.float32)
    for e in range(first, last):
        for i in range(ego.shape[1]):
            count = gather_rows(
                ego[e, i],
                humans[e, i],
                humans_visible[e, i],
                robots[e, i],
                robots_visible[e, i],
                safety_space,
                safety_space,
                rows,
            )
            seen = gather_walls(segments[e, i], segments_visible[e, i], walls)
            horizon = p.time_horizon_obstacles
            radius = p.robot_radius + WALL_MARGIN
            near_walls(walls, seen, _ZERO, _ZERO, horizon * p.robot_speed + radius, scratch)
            wall_lines(walls, _ZERO, _ZERO, rows[0, 2], rows[0, 3], radius, horizon, scratch)
            preferred_x, preferred_y = preferred_velocity(targets[e, i], p)
            vx, vy = orca_velocity(
                rows,
                count,
                0,
                preferred_x,
                preferred_y,
                p.robot_speed,
                neighbor_distance,
                max_neighbors,
                time_horizon,
                p.time_step,
                scratch,
                scratch.wall_counts[1],
            )
            speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
            # Near walls there is no room for a turn on the way: it turns in place.
            turn = p.max_turn if scratch.wall_counts[1] > 0 else TURN_IN_PLACE_ANGLE
            track_velocity(vx, vy, speed, action[e, i], p, turn)
