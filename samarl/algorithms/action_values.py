"""Action values Q of the robots of a team (MSA3C, Eq. 11-13)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum

import torch
from torch import Tensor, nn

from samarl.encoders.windowed_attention import MASKED
from samarl.observations.features import team_mates


class Aggregation(Enum):
    """How a critic combines the other robots."""

    attention = 1  # MSA3C and MLGA2C: a weighted sum over any number of robots
    concatenation = 2  # MASAC: side by side, for a fixed number of robots


def block(inputs: int, outputs: int) -> nn.Sequential:
    """Return a layer with normalisation and leaky rectifier, the building block of all critics."""
    return nn.Sequential(nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.LeakyReLU())


class TeamCritic(nn.Module, ABC):
    """Q of each robot.

    Robots that have arrived no longer act, so the others ignore them.
    """

    @abstractmethod
    def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
        """Return Q of every robot, [..., N].

        Args:
            y: [..., N, F] features.
            own: [..., N, A] action of each robot, as an input of its own Q.
            others: [..., N, A] action of each robot, as an input of the other robots' Q. The two
                differ in the actor's loss, in which each robot's own action is drawn anew.
            active: [..., N] robots that have not arrived.
        """


class AttentionCritic(TeamCritic):
    """Each robot attends to the features and actions of the others."""

    def __init__(self, features: int, actions: int, width: int, heads: int) -> None:
        super().__init__()
        self.heads, self.scale = heads, (width // heads) ** -0.5
        self.embed_own, self.embed_other = (block(features + actions, width) for _ in range(2))
        self.query, self.key, self.value = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.out = nn.Sequential(block(2 * width, width), block(width, width), nn.Linear(width, 1))

    def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
        """See `TeamCritic.forward`."""
        e_own = self.embed_own(torch.cat([y, own], -1))  # Eq. 11
        e_other = self.embed_other(torch.cat([y, others], -1))  # Eq. 12

        def by_head(values: Tensor) -> Tensor:
            return values.unflatten(-1, (self.heads, -1)).transpose(-3, -2)  # [..., heads, N, D]

        n = y.shape[-2]
        mask = active.unsqueeze(-2) & ~torch.eye(n, dtype=torch.bool, device=y.device)
        mask = mask.unsqueeze(-3)  # [..., 1, N, N] active robots other than the robot itself
        score = by_head(self.query(e_own)) @ by_head(self.key(e_other)).transpose(-2, -1)
        weight = torch.softmax(torch.where(mask, self.scale * score, MASKED), -1) * mask
        # Eq. 13 prints the values of e_self, but only those of the others can be meant.
        context = (weight @ by_head(self.value(e_other))).transpose(-3, -2).flatten(-2)
        q: Tensor = self.out(torch.cat([context, e_own], -1)).squeeze(-1)
        return q


class ConcatenationCritic(TeamCritic):
    """Each robot's own features and action, followed by those of the others in index order."""

    def __init__(self, features: int, actions: int, width: int, robots: int) -> None:
        super().__init__()
        joint = robots * (features + actions)
        self.out = nn.Sequential(block(joint, width), block(width, width), nn.Linear(width, 1))

    def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
        """See `TeamCritic.forward`."""
        n = y.shape[-2]
        inputs = torch.cat([y, others], -1) * active.unsqueeze(-1)
        other_inputs = inputs[..., torch.from_numpy(team_mates(n)), :]
        q: Tensor = self.out(torch.cat([y, own, other_inputs.flatten(-2)], -1)).squeeze(-1)
        return q
