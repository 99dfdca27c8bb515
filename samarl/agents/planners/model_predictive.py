"""A sampling model-predictive planner with constant-velocity prediction of those in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from samarl.agents.agent import Agent
from samarl.planning.sampling import Plans, first_action


@dataclass
class ModelPredictive(Plans, Agent):
    """Simulates its own dynamics under a fixed set of plans and takes the cheapest."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The first action of the cheapest plan."""
        return first_action(self, observation.known, self.scenario)
