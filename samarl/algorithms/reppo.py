"""REPPO: on-policy learning with action values instead of advantages of what was done.

Relative Entropy Pathwise Policy Optimization (Voelcker et al., 2025): critics learn Q(s, a) from
multi-step returns of the newest rollout alone, with a categorical loss; the policy follows the
gradient of Q through its own actions; and a KL bound keeps it near the policy that collected the
rollout. What differs here:

- Q(s, a) = V(s) + A(s, a), where V is categorical and A is a regression on normalised advantages: a
  single action changes a return by less than the width of a category.
- Every level of a policy has its Q, of the true state of the team and the robot's own action.
- The standard deviation of the actors does not depend on the state. It follows the schedule of
  `OnPolicy`, so there is no entropy bonus.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from mrsan import ConfigurationError
from mrsan.fields import required
from samarl.algorithms.advantages import macro_advantages, step_advantages, streams
from samarl.algorithms.algorithm import ALGORITHMS
from samarl.algorithms.on_policy import (
    CHUNK_SIZE,
    OnPolicy,
    OnPolicyConfig,
    Statistics,
    by_row,
    selected_decisions,
)
from samarl.algorithms.training_data import TrainingData
from samarl.distributed import all_gather_cat
from samarl.policies.policy import LOCAL, MACRO, Policy
from samarl.rollout import Rollout, level_key

SMOOTHING = 0.75  # standard deviation of the targets' histogram in bins (Farebrother et al., 2024)
KL_WEIGHT_RATE = 0.1  # largest change of the logarithm of the KL divergence's weight per epoch


@dataclass
class REPPOConfig(OnPolicyConfig):
    """Hyperparameters of REPPO."""

    bins: int = required(3, 10001, help="number of categories of the critic")
    value_min: float = required(-1e6, 1e6, help="smallest return of the critic's categories")
    value_max: float = required(-1e6, 1e6, help="largest return of the critic's categories")
    kl_bound: float = required(0.0, 100.0, help="largest KL divergence from the old policy")


class CategoricalValue(nn.Module):
    """V(s) as the mean of a histogram over returns."""

    centers: Tensor

    def __init__(self, inputs: int, hidden: int, bins: int, low: float, high: float) -> None:
        """Create the layers.

        Args:
            inputs: length of the features of the state.
            hidden: width of the hidden layers.
            bins: number of categories.
            low: smallest return of the categories.
            high: largest return of the categories.
        """
        super().__init__()
        self.body = _mlp(inputs, hidden, bins)
        self.width = (high - low) / bins
        self.register_buffer("centers", low + self.width * (torch.arange(bins) + 0.5))

    def forward(self, features: Tensor) -> Tensor:
        """Return V [...] for features [..., F]."""
        value: Tensor = self.body(features).softmax(-1) @ self.centers
        return value

    def loss(self, features: Tensor, target: Tensor) -> Tensor:
        """Return the cross-entropy with a Gaussian around each return [R] (HL-Gauss)."""
        edges = torch.cat([self.centers - self.width / 2, self.centers[-1:] + self.width / 2])
        target = target.clamp(float(edges[0]), float(edges[-1])).unsqueeze(-1)
        cumulative = torch.erf((edges - target) / (SMOOTHING * self.width * math.sqrt(2.0)))
        share = cumulative[:, 1:] - cumulative[:, :-1]
        share = share / (cumulative[:, -1:] - cumulative[:, :1])
        return -(share * self.body(features).log_softmax(-1)).sum(-1).mean()


class DuelingCritic(nn.Module):
    """The value V(s), and the normalised advantage A(s, a)."""

    def __init__(self, inputs: int, actions: int, hidden: int, config: REPPOConfig) -> None:
        """Create the layers.

        Args:
            inputs: length of the features of the state.
            actions: length of an action.
            hidden: width of the hidden layers.
            config: with the categories.
        """
        super().__init__()
        categories = config.bins, config.value_min, config.value_max
        self.value = CategoricalValue(inputs, hidden, *categories)
        self.advantage_body = _mlp(inputs + actions, hidden, 1)

    def advantage(self, features: Tensor, action: Tensor) -> Tensor:
        """Return A [...] for features [..., F] and actions [..., A]."""
        advantage: Tensor = self.advantage_body(torch.cat([features, action], -1)).squeeze(-1)
        return advantage


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, hidden),
        nn.LayerNorm(hidden),
        nn.SiLU(),
        nn.Linear(hidden, hidden),
        nn.LayerNorm(hidden),
        nn.SiLU(),
        nn.Linear(hidden, outputs),
    )


@ALGORITHMS.register("reppo", REPPOConfig)
class REPPO(OnPolicy):
    """The critic of a robot sees the global state and the robot's action."""

    config: REPPOConfig
    heads: Mapping[str, DuelingCritic]  # type: ignore[assignment]
    kl_weight_log: Tensor

    def __init__(self, policy: Policy, config: REPPOConfig) -> None:
        """See `OnPolicy`.

        Raises:
            ConfigurationError: the critic's categories span no interval.
        """
        if config.value_min >= config.value_max:
            raise ConfigurationError(
                f"algorithm.value_min is {config.value_min}; it must be less than "
                f"algorithm.value_max ({config.value_max})"
            )
        super().__init__(policy, config)
        self.register_buffer("kl_weight_log", torch.zeros((), device=policy.device))

    def _make_head(self, level: str, inputs: int) -> DuelingCritic:
        actions = self.policy.action_sizes()[level]
        return DuelingCritic(inputs, actions, self.config.critic_features, self.config)

    def _level_batches(
        self, rollouts: list[Rollout], statistics: Statistics
    ) -> list[dict[str, TensorDict]]:
        """See `OnPolicy.prepare`; each level has its old distribution and the critic's targets."""
        batches = []
        for rollout in rollouts:
            features, old = self._critic_features(rollout), self._distributions(rollout)
            batches.append(
                {
                    level: by_row(self._level_batch(level, rollout, features, *old[level]))
                    for level in self.policy.levels
                }
            )
        for level in self.policy.levels:
            of_level = [batch[level] for batch in batches]
            advantage, target = (
                all_gather_cat(torch.cat([data[key][data["valued"]] for data in of_level]))
                for key in ("advantage", "value_target")
            )
            if len(target) > 1:
                unexplained = advantage.var() / target.var().clamp_min(1e-8)
                statistics[f"losses/{level}_explained_variance"].append(1.0 - float(unexplained))
                for data in of_level:
                    data["advantage"] = (data["advantage"] - advantage.mean()) / advantage.std()
        return batches

    def _distributions(self, rollout: Rollout) -> dict[str, tuple[Tensor, Tensor]]:
        """Return mean and deviation of each level in all steps, [S, T + 1, N, A] each."""
        s, steps, n = rollout.steps["agents", "active_mask"].shape
        samples = torch.arange(s * n * steps, device=self.policy.device)
        sequences = rollout.sequences(torch.arange(s, device=self.policy.device))
        waypoint = rollout.steps["agents"].get("waypoint_features", None)
        if waypoint is not None:
            waypoint = waypoint.transpose(1, 2).flatten(0, 2)
        parts: dict[str, list[tuple[Tensor, Tensor]]] = {level: [] for level in self.policy.levels}
        for chunk in samples.split(CHUNK_SIZE):
            index = {level: torch.arange(len(chunk)) for level in self.policy.levels}
            features = None if waypoint is None else waypoint[chunk]
            for level, y in self.policy.embed(sequences, chunk, features, index).items():
                parts[level].append(self.policy.distribution(level, y, chunk // steps))
        return {
            level: tuple(  # type: ignore[misc]
                torch.cat(values).view(s, n, steps, -1).transpose(1, 2)
                for values in zip(*of_level, strict=True)
            )
            for level, of_level in parts.items()
        }

    def _level_batch(
        self, level: str, rollout: Rollout, features: Tensor, mean: Tensor, std: Tensor
    ) -> dict[str, Tensor]:
        """Return the data of one level, [S, T, N, ...] each."""
        c, head = self.config, self.heads[level]
        of_level, stream = rollout.steps[level_key(level)], streams(rollout.steps)
        reward = rollout.steps["next", *level_key(level), "reward"][:, :-1]
        data = self._level_data(level, rollout)
        if level == LOCAL and "waypoint_features" in data:
            features = torch.cat([features, of_level["waypoint_features"]], -1)
        value = head.value(features)
        if level == MACRO:
            decided = of_level["decision_mask"][:, :-1]
            advantage, target, valued = macro_advantages(
                stream, decided, reward, value, c.discount, c.gae_lambda
            )
            data |= {"decides": valued & decided, "valued": valued}
        else:
            advantage, target = step_advantages(
                stream, reward, value, c.local_discount, c.gae_lambda
            )
            data |= {"decides": stream.acts, "valued": stream.counts}
        data |= {"advantage": advantage, "value_target": target}
        return data | {"old_mean": mean[:, :-1], "old_std": std[:, :-1]}

    def _loss(self, data: TrainingData, statistics: Statistics, divergence: list[float]) -> Tensor:
        policy_loss = self._policy_loss(data, statistics, divergence)
        return policy_loss + self._critic_loss(data, statistics)

    def _policy_loss(
        self, data: TrainingData, statistics: Statistics, divergence: list[float]
    ) -> Tensor:
        """Return minus Q of new actions; where the KL divergence is too large, that alone."""
        total = torch.zeros((), device=self.policy.device)
        steps, levels = selected_decisions(self.policy, data)
        with torch.no_grad():
            row, step = data.selected.nonzero(as_tuple=True)
            features = self.encoder(data.critic_frames.map(lambda x: x[row, step]))
        for level, decisions in levels.items():
            if len(decisions) == 0:
                continue
            mean, std = self.policy.distribution(level, decisions["embedding"], decisions["row"])
            action = (mean + std * torch.randn_like(mean)).clamp(-1.0, 1.0)
            state = _with_waypoint(features[decisions["sample"]], decisions)
            head = self.heads[level].requires_grad_(False)  # the gradient is that of the action
            value = head.advantage(state, action)
            head.requires_grad_(True)
            kl = gaussian_kl(decisions["old_mean"], decisions["old_std"], mean, std)
            within = kl.detach() < self.config.kl_bound
            objective = torch.where(within, -value, self.kl_weight_log.exp() * kl)
            total = total + len(decisions) / steps * objective.mean()
            divergence.append(float(kl.detach().mean()))
            statistics[f"losses/{level}_kl"].append(divergence[-1])
            statistics[f"losses/{level}_value"].append(float(value.detach().mean()))
            statistics[f"losses/{level}_beyond_kl"].append(float((~within).float().mean()))
            if level == LOCAL:
                total = total + self._auxiliary_loss(mean, std, decisions, statistics)
        return total

    def _critic_loss(self, data: TrainingData, statistics: Statistics) -> Tensor:
        """Return the loss of V over all steps, and of A where something was decided."""
        row, step = data.levels[LOCAL]["valued"].nonzero(as_tuple=True)
        features = self.encoder(data.critic_frames.map(lambda x: x[row, step]))
        total = features.new_zeros(())
        for level, of_level in data.levels.items():
            samples = of_level[row, step]
            index = samples["valued"].nonzero().squeeze(1)
            if len(index) == 0:
                continue
            samples, head = samples[index], self.heads[level]
            state = _with_waypoint(features[index], samples)
            value_loss = head.value.loss(state, samples["value_target"])
            advantage = head.advantage(state, samples["action"].clamp(-1.0, 1.0))
            error = (advantage - samples["advantage"]).square() * samples["decides"]
            total = total + value_loss + error.mean()
            statistics[f"losses/{level}_critic"].append(float(value_loss.detach()))
            statistics[f"losses/{level}_advantage_error"].append(float(error.detach().mean()))
        return total


def _with_waypoint(features: Tensor, samples: TensorDict) -> Tensor:
    """Return the critic's features [R, ...] with the waypoint, if the level has one."""
    waypoint = samples.get("waypoint_features", None)
    return features if waypoint is None else torch.cat([features, waypoint], -1)


def gaussian_kl(old_mean: Tensor, old_std: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Return KL(old || new) of diagonal Gaussians [Q, A], [Q]."""
    ratio = (old_std / std).square()
    distance = ((old_mean - mean) / std).square()
    return 0.5 * (ratio + distance - 1.0 - ratio.log()).sum(-1)
