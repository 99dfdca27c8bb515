"""Where a predictor sees the people in view going, other than straight on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan.features import HEADING_COS, HEADING_SIN
from mrsan.prediction import ConstantVelocity, Predictor, turned
from samarl.observations.tracker import TrackMemory


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
        back = np.stack([ego[..., HEADING_COS], -ego[..., HEADING_SIN]], -1)[:, :, None, None]
        found = np.zeros((*seen.shape, 1 + self.steps, 2), np.float32)
        found[..., 1:, :] = np.where(seen[..., None, None], turned(aside, back), np.float32(0.0))
        return found


def straight_on(known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """What `Foresight.update` says of people [E, N, M] who all go on at constant velocity."""
    return np.zeros((*known.shape, 1, 2), np.float32)
