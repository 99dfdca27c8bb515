"""Values of what a team does: critics of every robot's features and action (MSA3C, Eq. 11-13)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from enum import Enum

import torch
from torch import Tensor, nn

from samarl.encoders.windowed_attention import MASKED


class Aggregation(Enum):
    """What a critic makes of the other robots."""

    attention = 1  # MSA3C and MLGA2C: weighs them, any number
    concatenation = 2  # MASAC: one after another, always as many


def block(inputs: int, outputs: int) -> nn.Sequential:
    """A layer, its normalisation and a leaky rectifier, as in all of the paper's critic."""
    return nn.Sequential(nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.LeakyReLU())


class TeamCritic(nn.Module, ABC):
    """Q of each robot.

    Robots that have arrived do nothing any more; they do not count for the others.
    """

    @abstractmethod
    def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
        """Q of every robot, [..., N].

        Args:
            y: [..., N, F] features.
            own: [..., N, A] what each robot does.
            others: [..., N, A] what it does in the eyes of the others. It is told apart because an
                actor changes one robot's action among those that the others took.
            active: [..., N] who is on the way.
        """


class AttentionCritic(TeamCritic):
    """A robot attends to the others by what they see and do."""

    def __init__(self, features: int, actions: int, width: int, heads: int) -> None:
        super().__init__()
        self.heads, self.scale = heads, (width // heads) ** -0.5
        self.own, self.other = (block(features + actions, width) for _ in range(2))
        self.asks, self.keys, self.values = (nn.Linear(width, width, bias=False) for _ in range(3))
        self.out = nn.Sequential(block(2 * width, width), block(width, width), nn.Linear(width, 1))

    def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
        """See `TeamCritic.forward`."""
        of_self = self.own(torch.cat([y, own], -1))  # Eq. 11
        of_other = self.other(torch.cat([y, others], -1))  # Eq. 12

        def by_head(values: Tensor) -> Tensor:
            return values.unflatten(-1, (self.heads, -1)).transpose(-3, -2)  # [..., heads, N, D]

        n = y.shape[-2]
        counts = active.unsqueeze(-2) & ~torch.eye(n, dtype=torch.bool, device=y.device)
        counts = counts.unsqueeze(-3)  # [..., 1, N, N] of the others, those on the way
        score = by_head(self.asks(of_self)) @ by_head(self.keys(of_other)).transpose(-2, -1)
        share = torch.softmax(torch.where(counts, self.scale * score, MASKED), -1) * counts
        # Eq. 13 prints the values of e_self; but what is weighed can only be the others'.
        found = (share @ by_head(self.values(of_other))).transpose(-3, -2).flatten(-2)
        q: Tensor = self.out(torch.cat([found, of_self], -1)).squeeze(-1)
        return q


class ConcatenationCritic(TeamCritic):
    """A robot's own part, then those of the others in the order of their numbers."""

    def __init__(self, features: int, actions: int, width: int, robots: int) -> None:
        super().__init__()
        joint = robots * (features + actions)
        self.out = nn.Sequential(block(joint, width), block(width, width), nn.Linear(width, 1))

    def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
        """See `TeamCritic.forward`."""
        n = y.shape[-2]
        seen = torch.cat([y, others], -1) * active.unsqueeze(-1)
        rest = [[k for k in range(n) if k != i] for i in range(n)]
        of_others = seen[..., torch.tensor(rest, dtype=torch.long).view(n, n - 1), :]
        q: Tensor = self.out(torch.cat([y, own, of_others.flatten(-2)], -1)).squeeze(-1)
        return q
