"""Round the crowd, blind: out to a circle, along it, and in to the goal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.fields import required
from samarl.agents.agent import Agent
from samarl.agents.planners.straight import drive_towards
from samarl.observations.route import way_round


@dataclass
class Perimeter(Agent):
    """Uses nothing but the robot's own position and goal; all robots go round the same way."""

    radius: float = required(0.5, 1000.0, unit="m", help="radius of the circle round the crowd")
    lookahead: float = required(0.01, 3.0, unit="rad", help="how far ahead on the circle it aims")
    entry_angle: float = required(
        0.01, 3.0, unit="rad", help="angle to the goal's bearing at which it turns in"
    )

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Towards the next point of the way round."""
        targets = way_round(observation.ego, self.radius, self.lookahead, self.entry_angle)
        return drive_towards(observation, targets, self.scenario)
