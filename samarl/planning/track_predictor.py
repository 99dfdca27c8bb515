"""Predicted offsets of people from constant-velocity motion, for planners and the shield."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.features import HEADING_COS, HEADING_SIN
from mrsan.kernels import function
from mrsan.prediction import ConstantVelocity, Predictor, checked_prediction, find_predictor
from mrsan.se2 import unrotate_vectors
from samarl.observations.tracker import Tracker, TrackMemory

CONSTANT_VELOCITY = "constant_velocity"  # the predictor whose offsets are all zero


class OffsetPredictor:
    """Keeps the recent positions of everybody a robot sees and runs a predictor on them.

    People out of view have no offset: they move at constant velocity, as their tracks do.
    """

    def __init__(self, predictor: Predictor, steps: int) -> None:
        """Predict `steps` steps ahead."""
        self.predictor, self.steps = predictor, steps
        self._constant_velocity = ConstantVelocity(float(predictor.time_step))

    def initialize(self, worlds: int, robots: int, humans: int) -> None:
        """Allocate an empty history for that many worlds, robots and humans."""
        shape = worlds, robots, humans, self.predictor.history
        self._history = np.zeros((*shape, 2), np.float32)
        self._history_mask = np.zeros(shape, np.bool_)

    def update(
        self, ego: NDArray[np.float32], memory: TrackMemory, is_init: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Append the current positions and return the predicted offsets, [E, N, M, 1 + K, 2] in m.

        Entry k is the predicted position after k steps minus the constant-velocity position, in the
        current body frames.

        Args:
            ego: [E, N, 11].
            memory: the tracks, already updated with the current observation.
            is_init: [E] the worlds in which an episode begins.
        """
        self._history_mask[is_init] = False
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


class TrackPredictor:
    """Tracks everybody the robots of E worlds have seen and predicts where people in view go."""

    def __init__(
        self, scenario: Scenario, track_time: float, predictor: str, horizon: float, field: str
    ) -> None:
        """Start without tracks.

        Args:
            scenario: the task.
            track_time: how long people out of view are remembered, s.
            predictor: a registered name or a file of weights.
            horizon: how far ahead it predicts, s.
            field: name of the field that holds the predictor, for error messages.

        Raises:
            ConfigurationError: there is no such predictor.
        """
        self.scenario = scenario
        self._tracker = Tracker(track_time, scenario.time_step)
        self._offsets = None
        if predictor != CONSTANT_VELOCITY:
            self._offsets = OffsetPredictor(
                find_predictor(predictor, scenario.time_step, field), scenario.steps(horizon)
            )
        self._initialize(0)

    def _initialize(self, worlds: int) -> None:
        s = self.scenario
        self._memory = self._tracker.initial(worlds, s.robots, s.humans)
        if self._offsets:
            self._offsets.initialize(worlds, s.robots, s.humans)
        self._is_init = np.ones(worlds, np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the tracks of the worlds [E] in which an episode begins."""
        if len(worlds) != len(self._is_init):
            self._initialize(len(worlds))
        self._is_init |= worlds

    def update(self, observation: Observation) -> tuple[Observation, NDArray[np.float32]]:
        """Return the tracks after an observation and the offsets of `OffsetPredictor.update`."""
        if len(observation.ego) != len(self._is_init):
            self._initialize(len(observation.ego))
        tracks = self._tracker.update(observation, self._memory, self._is_init)
        if self._offsets:
            predicted_offset = self._offsets.update(tracks.ego, self._memory, self._is_init)
        else:
            predicted_offset = zero_offset(tracks.humans_known)
        self._is_init = np.zeros(len(tracks.ego), np.bool_)
        return tracks, predicted_offset


@function
def gather_offsets(humans_known, predicted_offset, row_offset):
    """Copy the offsets [M, K, 2] of one robot's people in the row order of `gather_rows`.

    Row 0 is the robot itself; it and the rows of other robots are zero. Returns the index of the
    first row of another robot.
    """
    count = 1
    for j in range(humans_known.shape[0]):
        if humans_known[j]:
            for k in range(predicted_offset.shape[1]):
                for axis in range(2):
                    row_offset[count, k, axis] = predicted_offset[j, k, axis]
            count += 1
    row_offset[count:] = np.float32(0.0)
    return count
