"""Where a predictor sees the people in view going, other than straight on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.features import HEADING_COS, HEADING_SIN
from mrsan.kernels import function
from mrsan.prediction import ConstantVelocity, Predictor, find_predictor
from mrsan.se2 import unrotate_vectors
from samarl.observations.tracker import Tracker, TrackMemory, Tracks

STRAIGHT = "constant_velocity"


class Foresight:
    """Remembers where each robot saw people lately, and asks a predictor.

    Who is out of view goes on at constant velocity, as its track does.
    """

    def __init__(self, predictor: Predictor, steps: int) -> None:
        """Predict `steps` steps ahead."""
        self.predictor, self.steps = predictor, steps
        self._straight = ConstantVelocity(float(predictor.time_step))

    def begin(self, worlds: int, robots: int, humans: int) -> None:
        """Remember nothing, of so many worlds."""
        people = worlds, robots, humans, self.predictor.history
        self._past = np.zeros((*people, 2), np.float32)
        self._known = np.zeros(people, np.bool_)

    def update(
        self, ego: NDArray[np.float32], memory: TrackMemory, is_init: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """By how much people will be elsewhere than at constant velocity, [E, N, M, 1 + K, 2] in m.

        After 0..K steps, in the body frames of now.

        Args:
            ego: [E, N, 11].
            memory: the tracks, after they took in what is seen now.
            is_init: [E] the worlds in which an episode begins.
        """
        self._known[is_init] = False
        self._past[..., :-1, :] = self._past[..., 1:, :].copy()
        self._known[..., :-1] = self._known[..., 1:].copy()
        seen = memory.human_age == 0
        self._past[..., -1, :], self._known[..., -1] = memory.humans[..., :2], seen
        known = self._past, self._known, memory.humans[..., 2:4], self.steps
        aside = self.predictor.predict(*known) - self._straight.predict(*known)
        heading = np.stack([ego[..., HEADING_COS], ego[..., HEADING_SIN]], -1)[:, :, None, None]
        found = np.zeros((*seen.shape, 1 + self.steps, 2), np.float32)
        found[..., 1:, :] = np.where(
            seen[..., None, None], unrotate_vectors(aside, heading), np.float32(0.0)
        )
        return found


def straight_on(known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """What `Foresight.update` says of people [E, N, M] who all go on at constant velocity."""
    return np.zeros((*known.shape, 1, 2), np.float32)


class Lookout:
    """Whom the robots of E worlds know of, and where a predictor sees them going."""

    def __init__(
        self, scenario: Scenario, track_time: float, predictor: str, horizon: float, field: str
    ) -> None:
        """Know of nobody yet.

        Args:
            scenario: the task.
            track_time: for how long those out of view are remembered, s.
            predictor: its name or its file.
            horizon: how far ahead it predicts, s.
            field: that holds the predictor, for errors.

        Raises:
            ConfigurationError: there is no such predictor.
        """
        self.scenario = scenario
        self._tracker = Tracker(track_time, scenario.time_step)
        self._foresight = None
        if predictor != STRAIGHT:
            found = find_predictor(predictor, scenario.time_step, field)
            self._foresight = Foresight(found, scenario.steps(horizon))
        self._begin(0)

    def _begin(self, worlds: int) -> None:
        s = self.scenario
        self._tracks = self._tracker.initial(worlds, s.robots, s.humans)
        if self._foresight:
            self._foresight.begin(worlds, s.robots, s.humans)
        self._is_init = np.ones(worlds, np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget what was remembered of the worlds [E] in which an episode begins."""
        if len(worlds) != len(self._is_init):
            self._begin(len(worlds))
        self._is_init |= worlds

    def update(self, observation: Observation) -> tuple[Tracks, NDArray[np.float32]]:
        """Take in what is seen; who is known, and what `Foresight.update` says of the people."""
        if len(observation.ego) != len(self._is_init):
            self._begin(len(observation.ego))
        known = self._tracker.update(observation, self._tracks, self._is_init)
        if self._foresight:
            aside = self._foresight.update(known.ego, self._tracks, self._is_init)
        else:
            aside = straight_on(known.humans_known)
        self._is_init = np.zeros(len(known.ego), np.bool_)
        return known, aside


@function
def gather_aside(known, aside, bends):
    """List what `Foresight.update` says of one robot's people [M, K, 2] as rows of `gather` do.

    Row 0 is the robot itself; the rows after the people, of robots, are zero. Returns the first of
    these.
    """
    count = 1
    for j in range(known.shape[0]):
        if known[j]:
            for k in range(aside.shape[1]):
                for axis in range(2):
                    bends[count, k, axis] = aside[j, k, axis]
            count += 1
    bends[count:] = np.float32(0.0)
    return count
