"""MAPPO and IPPO: clipped PPO of every level of a policy (SAMARL, Eq. 9 and Algorithm 1).

`PPO.update` learns from the newest rollouts in two steps:

1. `prepare` computes the advantages and value targets of every level (`advantages.py`) and selects
   the steps from which the policy learns.
2. `_run_epochs` shuffles whole sequences into minibatches, and descends on the sum of
   `_policy_loss` (of all levels, with `_auxiliary_loss`) and `_value_loss`.

`MAPPO` and `IPPO`, at the end of the file, differ in what their critics see. Shapes: S sequences,
T steps, N robots, B = S N rows, P selected steps, Q decisions of a level in them.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.objectives import PPOLoss
from torchrl.objectives.multiagent import IPPOLoss, MAPPOLoss

from mrsan import ConfigurationError
from mrsan.fields import number, required, setting
from samarl.algorithms.action_limits import action_limits, excess
from samarl.algorithms.advantages import macro_advantages, step_advantages, streams
from samarl.algorithms.algorithm import ALGORITHMS, Algorithm
from samarl.algorithms.critics import CriticEncoder, PopArtHead
from samarl.algorithms.training_data import MAX_PADDING, TrainingData, merge, minibatches
from samarl.distributed import all_gather_cat, all_gather_object, average_gradients
from samarl.observations.features import state_sizes
from samarl.observations.frames import FeatureSizes, Frames, slice_time, split
from samarl.policies.policy import LOCAL, MACRO, Policy
from samarl.policies.stochastic import Sequences, StochasticPolicy
from samarl.rollout import Rollout, level_key

MACRO_STD_WARMUP = 0.3
"""Share of the training in which the macro level's minimal noise rises from 0.

Waypoints hardly move at first, so that the local level learns to drive to them.
"""

CHUNK_SIZE = 16384
"""Frames per forward pass when no gradient is needed, to bound the memory."""

LOCAL_KEYS = (
    "previous_noise",
    "waypoint_features",
    "speed",
    "unsafe",
    "safe_action",
    "teacher_action",
    "has_teacher",
)
"""What the local level's losses read of a rollout, as far as it is there."""

STATISTICS = {
    "loss_objective": "objective",
    "kl_approx": "approx_kl",
    "clip_fraction": "clip_fraction",
    "ESS": "effective_samples",
    "entropy": "entropy",
}
"""Names of TorchRL's statistics in the logs."""

Statistics = dict[str, list[float]]


@dataclass
class PPOConfig:
    """Hyperparameters of the update."""

    teacher: str | None  # agent of `conf/agent/` that the local level imitates at first
    learning_rate: float = required(0.0, 1.0, help="initial learning rate; falls linearly to 0")
    epochs: int = required(1, 100, help="passes over each rollout")
    minibatches: int = required(1, 1000, help="minibatches per epoch")
    discount: float = required(0.0, 0.9999, help="discount per step")
    gae_lambda: float = required(0.0, 1.0, help="lambda of generalised advantage estimation")
    clip_epsilon: float = required(0.0, 0.99, help="clipping range of ratios and values")
    entropy_coefficient: float = required(0.0, 10.0, help="weight of the entropy bonus")
    macro_entropy_coefficient: float = required(
        0.0, 10.0, help="weight of the entropy bonus of the macro level"
    )
    critic_coefficient: float = required(0.0, 100.0, help="weight of the value loss")
    max_gradient_norm: float = required(
        0.0, 1e6, help="largest gradient norm, of the policy and of the critics separately"
    )
    advantage_filter_fraction: float = required(
        0.01, 1.0, help="share of the samples to learn from, those with the largest advantages"
    )
    action_limit_penalty: float = required(
        0.0, 10.0, help="penalty on means of actions beyond the robots' limits"
    )
    path_penalty: float = required(0.0, 100.0, help="penalty per metre driven; falls linearly to 0")
    shield_coefficient: float = required(
        0.0, 100.0, help="weight of imitating the safety shield where it intervenes"
    )
    teacher_coefficient: float = required(
        0.0, 100.0, help="initial weight of imitating the teacher; falls linearly to 0"
    )
    teacher_end: float = required(
        0.001, 1.0, help="training progress after which the teacher is not imitated any more"
    )
    std_start: float = required(0.01, 10.0, help="initial upper bound of the exploration noise")
    std_end: float = required(
        0.01, 10.0, help="final upper bound of the exploration noise, approached linearly"
    )
    macro_std: float = required(
        0.0, 10.0, help="lower bound of the macro level's noise, below its upper bound"
    )
    critic_width: int = required(8, 1024, help="width of the critics' encoder")
    critic_features: int = required(8, 4096, help="output size of the critics' encoder")
    macro_discount: float | None = number(
        None, 0.0, 1.0, help="discount of the macro level per step; null: the same"
    )
    target_kl: float | None = number(
        None, 0.0, 1e6, help="KL divergence beyond which epochs stop; null: never"
    )


