"""The social force model as a robot planner."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.fields import required
from mrsan.kernels import kernel
from mrsan.kernels.obstacle_orca import near_walls
from mrsan.kernels.orca import allocate_orca_scratch
from mrsan.kernels.social_force import social_force_velocity
from mrsan.kernels.walls import WALL_ROWS
from mrsan.parameters import kernel_parameters
from samarl.agents.agent import Agent
from samarl.observations.route import next_point
from samarl.planning.velocity_control import gather_rows, preferred_velocity, track_velocity
from samarl.planning.walls import gather_walls, seen_walls

_WALL_RANGE = np.float32(3.0)  # m, beyond which walls push no more


@dataclass
class SocialForce(Agent):
    """Social force model (Helbing and Molnar, 1995): attracted by the goal, repelled by others."""

    relaxation_time: float = required(
        0.01, 10.0, unit="s", help="time to reach the preferred velocity"
    )
    strength: float = required(0.0, 1000.0, unit="m/s^2", help="repulsion at contact")
    reach: float = required(0.01, 10.0, unit="m", help="distance over which repulsion falls to 1/e")
    wall_strength: float = required(0.0, 1000.0, unit="m/s^2", help="repulsion of walls at contact")
    wall_reach: float = required(0.01, 10.0, unit="m", help="distance over which it falls to 1/e")

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the actions that track the social-force velocity within the robot's limits."""
        worlds, robots = observation.ego.shape[:2]
        action = np.empty((worlds, robots, self.scenario.action_size), np.float32)
        forces = map(
            np.float32,
            (
                self.relaxation_time,
                self.strength,
                self.reach,
                self.wall_strength,
                self.wall_reach,
            ),
        )
        _social_force(
            worlds,
            *observation.agents,
            *seen_walls(observation),
            np.ascontiguousarray(next_point(observation)),
            kernel_parameters(self.scenario),
            *forces,
            action,
        )
        return action


@kernel
def _social_force(
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
    relaxation_time,
    strength,
    reach,
    wall_strength,
    wall_reach,
    action,
):
    no_margin = np.float32(0.0)
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
                no_margin,
                no_margin,
                rows,
            )
            seen = gather_walls(segments[e, i], segments_visible[e, i], walls)
            near_walls(walls, seen, no_margin, no_margin, _WALL_RANGE, scratch)
            preferred_x, preferred_y = preferred_velocity(targets[e, i], p)
            vx, vy = social_force_velocity(
                rows,
                count,
                0,
                preferred_x,
                preferred_y,
                p.robot_speed,
                relaxation_time,
                strength,
                reach,
                wall_strength,
                wall_reach,
                p.time_step,
                scratch,
            )
            speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
            track_velocity(vx, vy, speed, action[e, i], p)
