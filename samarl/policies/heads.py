"""Heads that map features to distributions of actions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.distributions.constraints import Constraint


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


class ModeGaussian(Gaussian):
    """A mode, and a diagonal Gaussian: the macro actions of a policy with modes."""

    FIRST_LOGIT = 1.5  # of the first mode at initialisation; those of the others are 0
    uniform_share: Tensor  # [] probability of drawing the mode uniformly, for exploration

    def __init__(
        self, inputs: int, hidden: int, mean: Sequence[float], std: Sequence[float], modes: int
    ) -> None:
        """Initialise the Gaussian as `Gaussian` does, and the modes in favour of the first."""
        super().__init__(inputs, hidden, mean, std)
        self.logits = nn.Linear(hidden, modes)
        nn.init.orthogonal_(self.logits.weight, gain=0.01)
        nn.init.zeros_(self.logits.bias)
        with torch.no_grad():
            self.logits.bias[0] = self.FIRST_LOGIT
        self.register_buffer("uniform_share", torch.zeros(()))

    def mode_logits(self, inputs: Tensor) -> Tensor:
        """Return the logarithms of the probabilities of the modes (normalised logits), [..., M]."""
        probabilities = self.logits(self.body[:2](inputs)).softmax(-1)
        uniform = self.uniform_share / probabilities.shape[-1]
        return ((1.0 - self.uniform_share) * probabilities + uniform).clamp_min(1e-8).log()


class ModeAndOffset(torch.distributions.Distribution):
    """A categorical mode and, for the first mode, a Gaussian offset: (mode, x_1, ..., x_A).

    "Mode" is what a robot does (go, wait, ...), not the mode of a distribution. The offsets of
    other modes have no effect, so that only the mode's probability counts for them.
    """

    arg_constraints: ClassVar[dict[str, Constraint]] = {}

    def __init__(self, logits: Tensor, loc: Tensor, scale: Tensor) -> None:
        """Create the distribution from logits [..., M], loc and scale [..., A]."""
        self.modes = torch.distributions.Categorical(logits=logits, validate_args=False)
        self.offset = torch.distributions.Normal(loc, scale, validate_args=False)
        shape = loc.shape
        super().__init__(shape[:-1], torch.Size([1 + shape[-1]]), validate_args=False)

    @property
    def deterministic_sample(self) -> Tensor:
        """The most probable mode and the mean, [..., 1 + A]."""
        best = self.modes.logits.argmax(-1, keepdim=True)
        return torch.cat([best.to(self.offset.loc), self.offset.loc], -1)

    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draw samples [..., 1 + A]."""
        shape = self._extended_shape(torch.Size(sample_shape))
        return self.from_noise(torch.randn(shape, device=self.offset.loc.device))

    def from_noise(self, noise: Tensor) -> Tensor:
        """Return the samples [..., 1 + A] that standard normal noise [..., 1 + A] draws."""
        quantile = torch.special.ndtr(noise[..., :1])
        mode = (quantile > self.modes.probs.cumsum(-1)[..., :-1]).sum(-1, keepdim=True)
        offset = self.offset.loc + self.offset.scale * noise[..., 1:]
        return torch.cat([mode.to(offset), offset], -1)

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log-probability [...] of samples [..., 1 + A]."""
        mode = value[..., 0].long()
        of_offset = self.offset.log_prob(value[..., 1:]).sum(-1)
        return self.modes.log_prob(mode) + torch.where(mode == 0, of_offset, 0.0)

    def entropy(self) -> Tensor:
        """Return the entropy [...]."""
        of_offset = self.offset.entropy().sum(-1)
        return self.modes.entropy() + self.modes.probs[..., 0] * of_offset


class SpreadGaussian(nn.Module):
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
    """Return loc and scale of correlated actions: only the fresh part of the noise is random.

    With a_t = mean + std n_t and n_t = rho n_(t-1) + sqrt(1 - rho^2) e_t, where e_t is standard
    normal, a_t given n_(t-1) has the location mean + rho std n_(t-1) and the scale
    sqrt(1 - rho^2) std.
    """
    return mean + correlation * std * previous, (1.0 - correlation**2) ** 0.5 * std
