"""Round the crowd, blind: out to a circle, along it, and in to the goal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.scenario import required
from samarl.agents.agent import Agent
from samarl.agents.planners.straight import drive_towards


@dataclass
class Perimeter(Agent):
    """Uses nothing but the robot's own position and goal; all robots go round the same way."""

    radius: float = required(0.5, 1000.0)  # of the circle round the crowd, m
    lookahead: float = required(0.01, 3.0)  # how far ahead on the circle it aims, rad
    entry_angle: float = required(0.01, 3.0)  # it turns in when so near the goal's bearing, rad

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Towards the next point of the way round."""
        ego = observation.ego
        goal = np.arctan2(ego[..., 1] - ego[..., 5], ego[..., 0] - ego[..., 4])
        here = np.arctan2(-ego[..., 5], -ego[..., 4])  # bearings from the origin, body frame
        onward = here + np.float32(self.lookahead)
        circle = np.float32(self.radius) * np.stack([np.cos(onward), np.sin(onward)], -1)
        remaining = np.abs((goal - here + np.pi) % (2 * np.pi) - np.pi)
        turn_in = (remaining < self.entry_angle)[..., None]
        targets = np.where(turn_in, ego[..., 0:2], circle + ego[..., 4:6])
        return drive_towards(observation, targets.astype(np.float32), self.scenario)
