"""Planner that drives around the crowd without looking: to a circle, along it, to the goal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.fields import required
from samarl.agents.agent import Agent
from samarl.agents.planners.straight import drive_towards
from samarl.observations.route import perimeter_route


@dataclass
class Perimeter(Agent):
    """Uses only the robot's position and goal; all robots drive around in the same direction."""

    radius: float = required(0.5, 1000.0, unit="m", help="radius of the circle around the crowd")
    lookahead: float = required(
        0.01, 3.0, unit="rad", help="angle on the circle to the target point"
    )
    entry_angle: float = required(
        0.01, 3.0, unit="rad", help="angle to the goal's bearing below which it turns in"
    )

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Drive towards the next point of the route around the crowd."""
        targets = perimeter_route(observation.ego, self.radius, self.lookahead, self.entry_angle)
        return drive_towards(observation, targets, self.scenario)
