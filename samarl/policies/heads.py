"""From a feature to a distribution of actions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


class Gaussian(nn.Module):
    """A diagonal Gaussian whose standard deviation is a parameter of its own."""

    def __init__(
        self, inputs: int, hidden: int, mean: Sequence[float], std: Sequence[float]
    ) -> None:
        """Begin near the same `mean` [A] and with `std` [A], whatever the input."""
        super().__init__()
        last = nn.Linear(hidden, len(mean))
        self.body = nn.Sequential(nn.Linear(inputs, hidden), nn.Tanh(), last)
        self.log_std = nn.Parameter(torch.tensor(std).log())
        nn.init.orthogonal_(last.weight, gain=0.01)
        with torch.no_grad():
            last.bias.copy_(torch.tensor(mean))

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation, [..., A]."""
        mean = self.body(inputs)
        return mean, self.log_std.exp().expand_as(mean)

    @torch.no_grad()
    def bound_std(self, least: float, largest: float) -> None:
        """Bring the standard deviation between the two; `largest` wins where they disagree."""
        self.log_std.clamp_(math.log(max(least, 1e-6)), math.log(largest))


class SpreadGaussian(nn.Module):
    """A diagonal Gaussian whose standard deviation depends on the input too."""

    LEAST, LARGEST = -5.0, 2.0  # of the logarithm of the deviation (Haarnoja et al., 2018)

    def __init__(self, inputs: int, hidden: int, actions: int) -> None:
        """Begin near a mean of 0 and a deviation of 1, whatever the input."""
        super().__init__()
        last = nn.Linear(hidden, 2 * actions)
        self.body = nn.Sequential(
            nn.Linear(inputs, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            last,
        )
        nn.init.orthogonal_(last.weight, gain=0.01)
        nn.init.zeros_(last.bias)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation, [..., A]."""
        mean, log_std = self.body(inputs).chunk(2, -1)
        return mean, log_std.clamp(self.LEAST, self.LARGEST).exp()


def log_prob(action: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Of actions [..., A] under a diagonal Gaussian, [...]."""
    return torch.distributions.Normal(mean, std, validate_args=False).log_prob(action).sum(-1)
