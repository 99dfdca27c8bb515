"""Heads that map features to distributions of actions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn


class Gaussian(nn.Module):
    """A diagonal Gaussian whose standard deviation does not depend on the input."""

    def __init__(
        self, inputs: int, hidden: int, mean: Sequence[float], std: Sequence[float]
    ) -> None:
        """Initialise the head to approximately `mean` [A], and to `std` [A], for all inputs."""
        super().__init__()
        output = nn.Linear(hidden, len(mean))
        self.body = nn.Sequential(nn.Linear(inputs, hidden), nn.Tanh(), output)
        self.log_std = nn.Parameter(torch.tensor(std).log())
        nn.init.orthogonal_(output.weight, gain=0.01)
        with torch.no_grad():
            output.bias.copy_(torch.tensor(mean))

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation, [..., A]."""
        mean = self.body(inputs)
        return mean, self.log_std.exp().expand_as(mean)

    @torch.no_grad()
    def bound_std(self, minimum: float, maximum: float) -> None:
        """Clamp the standard deviation; `maximum` takes precedence over a larger `minimum`."""
        self.log_std.clamp_(math.log(max(minimum, 1e-6)), math.log(maximum))


class StateDependentGaussian(nn.Module):
    """A diagonal Gaussian whose mean and standard deviation depend on the input."""

    LOG_STD_MIN, LOG_STD_MAX = -5.0, 2.0  # Haarnoja et al., 2018

    def __init__(self, inputs: int, hidden: int, actions: int) -> None:
        """Initialise the head to approximately a mean of 0 and a deviation of 1 for all inputs."""
        super().__init__()
        output = nn.Linear(hidden, 2 * actions)
        self.body = nn.Sequential(
            nn.Linear(inputs, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            output,
        )
        nn.init.orthogonal_(output.weight, gain=0.01)
        nn.init.zeros_(output.bias)

    def forward(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation, [..., A]."""
        mean, log_std = self.body(inputs).chunk(2, -1)
        return mean, log_std.clamp(self.LOG_STD_MIN, self.LOG_STD_MAX).exp()


def log_prob(action: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Return the log-probability [...] of actions [..., A] under a diagonal Gaussian."""
    return torch.distributions.Normal(mean, std, validate_args=False).log_prob(action).sum(-1)


def given_previous_noise(
    mean: Tensor, std: Tensor, previous: Tensor, correlation: Tensor | float
) -> tuple[Tensor, Tensor]:
    """Return loc and scale of correlated actions: only the innovation of the noise is random.

    With a_t = mean + std n_t and n_t = rho n_(t-1) + sqrt(1 - rho^2) e_t, where e_t is standard
    normal, a_t given n_(t-1) has the location mean + rho std n_(t-1) and the scale
    sqrt(1 - rho^2) std.
    """
    return mean + correlation * std * previous, (1.0 - correlation**2) ** 0.5 * std
