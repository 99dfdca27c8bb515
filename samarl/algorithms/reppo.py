"""REPPO: on-policy learning with action values instead of advantages.

Relative Entropy Pathwise Policy Optimization (Voelcker et al., 2025): a categorical critic learns
Q(s, a) from multi-step returns of the newest rollout alone, the policy follows the gradient of Q
through its own actions, and a KL bound keeps it near the policy that collected the rollout. Here
every level of a policy has its Q, whose input is the true state of the team and the robot's own
action. As the standard deviation of the actors does not depend on the state, it follows a schedule
and there is no entropy bonus.
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
from samarl.policies.policy import LOCAL, MACRO, Policy
from samarl.rollout import Rollout, level_key

SMOOTHING = 0.75  # standard deviation of the targets' histogram in bins (Farebrother et al., 2024)
KL_WEIGHT_RATE = 0.01  # learning rate of the logarithm of the weight of the KL divergence


@dataclass
class REPPOConfig(OnPolicyConfig):
    """Hyperparameters of REPPO."""

    bins: int = required(3, 10001, help="number of categories of the critic")
    value_min: float = required(-1e6, 1e6, help="smallest return of the critic's categories")
    value_max: float = required(-1e6, 1e6, help="largest return of the critic's categories")
    kl_bound: float = required(0.0, 100.0, help="largest KL divergence from the old policy")


class CategoricalCritic(nn.Module):
    """Q(s, a) as the mean of a histogram over returns, learned by cross-entropy (HL-Gauss)."""

    centers: Tensor

    def __init__(self, inputs: int, hidden: int, config: REPPOConfig) -> None:
        """Create the layers; `inputs` counts the features of the state and the action."""
        super().__init__()
        self.body = nn.Sequential(
            nn.Linear(inputs, hidden),
            nn.LayerNorm(hidden),
            nn.SiLU(),
            nn.Linear(hidden, hidden),
            nn.LayerNorm(hidden),
            nn.SiLU(),
            nn.Linear(hidden, config.bins),
        )
        width = (config.value_max - config.value_min) / config.bins
        centers = config.value_min + width * (torch.arange(config.bins) + 0.5)
        self.register_buffer("centers", centers)
        self.width = width

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return the logits of the histogram, [..., bins]."""
        logits: Tensor = self.body(torch.cat(inputs, -1))
        return logits

    def value(self, logits: Tensor) -> Tensor:
        """Return the mean of a histogram, [...]."""
        return logits.softmax(-1) @ self.centers

    def loss(self, logits: Tensor, target: Tensor) -> Tensor:
        """Return the cross-entropy with a Gaussian around each target [R], cut at the ends."""
        edges = torch.cat([self.centers - self.width / 2, self.centers[-1:] + self.width / 2])
        target = target.clamp(float(edges[0]), float(edges[-1])).unsqueeze(-1)
        scale = SMOOTHING * self.width * math.sqrt(2.0)
        cumulative = torch.erf((edges - target) / scale)
        share = cumulative[:, 1:] - cumulative[:, :-1]
        share = share / (cumulative[:, -1:] - cumulative[:, :1])
        return -(share * logits.log_softmax(-1)).sum(-1).mean()


