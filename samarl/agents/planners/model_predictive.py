"""Sampling model-predictive planner with predicted motion of the people in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.fields import setting
from samarl.agents.agent import Agent
from samarl.planning.sampling import Plans, first_action
from samarl.planning.track_predictor import CONSTANT_VELOCITY, TrackPredictor, zero_offset


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
        self._track_predictor: TrackPredictor | None = None
        if self.predictor != CONSTANT_VELOCITY:
            self._track_predictor = TrackPredictor(
                self.scenario, 0.0, self.predictor, self.horizon, "agent.predictor"
            )

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the position history of the worlds [E] in which an episode begins."""
        if self._track_predictor:
            self._track_predictor.reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the first action of the cheapest plan."""
        if self._track_predictor:
            _, predicted_offset = self._track_predictor.update(observation)
        else:
            predicted_offset = zero_offset(observation.humans_visible)
        return first_action(self, observation, self.scenario, predicted_offset)
