"""Proximal policy optimisation of every level of a policy (SAMARL, Eq. 9 and Algorithm 1).

MAPPO and independent PPO differ in their critics, which are in `mappo.py` and `ippo.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.multiagent import MAPPOLoss

from mrsan.fields import number, required
from samarl.algorithms.advantages import macro_advantages, step_advantages, streams
from samarl.algorithms.critics import PopArtHead
from samarl.algorithms.on_policy import (
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

STATISTICS = {
    "loss_objective": "objective",
    "kl_approx": "approx_kl",
    "clip_fraction": "clip_fraction",
    "ESS": "effective_samples",
    "entropy": "entropy",
}
"""Names of TorchRL's statistics in the logs."""


@dataclass
class PPOConfig(OnPolicyConfig):
    """Hyperparameters of the update."""

    clip_epsilon: float = required(0.0, 0.99, help="clipping range of the probability ratio")
    entropy_coefficient: float = required(0.0, 10.0, help="weight of the entropy bonus")
    macro_entropy_coefficient: float = required(
        0.0, 10.0, help="weight of the entropy bonus of the macro level"
    )
    critic_coefficient: float = required(0.0, 100.0, help="weight of the value loss")
    advantage_filter_fraction: float = required(
        0.01, 1.0, help="share of the samples to learn from, those with the largest advantages"
    )
    target_kl: float | None = number(
        None, 0.0, 1e6, help="KL divergence beyond which epochs stop; null: never"
    )


