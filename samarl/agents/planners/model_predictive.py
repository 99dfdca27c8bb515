"""Sampling model-predictive planner with predicted motion of the people in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.fields import setting
from samarl.agents.agent import Agent
from samarl.planning.offset_predictor import CONSTANT_VELOCITY, OffsetPredictor, zero_offset
from samarl.planning.sampling import Plans, first_action


@dataclass
class ModelPredictive(Plans, Agent):
    """Simulates the robot under a fixed set of plans and executes the cheapest."""

    predictor: str = setting(
        CONSTANT_VELOCITY, help="predictor of the people in view: a name or a weights file"
    )

    def __post_init__(self) -> None:
        """Load the predictor.

        Raises:
            ConfigurationError: there is no such predictor, or a number is out of range.
        """
        super().__post_init__()
        self._offsets: OffsetPredictor | None = None
        if self.predictor != CONSTANT_VELOCITY:
            self._offsets = OffsetPredictor(
                self.scenario, self.predictor, self.horizon, "agent.predictor"
            )

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the position history of the worlds [E] in which an episode begins."""
        if self._offsets:
            self._offsets.reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the first action of the cheapest plan."""
        offset = (
            self._offsets.update(observation)
            if self._offsets
            else zero_offset(observation.humans_visible)
        )
        return first_action(self, observation, self.scenario, offset)
