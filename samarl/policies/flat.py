"""One level: the same encoder, which drives straight to the goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from samarl.encoders import Encoder
from samarl.observations.frames import Frames
from samarl.policies.heads import Gaussian
from samarl.policies.policy import (
    LOCAL,
    POLICIES,
    TOLD,
    Known,
    Level,
    Networks,
    Policy,
    PolicyConfig,
    State,
)

# It sets out moving forward, and explores speed and turning more than sideways acceleration.
MEAN = {2: (0.0, 0.0), 3: (0.3, 0.0, 0.0)}
STD = {2: (0.5, 0.5), 3: (0.37, 0.1, 0.5)}


@dataclass
class FlatConfig(PolicyConfig):
    """Numbers of a policy of one level."""


@POLICIES.register("flat", FlatConfig)
class FlatPolicy(Policy):
    """A Gaussian of the local action on Y."""

    def _make_networks(self, encoder: Encoder) -> Networks:
        n = self.action_size
        head = Gaussian(encoder.features, self.config.hidden, MEAN[n], STD[n])
        return Networks(encoder, {LOCAL: head})

    def _decide(
        self, scene: Any, ego: Tensor, rows: Tensor, known: Known, state: State, explore: bool
    ) -> tuple[dict[str, Level], Tensor, Tensor, Tensor]:
        told = torch.zeros(*known.active.shape, TOLD)
        return {}, told, *self._ask(LOCAL, scene, ego, None, rows)

    def _choices(
        self, scene: Any, ego: Tensor, rows: Tensor, told: Tensor, asked: Mapping[str, Tensor]
    ) -> dict[str, tuple[Tensor, Tensor]]:
        return {LOCAL: self._ask(LOCAL, scene, ego, None, rows)}

    def drive_alone(
        self, frames: Frames, ego: Tensor, aim: Tensor, begins: Tensor, state: State
    ) -> Tensor:
        """See `Policy.drive_alone`."""
        scene, row = self._seen_alone(frames, begins, state), torch.zeros(1, dtype=torch.long)
        mean, _ = self._ask(LOCAL, scene, frames.ego[:, 0], None, row)
        return mean
