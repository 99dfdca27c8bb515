"""The levels of a policy as TorchRL's actors. Importing this module imports TorchRL."""

from __future__ import annotations

from typing import Protocol

from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor

from samarl.policies.heads import given_previous_noise
from samarl.policies.policy import LOCAL


class Levels(Protocol):
    """What the actors need of a policy, see `StochasticPolicy`."""

    def distribution(self, level: str, embedding: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation of a level's actions, [P, A] each."""


def make_actor(policy: Levels, level: str) -> ProbabilisticActor:
    """Return a level of a policy as a TorchRL actor.

    It reads `embedding` [Q, Y] (see `StochasticPolicy.embed`) and `row` [Q] (see
    `Policy._per_parameter_set`), for the local level also `previous_noise` [Q, A] and
    `noise_correlation` [Q, 1]. It writes `loc` and `scale` [Q, A] of the distribution of `action`
    given the previous noise, and `mean` and `std` [Q, A] without that condition.
    """
    noise = ["previous_noise", "noise_correlation"] if level == LOCAL else []
    head = TensorDictModule(
        LevelHead(policy, level),
        in_keys=["embedding", "row", *noise],
        out_keys=["loc", "scale", "mean", "std"],
    )
    return ProbabilisticActor(
        head,
        in_keys=["loc", "scale"],
        out_keys=["action"],
        distribution_class=IndependentNormal,
        distribution_kwargs={"validate_args": False},
        return_log_prob=True,
        log_prob_key="sample_log_prob",
    )


class LevelHead(nn.Module):
    """One level of a policy as a module, see `make_actor`."""

    def __init__(self, policy: Levels, level: str) -> None:
        super().__init__()
        self.policy, self.level = policy, level

    def forward(
        self,
        embedding: Tensor,
        row: Tensor,
        previous_noise: Tensor | None = None,
        noise_correlation: Tensor | float = 0.0,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return loc, scale, mean and std, [Q, A] each."""
        mean, std = self.policy.distribution(self.level, embedding, row)
        if previous_noise is None:
            return mean, std, mean, std
        return *given_previous_noise(mean, std, previous_noise, noise_correlation), mean, std
