"""One number: the least of what the robot's encounters with each other agent are worth alone.

The value network of CADRL (Chen et al., Decentralized non-communicating multiagent collision
avoidance with deep reinforcement learning, 2017) among many: the minimum over pairs.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS, Encoder, State, single_frames
from samarl.observations.frames import Frames


@dataclass
class PairwiseConfig:
    """Sizes of the pairwise network."""

    width: int = required(8, 1024, help="width of both hidden layers")


@ENCODERS.register("pairwise", PairwiseConfig)
class PairwiseEncoder(Encoder):
    """The minimum over pairs; humans and robots differ in the first layer.

    Where nobody is known, it is what the robot's way is worth to it alone.
    """

    features = 1

    def __init__(self, config: PairwiseConfig, ego_features: int, other_features: int) -> None:
        """See `Encoder`."""
        super().__init__(config, ego_features, other_features)
        width = config.width
        self.own = nn.Linear(2 * ego_features, width)
        self.humans, self.robots = (nn.Linear(other_features, width, bias=False) for _ in range(2))
        self.pair, self.alone = (
            nn.Sequential(nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
            for _ in range(2)
        )
        self.own_alone = nn.Linear(2 * ego_features, width)

    def observe(
        self, frames: Frames, is_init: Tensor, state: State, samples: Tensor | None = None
    ) -> Frames:
        """See `Encoder.observe`; what is known in P samples."""
        return single_frames(frames, samples)

    def read(self, scene: Frames, query: Tensor) -> Tensor:
        """See `Encoder.read`; the least value, [P, 1]."""
        ego, humans, humans_known, robots, robots_known = scene
        both = torch.cat([ego, query], -1)
        own, least = self.own(both), torch.full_like(ego[:, 0], torch.inf)
        # Slots of those who are not known cost nothing.
        for embed, others, known in (
            (self.humans, humans, humans_known),
            (self.robots, robots, robots_known),
        ):
            of, slot = known.nonzero(as_tuple=True)
            values = self.pair(embed(others[of, slot]) + own[of]).squeeze(-1)
            least = least.scatter_reduce(0, of, values, "amin")
        alone = self.alone(self.own_alone(both)).squeeze(-1)
        return torch.where(least.isinf(), alone, least).unsqueeze(1)
