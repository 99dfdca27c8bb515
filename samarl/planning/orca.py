"""ORCA for robots: each agent is expected to take half of the responsibility for avoidance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.fields import required
from mrsan.kernels import kernel
from mrsan.kernels.orca import orca_room, orca_velocity
from mrsan.parameters import kernel_parameters
from samarl.planning.velocity_control import gather_rows, preferred_velocity, track_velocity


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
    chunks,
    ego,
    humans,
    humans_visible,
    robots,
    robots_visible,
    p,
    neighbor_distance,
    max_neighbors,
    time_horizon,
    safety_space,
    action,
):
    total = ego.shape[0]
    for chunk in prange(chunks):
        rows, scratch = orca_room(1 + humans.shape[2] + robots.shape[2])
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
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
                preferred_x, preferred_y = preferred_velocity(ego[e, i], p)
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
                )
                speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
                track_velocity(vx, vy, speed, action[e, i], p)
