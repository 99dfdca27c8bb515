"""ORCA as a robot planner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from samarl.agents.agent import Agent
from samarl.planning.orca import OrcaParameters, orca_actions


@dataclass
class Orca(OrcaParameters, Agent):
    """Optimal reciprocal collision avoidance (van den Berg et al., 2011) of everybody in view."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the actions that track the ORCA velocity within the robot's limits."""
        return orca_actions(self, observation, self.scenario)
