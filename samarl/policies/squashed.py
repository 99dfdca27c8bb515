"""One level, a Gaussian squashed by tanh: the actor of soft actor-critic (MSA3C, Eq. 17)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from mrsan import ConfigurationError, Observation, Scenario
from samarl.encoders import Encoder
from samarl.policies.flat import FlatPolicy
from samarl.policies.heads import SpreadGaussian
from samarl.policies.policy import (
    LOCAL,
    POLICIES,
    Choice,
    Decision,
    Level,
    Networks,
    PolicyConfig,
    Sequences,
    State,
    Taken,
)


@dataclass
class SquashedConfig(PolicyConfig):
    """Numbers of a squashed policy."""


class SquashedLevel(Level):
    """What was decided before tanh; its log-probability is that of the action."""

    __slots__ = ()

    @property
    def bounded(self) -> Tensor:
        """The action, [E, N, A] in [-1, 1]."""
        return self.action.tanh()


@POLICIES.register("squashed", SquashedConfig)
class SquashedPolicy(FlatPolicy):
    """Drives with tanh(mean + deviation * noise), at test time with tanh(mean).

    It keeps and evaluates what stands inside of tanh: from an action near 1 that cannot be told.
    It begins with a deviation of 1, whose actions are nearly uniform.
    """

    def _make_networks(self, encoder: Encoder) -> Networks:
        head = SpreadGaussian(encoder.features, self.config.hidden, self.action_size)
        return Networks(encoder, {LOCAL: head})

    def act(
        self,
        observation: Observation,
        state: State,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
        correlation: float | None = None,
        active: NDArray[np.bool_] | None = None,
    ) -> Decision:
        """See `Policy.act`."""
        decision = super().act(observation, state, is_init, scenario, correlation, active)
        drawn = decision.levels[LOCAL]
        probability = drawn.log_prob
        if correlation is not None:
            probability = probability - log_slope(drawn.action)
        level = SquashedLevel(drawn.action, probability, drawn.decided)
        return decision._replace(levels={LOCAL: level}, mean=decision.mean.tanh())

    def evaluate(
        self, sequences: Sequences, samples: Tensor, told: Tensor, taken: Mapping[str, Taken],
        correlation: float,
    ) -> dict[str, Choice]:  # fmt: skip
        """See `Policy.evaluate`; mean and deviation are those before tanh.

        The entropy of a squashed Gaussian has no closed form: it is estimated from what was done.
        """
        choice = super().evaluate(sequences, samples, told, taken, correlation)[LOCAL]
        slope = log_slope(taken[LOCAL].action)
        return {
            LOCAL: choice._replace(log_prob=choice.log_prob - slope, entropy=choice.entropy + slope)
        }

    # What soft actor-critic asks for

    def features(self, sequences: Sequences) -> Tensor:
        """Y of B robots in T steps, [B, T, F]."""
        frames, is_init, states = sequences
        sets, found = len(self.networks), []
        with self._precision():
            for i, net in enumerate(self.networks):
                mine = slice(i, None, sets)
                given = frames.of(mine)
                scene = net.encoder.observe(given, is_init[mine], states[i])
                query = given.ego[:, self.history :]
                found.append(
                    net.encoder.read(scene, query.flatten(0, 1)).view(*query.shape[:2], -1)
                )
        return torch.stack(found, 1).flatten(0, 1).float()  # row b is of the set b % sets

    def draw(self, y: Tensor) -> tuple[Tensor, Tensor]:
        """Actions [..., N, A] and their log-probabilities [..., N] from Y [..., N, F].

        The gradient goes through both (MSA3C, Eq. 17).
        """
        sets = len(self.networks)
        parts = [net.heads[LOCAL](y[..., i::sets, :]) for i, net in enumerate(self.networks)]
        mean, std = (torch.stack(part, -2).flatten(-3, -2) for part in zip(*parts, strict=True))
        noise = torch.randn_like(mean)
        inside = mean + std * noise
        normal = -0.5 * noise.square() - std.log() - 0.5 * math.log(2.0 * math.pi)
        return inside.tanh(), normal.sum(-1) - log_slope(inside)

    # What only learners with a cap on the noise ask for

    def bound_std(self, level: str, least: float, largest: float) -> NoReturn:
        """Its deviation depends on what the robot sees.

        Raises:
            ConfigurationError: always.
        """
        raise ConfigurationError(
            "policy.name is squashed, whose noise is learned; algorithm.name must be one that does "
            "not cap it: soft_actor_critic"
        )


def log_slope(inside: Tensor) -> Tensor:
    """The sum of log(1 - tanh(x)^2) over x [..., A], [...].

    Written so that it is exact where tanh rounds to 1 (Haarnoja et al., Soft actor-critic
    algorithms and applications, 2018, as in its later implementations).
    """
    return 2.0 * (math.log(2.0) - inside - functional.softplus(-2.0 * inside)).sum(-1)
