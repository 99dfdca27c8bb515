"""A pooled set: the maximum over the agents around the robot, feature by feature, of one frame.

The shape of the networks of GIGAFLOW (Cusumano-Towner et al., Robust autonomy emerges from
self-play, 2025) and of PointNet: the cheapest encoder that accepts any number of agents.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mrsan import Entities
from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS, Encoder, EncoderState, single_frames
from samarl.encoders.rays import RayEncoder
from samarl.encoders.set_pooling import set_pooling
from samarl.observations.frames import FeatureSizes, Frames


@dataclass
class SetPoolConfig:
    """Sizes of the pooled set encoder."""

    width: int = required(8, 1024, help="width of all hidden layers")
    features: int = required(8, 4096, help="length of the output Y")


class PooledSet(nn.Module):
    """Two layers per agent, conditioned on the robot's own state, and the maximum over agents."""

    def __init__(self, ego: int, other: int, width: int) -> None:
        super().__init__()
        self.embed_ego = nn.Linear(ego, width)
        self.embed_other = nn.Linear(other, width, bias=False)
        self.second = nn.Linear(width, width)
        for layer in (self.embed_ego, self.embed_other, self.second):
            nn.init.orthogonal_(layer.weight, gain=2**0.5)

    def forward(self, ego: Tensor, agents: Entities[Tensor]) -> Tensor:
        """Return the maximum of each feature over the known agents [P, width]; 0 without any.

        Args:
            ego: [P, F_e] the robots' own states.
            agents: [P, M, F_o] and which of them are known, [P, M].
        """
        own = self.embed_ego(ego)
        second = self.second
        return set_pooling(own, *agents, self.embed_other.weight, second.weight, second.bias)


class PooledSets(nn.Module):
    """A pooled set for each group of entities: humans, robots and any others, such as walls."""

    def __init__(self, sizes: FeatureSizes, width: int) -> None:
        super().__init__()
        self.groups = nn.ModuleDict(
            {name: PooledSet(sizes.ego, size, width) for name, size in sizes.entities.items()}
        )
        self.features = len(self.groups) * width

    def forward(self, frames: Frames) -> Tensor:
        """Return the maxima of all groups [P, features] of `frames` [P, ...]."""
        return torch.cat(
            [pool(frames.ego, frames.entities[name]) for name, pool in self.groups.items()], -1
        )


@ENCODERS.register("set_pool", SetPoolConfig)
class SetPoolEncoder(Encoder):
    """Pool each group of entities; read the pooled features with the robot's own state.

    The ranges of a lidar, if there is one, are encoded by circular convolutions.
    """

    skips_empty_slots = True

    def __init__(self, config: SetPoolConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        width, self.features = config.width, config.features
        self.sets = PooledSets(sizes, width)
        scene = self.sets.features
        self.rays: RayEncoder | None = None
        if "lidar" in sizes.sensors:
            self.rays = RayEncoder(sizes.sensors["lidar"][0], width)
            scene += width
        self.query = nn.Sequential(nn.Linear(sizes.ego, width), nn.ReLU())
        self.out = nn.Sequential(nn.Linear(scene + width, config.features), nn.ReLU())

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> Tensor:
        """See `Encoder.observe`; the scene is the pooled features, [P, G width] of G groups."""
        frame = single_frames(frames, samples)
        scene: Tensor = self.sets(frame)
        if self.rays is not None:
            scene = torch.cat([scene, self.rays(frame.sensors["lidar"])], -1)
        return scene

    def read(self, scene: Tensor, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        y: Tensor = self.out(torch.cat([scene, self.query(query)], -1))
        return y
