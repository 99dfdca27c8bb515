"""A single value: the minimum of the values of the robot's encounters with each other agent.

The value network of CADRL (Chen et al., Decentralized non-communicating multiagent collision
avoidance with deep reinforcement learning, 2017) among many: the minimum over pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.jit import is_tracing  # type: ignore[attr-defined]

from mrsan import Entities
from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS, Encoder, EncoderState, single_frames
from samarl.observations.frames import FeatureSizes, Frames

DENSE = 0.7  # share of the slots from which on empty ones are computed as well: that is faster


@dataclass
class PairwiseConfig:
    """Sizes of the pairwise network."""

    width: int = required(8, 1024, help="width of both hidden layers")


@ENCODERS.register("pairwise", PairwiseConfig)
class PairwiseEncoder(Encoder):
    """The minimum over pairs; humans and robots have different first layers.

    Where nobody is known, a separate network gives the value of driving alone.
    """

    features = 1

    def __init__(self, config: PairwiseConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        width = config.width
        self.own = nn.Linear(2 * sizes.ego, width)
        self.humans, self.robots = (
            nn.Linear(sizes.entities[group], width, bias=False) for group in ("humans", "robots")
        )
        self.pair, self.alone = (
            nn.Sequential(
                nn.ReLU(inplace=True),
                nn.Linear(width, width),
                nn.ReLU(inplace=True),
                nn.Linear(width, 1),
            )
            for _ in range(2)
        )
        self.own_alone = nn.Linear(2 * sizes.ego, width)

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> Frames:
        """See `Encoder.observe`; the scene is the frames of P samples."""
        return single_frames(frames, samples)

    def read(self, scene: Frames, query: Tensor) -> Tensor:
        """See `Encoder.read`; the minimum, [P, 1]."""
        own_and_query = torch.cat([scene.ego, query], -1)
        own, minimum = self.own(own_and_query), torch.full_like(scene.ego[:, 0], torch.inf)
        for embed, group in (
            (self.humans, scene.entities["humans"]),
            (self.robots, scene.entities["robots"]),
        ):
            minimum = torch.minimum(minimum, self._least(embed, group, own))
        if is_tracing():
            alone = self.alone(self.own_alone(own_and_query)).squeeze(-1)
            return torch.where(minimum.isinf(), alone, minimum).unsqueeze(1)
        lonely = minimum.isinf().nonzero().squeeze(1)
        alone = self.alone(self.own_alone(own_and_query[lonely])).squeeze(-1)
        return minimum.index_copy(0, lonely, alone).unsqueeze(1)

    def _least(self, embed: nn.Linear, group: Entities[Tensor], own: Tensor) -> Tensor:
        """Return the smallest value of the encounters with a group, [P]; infinite without any."""
        features, known = group
        sample, slot = known.nonzero(as_tuple=True)
        if not is_tracing() and len(sample) > DENSE * known.numel():
            values = self.pair(embed(features) + own.unsqueeze(1)).squeeze(-1)
            return values.masked_fill(~known, torch.inf).amin(1)
        row = sample * known.shape[1] + slot
        first = torch.addmm(own[sample], features.flatten(0, 1)[row], embed.weight.t())
        least = torch.full_like(own[:, 0], torch.inf)
        return least.scatter_reduce(0, sample, self.pair(first).squeeze(-1), "amin")
