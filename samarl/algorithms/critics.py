"""Value networks, which are only used in training."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from samarl.encoders.transformer_layers import Pool, nearness
from samarl.observations.frames import Frames


class SetEncoder(nn.Module):
    """Encode one frame of all agents into a feature vector, without history.

    The global state contains all velocities and goals, so a single frame is sufficient.
    """

    def __init__(self, ego: int, other: int, width: int, heads: int, out: int) -> None:
        """Create the layers.

        Args:
            ego: length of a robot's own state.
            other: length of the state of another agent.
            width: of the hidden layers.
            heads: of the attention.
            out: length of the feature vector.
        """
        super().__init__()

        def mlp(inputs: int, outputs: int) -> nn.Sequential:
            return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, outputs))

        self.heads = heads
        self.embed_ego = mlp(ego, width)
        self.embed_humans, self.embed_robots = mlp(other, width), mlp(other, width)
        self.humans, self.robots = Pool(width, heads), Pool(width, heads)
        self.out = nn.Sequential(nn.Linear(3 * width, out), nn.ReLU(), nn.Linear(out, out))

    def forward(self, frames: Frames) -> Tensor:
        """Return the features [P, out] of `frames` [P, ...]."""
        ego = self.embed_ego(frames.ego)
        features = [ego]
        for pool, embed, (others, mask) in (
            (self.humans, self.embed_humans, frames.entities["humans"]),
            (self.robots, self.embed_robots, frames.entities["robots"]),
        ):
            score = nearness(others, mask, self.heads)
            features.append(pool(ego, torch.relu(embed(others)), score))
        return torch.relu(self.out(torch.cat(features, -1)))


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
