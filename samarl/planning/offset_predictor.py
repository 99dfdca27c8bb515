"""Predicted offsets of people from constant-velocity motion, for the motion-primitive planner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.features import HEADING_COS, HEADING_SIN
from mrsan.kernels import function
from mrsan.prediction import ConstantVelocity, checked_prediction, find_predictor
from mrsan.se2 import unrotate_vectors
from samarl.observations.tracker import EpisodeTracks

CONSTANT_VELOCITY = "constant_velocity"  # the predictor whose offsets are all zero


class OffsetPredictor:
    """Keeps the recent positions of everybody that robots see and runs a predictor on them.

    People out of view have no offset: they move at constant velocity, as their tracks do.
    """

    def __init__(self, scenario: Scenario, predictor: str, horizon: float, field: str) -> None:
        """Start without positions.

        Args:
            scenario: the task.
            predictor: a registered name or a file of weights.
            horizon: how far ahead it predicts, s.
            field: name of the field that holds the predictor, for error messages.

        Raises:
            ConfigurationError: there is no such predictor.
        """
        self.predictor = find_predictor(predictor, scenario.time_step, field)
        self.steps = scenario.steps(horizon)
        self._constant_velocity = ConstantVelocity(scenario.time_step)
        self._tracks = EpisodeTracks(scenario, 0.0)
        self._pairs = scenario.robots, scenario.humans
        self._begin(0)

    def _begin(self, worlds: int) -> None:
        shape = worlds, *self._pairs, self.predictor.history
        self._history = np.zeros((*shape, 2), np.float32)
        self._history_mask = np.zeros(shape, np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the positions in the worlds [E] in which an episode begins."""
        self._tracks.reset(worlds)
        if len(worlds) != len(self._history):
            self._begin(len(worlds))
        self._history_mask[worlds] = False

    def update(self, observation: Observation) -> NDArray[np.float32]:
        """Append the current positions and return the predicted offsets, [E, N, M, 1 + K, 2] in m.

        Entry k is the predicted position after k steps minus the constant-velocity position, in the
        current body frames.
        """
        if len(observation.ego) != len(self._history):
            self._begin(len(observation.ego))
        self._tracks.update(observation)
        ego, memory = observation.ego, self._tracks.memory
        self._history[..., :-1, :] = self._history[..., 1:, :].copy()
        self._history_mask[..., :-1] = self._history_mask[..., 1:].copy()
        visible = memory.human_age == 0
        self._history[..., -1, :], self._history_mask[..., -1] = memory.humans[..., :2], visible
        inputs = self._history, self._history_mask, memory.humans[..., 2:4], self.steps
        predicted = checked_prediction(self.predictor, *inputs)
        world_offset = predicted - self._constant_velocity.predict(*inputs)
        heading = np.stack([ego[..., HEADING_COS], ego[..., HEADING_SIN]], -1)[:, :, None, None]
        offset = np.zeros((*visible.shape, 1 + self.steps, 2), np.float32)
        body_offset = unrotate_vectors(world_offset, heading)
        offset[..., 1:, :] = np.where(visible[..., None, None], body_offset, np.float32(0.0))
        return offset


def zero_offset(humans_known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the offsets of constant-velocity motion for people [E, N, M]: [E, N, M, 1, 2]."""
    return np.zeros((*humans_known.shape, 1, 2), np.float32)


@function
def gather_offsets(humans_known, predicted_offset, row_offset):
    """Copy the offsets [M, K, 2] of one robot's people in the row order of `gather_rows`.

    Row 0 is the robot itself; it and the rows of other robots are zero.
    """
    count = 1
    for j in range(humans_known.shape[0]):
        if humans_known[j]:
            for k in range(predicted_offset.shape[1]):
                for axis in range(2):
                    row_offset[count, k, axis] = predicted_offset[j, k, axis]
            count += 1
    row_offset[count:] = np.float32(0.0)