class PPO(OnPolicy):
    """Clipped PPO of all levels at once: an encoder, and TorchRL's loss for each level."""

    config: PPOConfig
    heads: Mapping[str, PopArtHead]  # type: ignore[assignment]
    loss_class: type[ClipPPOLoss] = MAPPOLoss

    def __init__(self, policy: Policy, config: PPOConfig) -> None:
        """See `OnPolicy`."""
        super().__init__(policy, config)
        self.losses = {level: self._make_loss(level) for level in policy.levels}

    def _make_head(self, level: str, inputs: int) -> PopArtHead:
        return PopArtHead(inputs, self.config.critic_features)

    def _make_loss(self, level: str) -> ClipPPOLoss:
        """Return TorchRL's loss of a level.

        `loss(decisions)` is the policy's part. The critic's part is `loss.loss_critic(samples)`,
        called separately as the critic also learns from steps in which nothing was decided.
        """
        c = self.config
        waypoint = level == LOCAL and MACRO in self.policy.levels
        in_keys = ["critic_features", "waypoint_features"] if waypoint else ["critic_features"]
        return self.loss_class(
            self.policy.actor(level),
            TensorDictModule(self.heads[level], in_keys=in_keys, out_keys=["state_value"]),
            clip_epsilon=c.clip_epsilon,
            entropy_coeff=c.macro_entropy_coefficient if level == MACRO else c.entropy_coefficient,
            critic_coeff=0.0,
            clip_value=c.clip_epsilon,
            loss_critic_type="l2",
            normalize_advantage=False,  # `prepare` does, over the whole rollout
            log_explained_variance=False,
            functional=False,
        )

    def _level_batches(
        self, rollouts: list[Rollout], statistics: Statistics
    ) -> list[dict[str, TensorDict]]:
        """See `OnPolicy.prepare`; updates the value scales once.

        Each level has what TorchRL's loss reads: `sample_log_prob`, `advantage`, `value_target` and
        `state_value` (before the update), the last three normalised.
        """
        features = [self._critic_features(rollout) for rollout in rollouts]
        batches: list[dict[str, TensorDict]] = [{} for _ in rollouts]
        for level, head in self.heads.items():
            parts = zip(rollouts, features, strict=True)
            levels = [self._level_batch(level, *part) for part in parts]
            advantage = all_gather_cat(
                torch.cat([data["advantage"][data["decides"]] for data in levels])
            )
            target = all_gather_cat(
                torch.cat([data["value_target"][data["valued"]] for data in levels])
            )
            value = all_gather_cat(
                torch.cat([data["state_value"][data["valued"]] for data in levels])
            )
            mean, std = advantage.new_zeros(()), advantage.new_ones(())
            if len(advantage) > 1:  # in a short rollout the macro level may not decide at all
                mean, std = advantage.mean(), advantage.std().clamp_min(1e-4)
            if len(target) > 1:
                unexplained = (target - value).var() / target.var().clamp_min(1e-8)
                statistics[f"losses/{level}_explained_variance"].append(1.0 - float(unexplained))
                head.update(target)
            for batch, data in zip(batches, levels, strict=True):
                data["advantage"] = (data["advantage"] - mean) / std
                data["value_target"] = head.normalise(data["value_target"])
                data["state_value"] = head.normalise(data["state_value"])
                batch[level] = data
        return batches

    def _level_batch(self, level: str, rollout: Rollout, features: Tensor) -> TensorDict:
        """Return the data of one level, not yet normalised.

        Args:
            level: the level.
            rollout: S sequences of T + 1 steps.
            features: [S, T + 1, N, F] the critics' view.
        """
        c, head = self.config, self.heads[level]
        of_level, stream = rollout.steps[level_key(level)], streams(rollout.steps)
        reward = rollout.steps["next", *level_key(level), "reward"][:, :-1]
        data = self._level_data(level, rollout)
        if level == MACRO:
            value = head.denormalise(head(features)).squeeze(-1)
            decided = of_level["decision_mask"][:, :-1]
            advantage, target, valued = macro_advantages(
                stream, decided, reward, value, c.discount, c.gae_lambda
            )
            data |= {"decides": valued & decided, "valued": valued}
        else:
            waypoint = [of_level["waypoint_features"]] if "waypoint_features" in data else []
            value = head.denormalise(head(features, *waypoint)).squeeze(-1)
            advantage, target = step_advantages(
                stream, reward, value, c.local_discount, c.gae_lambda
            )
            data |= {"decides": stream.acts, "valued": stream.counts}
        data |= {"advantage": advantage.unsqueeze(-1), "value_target": target.unsqueeze(-1)}
        data["state_value"] = value[:, :-1].unsqueeze(-1)
        return by_row(data)

    def _select(self, batches: list[dict[str, TensorDict]]) -> list[Tensor]:
        """Return the steps [B, T] from which the policy learns.

        They are those with the largest advantages, as most steps are as good as expected and carry
        no signal (Cusumano-Towner et al., Robust autonomy emerges from self-play, 2025), and those
        in which the shield corrected the policy.
        """
        acts = super()._select(batches)
        selected = acts
        if self.config.advantage_filter_fraction < 1.0:
            sizes = []
            for batch in batches:
                of_levels = [
                    data["advantage"].squeeze(-1).abs() * data["decides"] for data in batch.values()
                ]
                sizes.append(torch.stack(of_levels).amax(0))
            pairs = zip(sizes, acts, strict=True)
            every = all_gather_cat(torch.cat([size[where] for size, where in pairs]))
            dropped = int((1.0 - self.config.advantage_filter_fraction) * len(every))
            least = every.kthvalue(max(dropped, 1)).values
            # Not `>=`: NaN must be selected, so that it stops the run.
            selected = [where & ~(size < least) for size, where in zip(sizes, acts, strict=True)]
        if self.uses_shield_targets:
            local = [batch[LOCAL] for batch in batches]
            corrected = [of_rollout["decides"] & of_rollout["unsafe"] for of_rollout in local]
            selected = [chosen | more for chosen, more in zip(selected, corrected, strict=True)]
        return selected

    def _finish_epoch(self, divergence: list[float]) -> bool:
        mean = sum(divergence) / max(len(divergence), 1)
        return self.config.target_kl is not None and mean > self.config.target_kl

    def _loss(self, data: TrainingData, statistics: Statistics, divergence: list[float]) -> Tensor:
        policy_loss = self._policy_loss(data, statistics, divergence)
        return policy_loss + self._value_loss(data, statistics)

    def _policy_loss(
        self, data: TrainingData, statistics: Statistics, divergence: list[float]
    ) -> Tensor:
        """Return the loss of all levels over the selected steps."""
        total = torch.zeros((), device=self.policy.device)
        steps, levels = selected_decisions(self.policy, data)
        for level, decisions in levels.items():
            if len(decisions) == 0:
                continue
            terms = self.losses[level](decisions)
            # Every decision has the same weight. The macro level decides rarely: averaged
            # separately, its noise would drown the local level's signal to the shared encoder.
            share = len(decisions) / steps
            total = total + share * (terms["loss_objective"] + terms["loss_entropy"])
            divergence.append(float(terms["kl_approx"]))
            for key, name in STATISTICS.items():
                statistics[f"losses/{level}_{name}"].append(float(terms[key].detach()))
            if level == LOCAL:
                embedding, row = decisions["embedding"], decisions["row"]
                mean, std = self.policy.distribution(LOCAL, embedding, row)
                total = total + self._auxiliary_loss(mean, std, decisions, statistics)
        return total

    def _value_loss(self, data: TrainingData, statistics: Statistics) -> Tensor:
        """Return the value loss (Yu et al., 2022) over the policy's samples and waiting robots."""
        local = data.levels[LOCAL]
        row, step = (data.selected | (local["valued"] & ~local["decides"])).nonzero(as_tuple=True)
        features = self.encoder(data.critic_frames.map(lambda x: x[row, step]))
        total = features.new_zeros(())
        for level, of_level in data.levels.items():
            samples = of_level[row, step]
            samples["critic_features"] = features
            samples = samples[samples["valued"]]
            if len(samples) > 0:
                loss = self.losses[level].loss_critic(samples)[0].mean()
                total = total + self.config.critic_coefficient * loss
                statistics[f"losses/{level}_critic"].append(float(loss.detach()))
        return total
