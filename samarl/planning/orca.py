"""ORCA for robots: everybody is expected to do half of the avoiding."""

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
from samarl.planning.tracking import gather, preferred_velocity, track_velocity


@dataclass
class Avoidance:
    """Numbers of optimal reciprocal collision avoidance (van den Berg et al., 2011)."""

    neighbor_distance: float = required(
        0.1, 1000.0, unit="m", help="agents farther away are ignored"
    )
    max_neighbors: int = required(1, 80, help="largest number of neighbours considered")
    time_horizon: float = required(
        0.01, 100.0, unit="s", help="time for which velocities are free of collisions"
    )
    safety_space: float = required(0.0, 5.0, unit="m", help="margin added to every radius")


def avoid(numbers: Avoidance, observation: Observation, scenario: Scenario) -> NDArray[np.float32]:
    """The action [E, N, A] nearest to every robot's ORCA velocity, within its limits."""
    worlds, robots = observation.ego.shape[:2]
    action = np.empty((worlds, robots, scenario.action_size), np.float32)
    _orca(
        worlds,
        *observation.perception,
        kernel_parameters(scenario),
        np.float32(numbers.neighbor_distance),
        numbers.max_neighbors,
        np.float32(numbers.time_horizon),
        np.float32(numbers.safety_space),
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
                count = gather(
                    ego[e, i],
                    humans[e, i],
                    humans_visible[e, i],
                    robots[e, i],
                    robots_visible[e, i],
                    safety_space,
                    safety_space,
                    rows,
                )
                wanted_x, wanted_y = preferred_velocity(ego[e, i], p)
                vx, vy = orca_velocity(
                    rows,
                    count,
                    0,
                    wanted_x,
                    wanted_y,
                    p.robot_speed,
                    neighbor_distance,
                    max_neighbors,
                    time_horizon,
                    p.time_step,
                    scratch,
                )
                speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
                track_velocity(vx, vy, speed, action[e, i], p)