class PPO(Algorithm):
    """Clipped PPO of all levels at once: an encoder, and TorchRL's loss for each level."""

    policy: StochasticPolicy
    config: PPOConfig
    critics: Mapping[str, PopArtHead]  # of each level; their input is that of `critic_encoder`
    loss_class: type[PPOLoss] = MAPPOLoss
    supports_data_parallel = True

    def __init__(self, policy: Policy, config: PPOConfig) -> None:
        """See `Algorithm`.

        Raises:
            ConfigurationError: the policy has no distribution of actions.
        """
        super().__init__(policy, config)
        if not isinstance(policy, StochasticPolicy):
            raise ConfigurationError(
                f"policy is a {type(policy).__name__}, which has no distribution of actions; "
                "algorithm.name must be value_learning, or policy.name flat or hierarchical"
            )
        features = config.critic_features
        self.critic_encoder = CriticEncoder(self._critic_sizes(), config.critic_width, features)
        # The local critic observes the waypoint, as its actor does.
        waypoint = {LOCAL: policy.waypoint_size, MACRO: 0}
        self.critics = nn.ModuleDict(  # type: ignore[assignment]
            {level: PopArtHead(features + waypoint[level], features) for level in policy.levels}
        )
        self.losses = {level: self._make_loss(level) for level in policy.levels}
        self.uses_shield_targets = config.shield_coefficient > 0.0
        self.teacher, self.imitates = config.teacher, config.teacher_coefficient > 0.0
        self.teacher_weight = config.teacher_coefficient
        self.to(policy.device)
        self.optimiser = torch.optim.Adam(
            [*policy.parameters(), *self.parameters()],
            lr=config.learning_rate,
            eps=1e-5,
            fused=policy.device.type in ("cpu", "cuda"),
        )

    def _critic_sizes(self) -> FeatureSizes:
        """Return the sizes of what the critics see, by default of the true state."""
        return state_sizes(self.policy.sizes, self.policy.waypoint_size)

    def _critic_frames(self, rollout: Rollout) -> Frames:
        """Return what the critics see, [B, T + 1, ...]; by default the true state."""
        assert rollout.state is not None
        return rollout.state

    def _loss_settings(self) -> dict[str, Any]:
        """Return the arguments that only this `loss_class` takes."""
        return {"clip_epsilon": self.config.clip_epsilon}

    def _make_loss(self, level: str) -> PPOLoss:
        """Return TorchRL's loss of a level.

        `loss(decisions)` is the policy's part. The critic's part is `loss.loss_critic(samples)`,
        called separately as the critic also learns from steps in which nothing was decided.
        """
        c = self.config
        waypoint = level == LOCAL and MACRO in self.policy.levels
        in_keys = ["critic_features", "waypoint_features"] if waypoint else ["critic_features"]
        return self.loss_class(
            self.policy.actor(level),
            TensorDictModule(self.critics[level], in_keys=in_keys, out_keys=["state_value"]),
            **self._loss_settings(),
            entropy_coeff=c.macro_entropy_coefficient if level == MACRO else c.entropy_coefficient,
            critic_coeff=0.0,
            clip_value=c.clip_epsilon,
            loss_critic_type="l2",
            normalize_advantage=False,  # `_normalise` does, over all rollouts
            log_explained_variance=False,
            functional=False,
        )

    def optimisers(self) -> dict[str, Any]:
        """See `Algorithm.optimisers`."""
        return {"adam": self.optimiser}

    def set_progress(self, progress: float) -> None:
        """Decay learning rate, exploration, path penalty and imitation of the teacher linearly.

        The minimal noise of the macro level rises during the first part, see `MACRO_STD_WARMUP`.
        """
        c = self.config
        self._set_learning_rate(progress)
        path_penalty = c.path_penalty * (1.0 - progress)
        self.reward_shaping = replace(self.reward_shaping, path_penalty=path_penalty)
        self.teacher_weight = c.teacher_coefficient * max(1.0 - progress / c.teacher_end, 0.0)
        self.imitates = self.teacher_weight > 0.0
        largest = c.std_start + (c.std_end - c.std_start) * progress
        least = {LOCAL: 0.0, MACRO: c.macro_std * min(progress / MACRO_STD_WARMUP, 1.0)}
        for level in self.policy.levels:
            self.policy.bound_std(level, least[level], largest)

    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Run all epochs over the rollouts of one or several stages."""
        rollouts = [rollout.to(self.policy.device) for rollout in rollouts]
        statistics: Statistics = defaultdict(list)
        self._run_epochs(self.prepare(rollouts, statistics), statistics)
        return {key: sum(values) / len(values) for key, values in statistics.items() if values}

    # Advantages, and the steps to learn from

    @torch.no_grad()
    def prepare(self, rollouts: list[Rollout], statistics: Statistics) -> list[TrainingData]:
        """Return what the losses read: all rollouts, in as few parts as `merge` allows.

        Each level has a TensorDict [B, T] with its `action` and `sample_log_prob`, its `advantage`,
        `value_target` and `state_value` (before the update), all three normalised, and the masks
        `decides` (the level made a decision that counts) and `valued` (the critic learns from it).
        The local level also has what `_auxiliary_loss` reads.
        """
        features = [self._critic_features(rollout) for rollout in rollouts]
        levels: list[dict[str, TensorDict]] = [{} for _ in rollouts]  # of each rollout
        for level in self.policy.levels:
            pairs = zip(rollouts, features, strict=True)
            data = [self._level_data(level, *pair) for pair in pairs]
            self._normalise(level, data, statistics)
            for rollout_levels, level_data in zip(levels, data, strict=True):
                rollout_levels[level] = level_data
        parts = []
        for rollout, rollout_levels, selected in zip(
            rollouts, levels, self._select(levels), strict=True
        ):
            row = torch.arange(len(selected), device=selected.device)
            parts.append(
                TrainingData(
                    Sequences(rollout.frames, rollout.is_init, rollout.encoder),
                    self._critic_frames(rollout),
                    rollout_levels,
                    selected,
                    row % rollout.robots,
                    row // rollout.robots,
                )
            )
        return merge(parts)

    def _critic_features(self, rollout: Rollout) -> Tensor:
        """Return the critics' view of all steps, [S, T + 1, N, F]."""
        frames = self._critic_frames(rollout).apply(lambda x: x.flatten(0, 1))
        features = torch.cat([self.critic_encoder(part) for part in split(frames, CHUNK_SIZE)])
        s, n = len(rollout.steps), rollout.robots
        return features.view(s, n, -1, features.shape[-1]).transpose(1, 2)

    def _level_data(self, level: str, rollout: Rollout, features: Tensor) -> TensorDict:
        """Return the data of one level [B, T] as in `prepare`, not yet normalised."""
        c, critic = self.config, self.critics[level]
        steps, stream = rollout.steps[level_key(level)], streams(rollout.steps)
        reward = rollout.steps["next", *level_key(level), "reward"][:, :-1]
        data = {key: steps[key][:, :-1] for key in ("action", "sample_log_prob")}
        if level == MACRO:
            value = critic.denormalise(critic(features)).squeeze(-1)
            decided = steps["decision_mask"][:, :-1]
            discount = c.discount if c.macro_discount is None else c.macro_discount
            advantage, target, valued = macro_advantages(
                stream, decided, reward, value, discount, c.gae_lambda
            )
            data |= {"decides": valued & decided, "valued": valued}
        else:
            waypoint = [steps["waypoint_features"]] if MACRO in self.policy.levels else []
            value = critic.denormalise(critic(features, *waypoint)).squeeze(-1)
            advantage, target = step_advantages(stream, reward, value, c.discount, c.gae_lambda)
            data |= {"decides": stream.acts, "valued": stream.counts}
            present = [key for key in LOCAL_KEYS if steps.get(key, None) is not None]
            data |= {key: steps[key][:, :-1] for key in present}
            limits = torch.tensor(action_limits(rollout.scenario), device=reward.device)
            data["action_limits"] = limits.expand(*reward.shape, -1)
            data["noise_correlation"] = torch.full_like(reward, rollout.correlation).unsqueeze(-1)
        data |= {"advantage": advantage.unsqueeze(-1), "value_target": target.unsqueeze(-1)}
        data["state_value"] = value[:, :-1].unsqueeze(-1)
        by_row = {key: x.transpose(1, 2).flatten(0, 1) for key, x in data.items()}
        return TensorDict(by_row, by_row["action"].shape[:2])

    def _normalise(self, level: str, data: list[TensorDict], statistics: Statistics) -> None:
        """Normalise the advantages and values of a level, over all rollouts and processes.

        The scale of the critic is updated once.
        """
        critic = self.critics[level]
        advantage, target, value = (
            all_gather_cat(torch.cat([part[key][part[mask]] for part in data]))
            for key, mask in (
                ("advantage", "decides"),
                ("value_target", "valued"),
                ("state_value", "valued"),
            )
        )
        mean, std = advantage.new_zeros(()), advantage.new_ones(())
        if len(advantage) > 1:  # in a short rollout the macro level may not decide at all
            mean, std = advantage.mean(), advantage.std().clamp_min(1e-4)
        if len(target) > 1:
            unexplained = (target - value).var() / target.var().clamp_min(1e-8)
            statistics[f"losses/{level}_explained_variance"].append(1.0 - float(unexplained))
            critic.update(target)
        for part in data:
            part["advantage"] = (part["advantage"] - mean) / std
            part["value_target"] = critic.normalise(part["value_target"])
            part["state_value"] = critic.normalise(part["state_value"])

    def _select(self, levels: list[dict[str, TensorDict]]) -> list[Tensor]:
        """Return the steps [B, T] of each rollout from which the policy learns.

        They are those with the largest advantages, as most steps are as good as expected and carry
        no signal (Cusumano-Towner et al., Robust autonomy emerges from self-play, 2025), and those
        in which the shield corrected the policy.
        """
        acts = [level_data[LOCAL]["decides"] for level_data in levels]
        selected = acts
        if self.config.advantage_filter_fraction < 1.0:
            sizes = []
            for level_data in levels:
                size = [
                    data["advantage"].squeeze(-1).abs() * data["decides"]
                    for data in level_data.values()
                ]
                sizes.append(torch.stack(size).amax(0))
            pairs = zip(sizes, acts, strict=True)
            every = all_gather_cat(torch.cat([size[where] for size, where in pairs]))
            dropped = int((1.0 - self.config.advantage_filter_fraction) * len(every))
            least = every.kthvalue(max(dropped, 1)).values
            # Not `>=`: NaN must be selected, so that it stops the run.
            selected = [where & ~(size < least) for size, where in zip(sizes, acts, strict=True)]
        if self.uses_shield_targets:
            corrected = [
                where & data[LOCAL]["unsafe"] for where, data in zip(acts, levels, strict=True)
            ]
            selected = [chosen | more for chosen, more in zip(selected, corrected, strict=True)]
        return selected

    # Optimisation

    def _run_epochs(self, data: list[TrainingData], statistics: Statistics) -> float:
        """Take all steps of the optimiser: whole sequences are shuffled into minibatches.

        Returns:
            The mean KL divergence of the last epoch from the policy that collected.
        """
        c, mean = self.config, 0.0
        skips_empty = all(networks.encoder.skips_empty_slots for networks in self.policy.networks)
        max_padding = math.inf if skips_empty else MAX_PADDING
        for epoch in range(1, c.epochs + 1):
            statistics["losses/epochs"] = [float(epoch)]  # the last one that was run
            divergence: list[float] = []
            for minibatch in minibatches(data, c.minibatches, max_padding):
                self.optimiser.zero_grad(set_to_none=True)
                rows = sum(len(part.robot) for part in minibatch)
                for part in minibatch:
                    policy_loss = self._policy_loss(part, statistics, divergence)
                    loss = policy_loss + self._value_loss(part, statistics)
                    if loss.requires_grad:  # otherwise no sample counts
                        (loss * (len(part.robot) / rows)).backward()
                self._descend(statistics)
            divergence = [value for values in all_gather_object(divergence) for value in values]
            mean = sum(divergence) / max(len(divergence), 1)
            if c.target_kl is not None and mean > c.target_kl:
                break
        return mean

    def _descend(self, statistics: Statistics) -> None:
        """Clip the gradients of policy and critics separately, and take a step."""
        average_gradients([*self.policy.parameters(), *self.parameters()])
        for name, module in (("actor", self.policy), ("critic", self)):
            norm = nn.utils.clip_grad_norm_(module.parameters(), self.config.max_gradient_norm)
            if not torch.isfinite(norm):
                raise FloatingPointError(f"the gradient of the {name} is not finite")
            statistics[f"losses/{name}_gradient_norm"].append(float(norm))
        self.optimiser.step()

    def _policy_loss(
        self, data: TrainingData, statistics: Statistics, divergence: list[float]
    ) -> Tensor:
        """Return the loss of all levels over the selected steps (SAMARL, Eq. 9).

        The KL divergences from the policy that collected are appended to `divergence`.
        """
        total = torch.zeros((), device=self.policy.device)
        steps, levels = self._selected_decisions(data)
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
                if (value := terms.get(key, None)) is not None:
                    statistics[f"losses/{level}_{name}"].append(float(value.detach()))
            if level == LOCAL:
                total = total + self._auxiliary_loss(decisions, statistics)
        return total

    def _selected_decisions(self, data: TrainingData) -> tuple[int, dict[str, TensorDict]]:
        """Encode the selected steps of a minibatch.

        Returns:
            The number P of selected steps, and each level's decisions in them [Q]: its data with
            the inputs `embedding` and `row` of `StochasticPolicy.actor`.
        """
        row, step = data.selected.nonzero(as_tuple=True)
        samples = {level: level_data[row, step] for level, level_data in data.levels.items()}  # [P]
        index = {level: part["decides"].nonzero().squeeze(1) for level, part in samples.items()}
        embeddings = self.policy.embed(
            data.sequences,
            row * (data.selected.shape[1] + 1) + step,  # sequences have one more step
            samples[LOCAL].get("waypoint_features", None),
            index,
        )
        decisions = {}
        for level, embedding in embeddings.items():
            decisions[level] = samples[level][index[level]]
            decisions[level]["embedding"] = embedding
            decisions[level]["row"] = row[index[level]]
        return len(row), decisions

    def _auxiliary_loss(self, decisions: TensorDict, statistics: Statistics) -> Tensor:
        """Return the penalties on the local level's means [Q, A]: limits, shield and teacher."""
        c = self.config
        mean, std = self.policy.distribution(LOCAL, decisions["embedding"], decisions["row"])
        total = mean.new_zeros(())
        if c.action_limit_penalty > 0.0:
            speed, limits = decisions["speed"], decisions["action_limits"]
            beyond = excess(mean, std, speed, limits).mean()
            total = total + c.action_limit_penalty * beyond
            statistics["losses/action_limit_penalty"].append(float(beyond.detach()))
        if self.uses_shield_targets:
            unsafe = decisions["unsafe"]
            error = (mean - decisions["safe_action"]).square().sum(-1)
            wrong = (error * unsafe).mean()
            total = total + c.shield_coefficient * wrong
            statistics["losses/unsafe"].append(float(unsafe.float().mean()))
            statistics["losses/shield_error"].append(float(wrong.detach()))
        if self.imitates and "has_teacher" in decisions and decisions["has_teacher"].any():
            has_teacher = decisions["has_teacher"]
            error = (mean - decisions["teacher_action"])[has_teacher].square().sum(-1)
            total = total + self.teacher_weight * error.sum() / len(decisions)
            statistics["losses/teacher_error"].append(float(error.mean().detach()))
        return total

    def _value_loss(self, data: TrainingData, statistics: Statistics) -> Tensor:
        """Return the value loss (Yu et al., 2022) over the policy's samples and waiting robots."""
        local = data.levels[LOCAL]
        row, step = (data.selected | (local["valued"] & ~local["decides"])).nonzero(as_tuple=True)
        features = self.critic_encoder(data.critic_frames.apply(lambda x: x[row, step]))
        total = features.new_zeros(())
        for level, level_data in data.levels.items():
            samples = level_data[row, step]
            samples["critic_features"] = features
            samples = samples[samples["valued"]]
            if len(samples) > 0:
                loss = self.losses[level].loss_critic(samples)[0].mean()
                total = total + self.config.critic_coefficient * loss
                statistics[f"losses/{level}_critic"].append(float(loss.detach()))
        return total


@ALGORITHMS.register("mappo", PPOConfig)
class MAPPO(PPO):
    """The critic of a robot sees the true state of the team, relative to that robot."""

    uses_global_state = True


@dataclass
class IPPOConfig(PPOConfig):
    """Hyperparameters of independent PPO."""

    team_reward: bool = setting(
        False, kw_only=True, help="reward every robot when all have arrived, as in MAPPO"
    )


@ALGORITHMS.register("ippo", IPPOConfig)
class IPPO(PPO):
    """Every robot for itself, the paper's SAMARL-PPO (SAMARL, Sec. V).

    The critic sees what its robot sees; rewards exclude the team bonus unless `team_reward`.
    """

    config: IPPOConfig
    loss_class = IPPOLoss

    def __init__(self, policy: Policy, config: IPPOConfig) -> None:
        """See `PPO`."""
        super().__init__(policy, config)
        self.reward_shaping = replace(self.reward_shaping, team_bonus=config.team_reward)

    def _critic_sizes(self) -> FeatureSizes:
        return self.policy.sizes

    def _critic_frames(self, rollout: Rollout) -> Frames:
        return slice_time(rollout.frames, slice(self.policy.history, None))
