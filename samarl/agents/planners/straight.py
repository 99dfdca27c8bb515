"""Planner that drives straight to the goal and ignores everybody."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.features import GOAL, VELOCITY_X, VELOCITY_Y
from mrsan.kernels import kernel
from mrsan.parameters import kernel_parameters
from samarl.agents.agent import Agent
from samarl.planning.velocity_control import track_velocity


@dataclass
class Straight(Agent):
    """Turns to the goal and drives there at full speed."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Drive towards the goal."""
        return drive_towards(observation, observation.ego[..., GOAL], self.scenario)


def drive_towards(
    observation: Observation, targets: NDArray[np.float32], scenario: Scenario
) -> NDArray[np.float32]:
    """Return the actions [E, N, A] that drive each robot at full speed towards a point."""
    ego = observation.ego
    action = np.empty((*ego.shape[:2], scenario.action_size), np.float32)
    _drive_towards(
        ego.shape[0], ego, np.ascontiguousarray(targets), kernel_parameters(scenario), action
    )
    return action


@kernel
def _drive_towards(first, last, ego, targets, p, action):
    for e in range(first, last):
        for i in range(ego.shape[1]):
            x, y = targets[e, i, 0], targets[e, i, 1]
            scale = p.robot_speed / max(np.sqrt(x * x + y * y), np.float32(1e-6))
            speed = np.sqrt(ego[e, i, VELOCITY_X] ** 2 + ego[e, i, VELOCITY_Y] ** 2)
            track_velocity(x * scale, y * scale, speed, action[e, i], p)
