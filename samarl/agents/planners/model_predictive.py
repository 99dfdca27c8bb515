"""A sampling model-predictive planner with a prediction of those in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.fields import setting
from samarl.agents.agent import Agent
from samarl.planning.foresight import STRAIGHT, Lookout, straight_on
from samarl.planning.sampling import Plans, first_action


@dataclass
class ModelPredictive(Plans, Agent):
    """Simulates its own dynamics under a fixed set of plans and takes the cheapest."""

    predictor: str = setting(
        STRAIGHT, help="predictor of the people in view: a name or a weights file"
    )

    def __post_init__(self) -> None:
        """Find the predictor.

        Raises:
            ConfigurationError: there is none, or a number is wrong.
        """
        super().__post_init__()
        self._lookout = None
        if self.predictor != STRAIGHT:
            field = "agent.predictor"
            self._lookout = Lookout(self.scenario, 0.0, self.predictor, self.horizon, field)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget where people were in the worlds [E] in which an episode begins."""
        if self._lookout:
            self._lookout.reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The first action of the cheapest plan."""
        if self._lookout:
            _, aside = self._lookout.update(observation)
        else:
            aside = straight_on(observation.humans_visible)
        return first_action(self, observation.perception, self.scenario, aside)