@ALGORITHMS.register("reppo", REPPOConfig)
class REPPO(OnPolicy):
    """The critic of a robot sees the global state and the robot's action."""

    config: REPPOConfig
    heads: Mapping[str, CategoricalCritic]  # type: ignore[assignment]

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
        for level in policy.levels:
            self.register_buffer(f"kl_weight_log_{level}", torch.zeros((), device=policy.device))

    def _make_head(self, level: str, inputs: int) -> CategoricalCritic:
        actions = self.policy.action_sizes()[level]
        return CategoricalCritic(inputs + actions, self.config.critic_features, self.config)

    def _level_batches(
        self, rollouts: list[Rollout], statistics: Statistics
    ) -> list[dict[str, TensorDict]]:
        """See `OnPolicy.prepare`; each level has its old distribution and the targets of Q."""
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
            target, value = (
                torch.cat([batch[level][key][batch[level]["valued"]] for batch in batches])
                for key in ("value_target", "state_value")
            )
            if len(target) > 1:
                unexplained = (target - value).var() / target.var().clamp_min(1e-8)
                statistics[f"losses/{level}_explained_variance"].append(1.0 - float(unexplained))
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
        active = rollout.steps["agents", "active_mask"].unsqueeze(-1)
        action, waypoint = of_level["action"], []
        if level == MACRO:  # where no waypoint was chosen, the value is that of a new choice
            chosen = of_level["decision_mask"].unsqueeze(-1)
            action = torch.where(chosen, action, mean + std * torch.randn_like(mean))
        elif "waypoint_features" in data:
            waypoint = [of_level["waypoint_features"]]
        action = action.clamp(-1.0, 1.0) * active
        value = head.value(head(features, *waypoint, action))
        if level == MACRO:
            decided = of_level["decision_mask"][:, :-1]
            _, target, valued = macro_advantages(
                stream, decided, reward, value, c.discount, c.gae_lambda
            )
            data |= {"decides": valued & decided, "valued": valued}
        else:
            _, target = step_advantages(stream, reward, value, c.local_discount, c.gae_lambda)
            data |= {"decides": stream.acts, "valued": stream.counts}
        data |= {"executed": action[:, :-1], "value_target": target, "state_value": value[:, :-1]}
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
            inputs = [features[decisions["sample"]]]
            if level == LOCAL and "waypoint_features" in decisions:
                inputs.append(decisions["waypoint_features"])
            head = self.heads[level].requires_grad_(False)  # the gradient is that of the action
            value = head.value(head(*inputs, action))
            head.requires_grad_(True)
            kl = gaussian_kl(decisions["old_mean"], decisions["old_std"], mean, std)
            weight_log = getattr(self, f"kl_weight_log_{level}")
            with torch.no_grad():  # the weight rises while the divergence is too large
                excess = (kl.mean() / self.config.kl_bound - 1.0).clamp(-1.0, 1.0)
                weight_log.add_(KL_WEIGHT_RATE * excess)
                weight_log.clamp_(-5.0, 5.0)
            within = kl.detach() < self.config.kl_bound
            objective = torch.where(within, -value, weight_log.exp() * kl)
            total = total + len(decisions) / steps * objective.mean()
            divergence.append(float(kl.detach().mean()))
            statistics[f"losses/{level}_kl"].append(divergence[-1])
            statistics[f"losses/{level}_value"].append(float(value.detach().mean()))
            statistics[f"losses/{level}_beyond_kl"].append(float((~within).float().mean()))
            if level == LOCAL:
                total = total + self._auxiliary_loss(mean, std, decisions, statistics)
        return total

    def _critic_loss(self, data: TrainingData, statistics: Statistics) -> Tensor:
        """Return the cross-entropy between the critics and their targets."""
        row, step = data.levels[LOCAL]["valued"].nonzero(as_tuple=True)
        features = self.encoder(data.critic_frames.map(lambda x: x[row, step]))
        total = features.new_zeros(())
        for level, of_level in data.levels.items():
            samples = of_level[row, step]
            index = samples["valued"].nonzero().squeeze(1)
            if len(index) == 0:
                continue
            samples, inputs = samples[index], [features[index]]
            if level == LOCAL and "waypoint_features" in samples:
                inputs.append(samples["waypoint_features"])
            logits = self.heads[level](*inputs, samples["executed"])
            loss = self.heads[level].loss(logits, samples["value_target"])
            total = total + loss
            statistics[f"losses/{level}_critic"].append(float(loss.detach()))
        return total


def gaussian_kl(old_mean: Tensor, old_std: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    """Return KL(old || new) of diagonal Gaussians [Q, A], [Q]."""
    ratio = (old_std / std).square()
    distance = ((old_mean - mean) / std).square()
    return 0.5 * (ratio + distance - 1.0 - ratio.log()).sum(-1)
