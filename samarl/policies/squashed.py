"""The actor of soft actor-critic: one level, a Gaussian squashed by tanh (MSA3C, Eq. 17)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

import torch
from torch import Tensor
from torch.nn import functional

from mrsan import ConfigurationError
from samarl.encoders import Encoder
from samarl.observations.frames import Frames
from samarl.policies.flat import FlatPolicy
from samarl.policies.heads import StateDependentGaussian
from samarl.policies.policy import (
    LOCAL,
    POLICIES,
    Networks,
    PolicyConfig,
    PolicyState,
    PolicyStep,
)
from samarl.policies.stochastic import (
    ActionEvaluation,
    ExplorationNoise,
    Sequences,
)

if TYPE_CHECKING:
    from tensordict import TensorDict


@dataclass
class SquashedConfig(PolicyConfig):
    """Settings of a squashed policy."""


@POLICIES.register("squashed", SquashedConfig)
class SquashedPolicy(FlatPolicy):
    """Explore with tanh(mean + std * noise), and act with tanh(mean) when deployed.

    Rollouts store actions before tanh, which cannot be recovered from an action close to 1. With
    the initial standard deviation of 1 actions are almost uniformly distributed.
    """

    def _make_networks(self, encoder: Encoder) -> Networks:
        head = StateDependentGaussian(encoder.features, self.config.hidden, self.action_size)
        return Networks(encoder, {LOCAL: head})

    def step(
        self,
        features: Frames,
        pose: Tensor,
        route: Tensor,
        is_init: Tensor,
        state: PolicyState,
        noise: ExplorationNoise | None = None,
    ) -> tuple[PolicyStep, PolicyState]:
        """See `StochasticPolicy.step`; the log-probability is that of the squashed action."""
        step, state = super().step(features, pose, route, is_init, state, noise)
        local = step.levels[LOCAL]
        if noise is not None:
            local = local._replace(log_prob=local.log_prob - log_slope(local.action))
        levels = {LOCAL: local}
        return step._replace(
            action=local.action.tanh(), mean=step.mean.tanh(), levels=levels
        ), state

    def evaluate(
        self,
        sequences: Sequences,
        samples: Tensor,
        waypoint_features: Tensor | None,
        decisions: Mapping[str, TensorDict],
    ) -> dict[str, ActionEvaluation]:
        """See `StochasticPolicy.evaluate`; mean and deviation are those before tanh.

        The entropy of a squashed Gaussian has no closed form: it is estimated from the actions.
        """
        local = super().evaluate(sequences, samples, waypoint_features, decisions)[LOCAL]
        slope = log_slope(decisions[LOCAL]["action"])
        return {
            LOCAL: local._replace(log_prob=local.log_prob - slope, entropy=local.entropy + slope)
        }

    # For soft actor-critic

    def features(self, sequences: Sequences) -> Tensor:
        """Return the features Y of B robots in T steps, [B, T, F]."""
        features, is_init, encoder_states = sequences
        sets, features_per_set = len(self.networks), []
        for i, net in enumerate(self.networks):
            visible = features.select(slice(i, None, sets))
            scene = net.encoder.observe(visible, is_init[i::sets], encoder_states[i])
            query = visible.ego[:, self.history :]
            y = net.encoder.read(scene, query.flatten(0, 1))
            features_per_set.append(y.view(*query.shape[:2], -1))
        return torch.stack(features_per_set, 1).flatten(0, 1)  # row b belongs to the set b % sets

    def draw(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Draw actions [..., N, A] with log-probabilities [..., N] from features Y [..., N, F].

        The gradient goes through both (MSA3C, Eq. 17).
        """
        sets = len(self.networks)
        parts = [net.heads[LOCAL](y[..., i::sets, :]) for i, net in enumerate(self.networks)]
        mean, std = (torch.stack(part, -2).flatten(-3, -2) for part in zip(*parts, strict=True))
        noise = torch.randn_like(mean)
        unsquashed = mean + std * noise
        normal = -0.5 * noise.square() - std.log() - 0.5 * math.log(2.0 * math.pi)
        return unsquashed.tanh(), normal.sum(-1) - log_slope(unsquashed)

    def bound_std(self, level: str, least: float, largest: float) -> NoReturn:
        """Refuse to bound the standard deviation, which depends on the features.

        Raises:
            ConfigurationError: always.
        """
        raise ConfigurationError(
            "policy.name is squashed, whose noise is learned; algorithm.name must be one that does "
            "not bound it: soft_actor_critic"
        )


def log_slope(unsquashed: Tensor) -> Tensor:
    """Return the log-derivative of tanh, log(1 - tanh(x)^2), summed over x [..., A], [...].

    This form is exact even where tanh rounds to 1 (Haarnoja et al., Soft actor-critic algorithms
    and applications, 2018, as in its later implementations).
    """
    return 2.0 * (math.log(2.0) - unsquashed - functional.softplus(-2.0 * unsquashed)).sum(-1)
