"""Value networks, which are only used in training."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from samarl.encoders.set_pool import PooledSets
from samarl.observations.frames import FeatureSizes, Frames


class CriticEncoder(nn.Module):
    """Encode one frame of all agents into a feature vector, without history.

    The global state contains all velocities and goals, so a single frame is sufficient.
    """

    def __init__(self, sizes: FeatureSizes, width: int, features: int) -> None:
        """Create the layers.

        Sensors of the frames are not used.
        """
        super().__init__()
        self.own = nn.Sequential(nn.Linear(sizes.ego, width), nn.ReLU())
        self.sets = PooledSets(sizes, width)
        self.out = nn.Sequential(nn.Linear(width + self.sets.features, features), nn.ReLU())

    def forward(self, frames: Frames) -> Tensor:
        """Return the features [P, features] of `frames` [P, ...]."""
        y: Tensor = self.out(torch.cat([self.own(frames.ego), self.sets(frames)], -1))
        return y


class PopArtHead(nn.Module):
    """A value head whose output is normalised by the running mean and deviation of its targets.

    When these statistics change, the last layer is rescaled so that no denormalised value changes
    (van Hasselt et al., Learning values across many orders of magnitude, 2016).
    """

    mean: Tensor
    square: Tensor
    weight: Tensor

    def __init__(self, inputs: int, hidden: int, decay: float = 0.99) -> None:
        """Create the head; the statistics decay exponentially by `decay` per update."""
        super().__init__()
        self.decay = decay
        self.body = nn.Sequential(
            nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, hidden), nn.Tanh()
        )
        self.last = nn.Linear(hidden, 1)
        self.register_buffer("mean", torch.zeros(()))
        self.register_buffer("square", torch.zeros(()))
        self.register_buffer("weight", torch.zeros(()))

    def forward(self, *features: Tensor) -> Tensor:
        """Return the normalised values [..., 1] of features, [..., F] together."""
        value: Tensor = self.last(self.body(torch.cat(features, -1)))
        return value

    @torch.no_grad()
    def update(self, targets: Tensor) -> None:
        """Update the statistics with targets [R], in the scale of returns."""
        mean, std = self._moments()
        self.mean.mul_(self.decay).add_((1 - self.decay) * targets.mean())
        self.square.mul_(self.decay).add_((1 - self.decay) * targets.square().mean())
        self.weight.mul_(self.decay).add_(1 - self.decay)
        new_mean, new_std = self._moments()
        self.last.weight.mul_(std / new_std)
        self.last.bias.mul_(std).add_(mean - new_mean).div_(new_std)

    def normalise(self, value: Tensor) -> Tensor:
        """Convert values from the scale of returns to that of the critic."""
        mean, std = self._moments()
        return (value - mean) / std

    def denormalise(self, value: Tensor) -> Tensor:
        """Convert values from the scale of the critic to that of returns."""
        mean, std = self._moments()
        return value * std + mean

    def _moments(self) -> tuple[Tensor, Tensor]:
        if self.weight == 0:
            return torch.zeros_like(self.mean), torch.ones_like(self.mean)
        mean = self.mean / self.weight
        return mean, (self.square / self.weight - mean.square()).clamp_min(1e-2).sqrt()
