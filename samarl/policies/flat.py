"""One level: the same encoder, and a head that drives straight to the goal."""

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
    Networks,
    PolicyConfig,
    PolicyState,
    PolicyStep,
)
from samarl.policies.stochastic import ExplorationNoise, StochasticPolicy

# Initial means and deviations: robots move forward, and explore speed and turning more than
# lateral acceleration.
MEAN = {2: (0.0, 0.0), 3: (0.3, 0.0, 0.0)}
STD = {2: (0.5, 0.5), 3: (0.37, 0.1, 0.5)}


@dataclass
class FlatConfig(PolicyConfig):
    """Numbers of a policy of one level."""


@POLICIES.register("flat", FlatConfig)
class FlatPolicy(StochasticPolicy):
    """A Gaussian over local actions, read from the scene with the robot's own state."""

    def _make_networks(self, encoder: Encoder) -> Networks:
        n = self.action_size
        head = Gaussian(encoder.features, self.config.hidden, MEAN[n], STD[n])
        return Networks(encoder, {LOCAL: head})

    def step(
        self,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None = None,
    ) -> tuple[PolicyStep, PolicyState]:
        """See `StochasticPolicy.step`."""
        scene = self._encode(features, is_init, state)
        rows = torch.arange(len(is_init), device=is_init.device)
        embedding = self._embedding(scene, features.ego[:, 0], rows)
        distribution = self.distribution(LOCAL, embedding, rows)
        mean, local, previous, current = self._sample_local(distribution, is_init, state, noise)
        step = PolicyStep(
            action=local.action.clamp(-1.0, 1.0),
            mean=mean,
            levels={LOCAL: local},
            previous_noise=previous,
            scene=scene,
        )
        return step, {**state, "noise": current}

    def _embeddings(
        self,
        scene: Any,
        ego: Tensor,
        rows: Tensor,
        waypoint_features: Tensor | None,
        decision_indices: Mapping[str, Tensor],
    ) -> dict[str, Tensor]:
        return {LOCAL: self._embedding(scene, ego, rows)}
