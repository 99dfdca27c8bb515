"""ORCA as a robot planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from samarl.agents.agent import Agent
from samarl.planning.orca import Avoidance, avoid


@dataclass
class Orca(Avoidance, Agent):
    """Optimal reciprocal collision avoidance (van den Berg et al., 2011) of visible agents."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The ORCA velocity, as far as the robot's limits allow it."""
        return avoid(self, observation, self.scenario)
