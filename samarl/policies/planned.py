"""One level and a planner together: a mixture of what both would do.

As in residual policy learning (Silver et al., 2018; Johannink et al., 2019) a policy begins with
what a planner can do; but here it also learns where to trust it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from samarl.encoders import Encoder
from samarl.planning.sampling import Plans, first_action
from samarl.policies.flat import MEAN, FlatPolicy
from samarl.policies.heads import Gaussian
from samarl.policies.policy import (
    LOCAL,
    POLICIES,
    TOLD,
    Known,
    Level,
    Networks,
    PolicyConfig,
    State,
)

STD = {2: (0.3, 0.3), 3: (0.3, 0.1, 0.3)}
TRUST = 2.0  # so it begins with 0.88


@dataclass
class PlannedConfig(Plans, PolicyConfig):
    """Numbers of a policy with a planner."""


class Mixture(Gaussian):
    """A Gaussian about (1 - w) times a mean of its own and w times a proposal.

    The trust w, between 0 and 1, depends on all that is known and begins near sigmoid(TRUST).
    """

    def __init__(
        self, features: int, hidden: int, mean: Sequence[float], std: Sequence[float]
    ) -> None:
        """See `Gaussian`; the proposal, padded with zeros, comes after the features."""
        super().__init__(features, hidden, mean, std)
        last = nn.Linear(hidden, 1)
        self.trust = nn.Sequential(
            nn.Linear(features + TOLD, hidden), nn.Tanh(), last, nn.Sigmoid()
        )
        nn.init.orthogonal_(last.weight, gain=0.01)
        nn.init.constant_(last.bias, TRUST)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation, [..., A]."""
        own, std = super().forward(inputs[..., :-TOLD])
        proposal = inputs[..., -TOLD:][..., : own.shape[-1]]
        return own + self.trust(inputs) * (proposal - own), std


@POLICIES.register("planned", PlannedConfig)
class PlannedPolicy(FlatPolicy):
    """A Gaussian of the local action about a mixture of its own and of the planner's."""

    begins_anew = ("log_std", ".trust.")

    def _make_networks(self, encoder: Encoder) -> Networks:
        n = self.action_size
        head = Mixture(encoder.features, self.config.hidden, MEAN[n], STD[n])
        return Networks(encoder, {LOCAL: head})

    def _decide(
        self, scene: Any, ego: Tensor, rows: Tensor, known: Known, state: State, explore: bool
    ) -> tuple[dict[str, Level], Tensor, Tensor, Tensor]:
        """It is told the planner's proposal, which also counts on those who left the view."""
        told = torch.zeros(*known.active.shape, TOLD)
        proposal = first_action(self.config, known.tracks, known.scenario)
        told[..., : self.action_size] = torch.from_numpy(proposal)
        mine = told[torch.from_numpy(known.active)].to(ego.device)
        return {}, told, *self._ask(LOCAL, scene, ego, mine, rows)

    def _choices(
        self, scene: Any, ego: Tensor, rows: Tensor, told: Tensor, asked: Mapping[str, Tensor]
    ) -> dict[str, tuple[Tensor, Tensor]]:
        return {LOCAL: self._ask(LOCAL, scene, ego, told, rows)}
