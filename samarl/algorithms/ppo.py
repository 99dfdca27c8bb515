"""Proximal policy optimisation of every level of a policy (SAMARL, Eq. 9 and Algorithm 1).

MAPPO and independent PPO differ in their critics, which are in `mappo.py` and `ippo.py`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.multiagent import MAPPOLoss

from mrsan import ConfigurationError
from mrsan.fields import number, required
from samarl.algorithms.action_limits import action_limits, excess
from samarl.algorithms.advantages import macro_advantages, step_advantages, streams
from samarl.algorithms.algorithm import Algorithm
from samarl.algorithms.critics import CriticEncoder, PopArtHead
from samarl.algorithms.training_data import TrainingData, merge
from samarl.distributed import all_gather_cat, all_gather_object, average_gradients
from samarl.observations.frames import Frames
from samarl.policies.hierarchical import WAYPOINT_FEATURES
from samarl.policies.policy import LOCAL, MACRO, Policy
from samarl.policies.stochastic import Sequences, StochasticPolicy
from samarl.rollout import Rollout, level_key

MACRO_RISE = 0.3
"""Share of the training in which the macro level's minimal noise rises from 0.

Waypoints hardly move at first, so that the local level learns to drive to them.
"""

CHUNK_SIZE = 16384
"""Frames per forward pass of the critics when no gradient is needed, to bound the memory."""

LOCAL_KEYS = ("previous_noise", "waypoint_features", "speed", "unsafe", "safe_action")
"""What the local level's losses read of a rollout, as far as it is there."""

STATISTICS = {
    "loss_objective": "objective",
    "kl_approx": "approx_kl",
    "clip_fraction": "clip_fraction",
    "ESS": "effective_samples",
    "entropy": "entropy",
}
"""Names of TorchRL's statistics in the logs."""


@dataclass
class PPOConfig:
    """Hyperparameters of the update."""

    learning_rate: float = required(0.0, 1.0, help="initial learning rate; falls linearly to 0")
    epochs: int = required(1, 100, help="passes over each rollout")
    minibatches: int = required(1, 1000, help="minibatches per epoch")
    discount: float = required(0.0, 1.0, help="discount of the macro level, per step")
    local_discount: float = required(0.0, 0.9999, help="discount of the local level, per step")
    gae_lambda: float = required(0.0, 1.0, help="lambda of generalised advantage estimation")
    clip_epsilon: float = required(0.0, 0.99, help="clipping range of the probability ratio")
    entropy_coefficient: float = required(0.0, 10.0, help="weight of the entropy bonus")
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
    action_limit_slack: float = required(
        0.0, 10.0, help="standard deviations beyond the limits that cost nothing"
    )
    path_penalty: float = required(0.0, 100.0, help="penalty per metre driven; falls linearly to 0")
    shield_coefficient: float = required(
        0.0, 100.0, help="weight of imitating the safety shield where it intervenes"
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
    target_kl: float | None = number(
        None, 0.0, 1e6, help="KL divergence beyond which epochs stop; null: never"
    )


Statistics = dict[str, list[float]]


class PPO(Algorithm):
    """Clipped PPO of all levels at once: an encoder, and TorchRL's loss for each level."""

    policy: StochasticPolicy
    config: PPOConfig
    heads: Mapping[str, PopArtHead]
    loss_class: type[ClipPPOLoss] = MAPPOLoss
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
        self.encoder, size = self._make_critic(config), config.critic_features
        # The local critic observes the waypoint, as its actor does.
        extra = {LOCAL: WAYPOINT_FEATURES if MACRO in policy.levels else 0, MACRO: 0}
        self.heads = nn.ModuleDict(  # type: ignore[assignment]
            {level: PopArtHead(size + extra[level], size) for level in policy.levels}
        )
        self.uses_shield_targets = config.shield_coefficient > 0.0
        self.to(policy.device)
        self.losses = {level: self._make_loss(level) for level in policy.levels}
        self.optimiser = torch.optim.Adam(
            [*policy.parameters(), *self.parameters()],
            lr=config.learning_rate,
            eps=1e-5,
            fused=policy.device.type in ("cpu", "cuda"),
        )

    @abstractmethod
    def _make_critic(self, config: PPOConfig) -> CriticEncoder:
        """Return the encoder of the critics."""

    @abstractmethod
    def _critic_frames(self, rollout: Rollout) -> Frames:
        """Return the input of the critics, [B, T + 1, ...]."""

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
            entropy_coeff=c.entropy_coefficient,
            critic_coeff=0.0,
            clip_value=c.clip_epsilon,
            loss_critic_type="l2",
            normalize_advantage=False,  # `prepare` does, over the whole rollout
            log_explained_variance=False,
            functional=False,
        )

    def set_progress(self, share: float) -> None:
        """Decay learning rate, exploration and path penalty linearly.

        The minimal noise of the macro level rises during the first part, see `MACRO_RISE`.
        """
        c = self.config
        self.reward_shaping.path_penalty = c.path_penalty * (1.0 - share)
        self._set_learning_rate(share)
        largest = c.std_start + (c.std_end - c.std_start) * share
        for level in self.policy.levels:
            rising = min(share / MACRO_RISE, 1.0) if level == MACRO else 0.0
            self.policy.bound_std(level, c.macro_std * rising, largest)

    def optimisers(self) -> dict[str, Any]:
        """See `Algorithm.optimisers`."""
        return {"adam": self.optimiser}

    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Run all epochs over the rollouts of one or several stages."""
        rollouts = [rollout.to(self.policy.device) for rollout in rollouts]
        statistics: Statistics = defaultdict(list)
        self._run_epochs(self.prepare(rollouts, statistics), statistics)
        return {key: sum(values) / len(values) for key, values in statistics.items()}

    @torch.no_grad()
    def prepare(self, rollouts: list[Rollout], statistics: Statistics) -> list[TrainingData]:
        """Return what the losses read, and update the value scales once.

        Returns:
            The rows of all rollouts, in as few parts as `merge` allows. Each level has a TensorDict
            [B, T] with the keys that TorchRL's loss reads: `action`, `sample_log_prob`,
            `advantage`, `value_target` and `state_value` (before the update), the last three
            normalised, and the inputs of actor and critic but the encoded ones; with `decides` (the
            level made a decision that counts), `valued` (the critic learns from this step); and of
            the local level what its auxiliary losses read.
        """
        features = [self._critic_features(rollout) for rollout in rollouts]
        batches: list[dict[str, TensorDict]] = [{} for _ in rollouts]
        for level, head in self.heads.items():
            pairs = zip(rollouts, features, strict=True)
            levels = [self._level_batch(level, rollout, feature) for rollout, feature in pairs]
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
        parts = zip(rollouts, batches, self._select(batches), strict=True)
        return merge([self._training_data(*part) for part in parts])

    def _training_data(
        self, rollout: Rollout, levels: dict[str, TensorDict], selected: Tensor
    ) -> TrainingData:
        """Return the rows of one rollout."""
        row = torch.arange(len(selected), device=selected.device)
        return TrainingData(
            Sequences(rollout.frames, rollout.is_init, rollout.encoder),
            self._critic_frames(rollout),
            levels,
            selected,
            row % rollout.robots,
            row // rollout.robots,
        )

    def _critic_features(self, rollout: Rollout) -> Tensor:
        """Return the critics' view of all steps, [S, T + 1, N, F]."""
        frames = self._critic_frames(rollout).map(lambda x: x.flatten(0, 1))
        features = torch.cat([self.encoder(part) for part in frames.split(CHUNK_SIZE)])
        s, n = len(rollout.steps), rollout.robots
        return features.view(s, n, -1, features.shape[-1]).transpose(1, 2)

    def _level_batch(self, level: str, rollout: Rollout, features: Tensor) -> TensorDict:
        """Return the data of one level, see `prepare`, not yet normalised."""
        c, agents, head = self.config, rollout.steps["agents"], self.heads[level]
        of_level, stream = rollout.steps[level_key(level)], streams(rollout.steps)
        reward = rollout.steps["next", *level_key(level), "reward"][:, :-1]
        data = {key: of_level[key][:, :-1] for key in ("action", "sample_log_prob")}
        if level == MACRO:
            value = head.denormalise(head(features)).squeeze(-1)
            decided = of_level["decision_mask"][:, :-1]
            advantage, target, valued = macro_advantages(
                stream, decided, reward, value, c.discount, c.gae_lambda
            )
            data |= {"decides": valued & decided, "valued": valued}
        else:
            present = [key for key in LOCAL_KEYS if agents.get(key, None) is not None]
            waypoint = [agents["waypoint_features"]] if "waypoint_features" in present else []
            value = head.denormalise(head(features, *waypoint)).squeeze(-1)
            advantage, target = step_advantages(
                stream, reward, value, c.local_discount, c.gae_lambda
            )
            data |= {"decides": stream.acts, "valued": stream.counts}
            data |= {key: agents[key][:, :-1] for key in present}
            correlation = torch.full_like(advantage, rollout.correlation)
            data["noise_correlation"] = correlation.unsqueeze(-1)
            limits = torch.tensor(action_limits(rollout.scenario), device=advantage.device)
            data["action_limits"] = limits.expand(*advantage.shape, -1)
        data |= {"advantage": advantage.unsqueeze(-1), "value_target": target.unsqueeze(-1)}
        data["state_value"] = value[:, :-1].unsqueeze(-1)
        by_row = {key: x.transpose(1, 2).flatten(0, 1) for key, x in data.items()}
        return TensorDict(by_row, by_row["decides"].shape)

    def _select(self, batches: list[dict[str, TensorDict]]) -> list[Tensor]:
        """Return the steps [B, T] from which the policy learns.

        They are those with the largest advantages, as most steps are as good as expected and carry
        no signal (Cusumano-Towner et al., Robust autonomy emerges from self-play, 2025), and those
        in which the shield corrected the policy.
        """
        acts = [batch[LOCAL]["decides"] for batch in batches]
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
            pairs = zip(selected, (batch[LOCAL] for batch in batches), strict=True)
            selected = [chosen | (local["decides"] & local["unsafe"]) for chosen, local in pairs]
        return selected

    def _run_epochs(self, data: list[TrainingData], statistics: Statistics) -> None:
        """Take all steps of the optimiser: whole sequences are shuffled into minibatches."""
        for epoch in range(1, self.config.epochs + 1):
            statistics["losses/epochs"] = [float(epoch)]  # the last one that was run
            divergence: list[float] = []
            minibatches = [part.minibatches(self.config.minibatches) for part in data]
            for minibatch in zip(*minibatches, strict=True):
                self.optimiser.zero_grad(set_to_none=True)
                rows = sum(len(part.robot) for part in minibatch)
                for part in minibatch:
                    if len(part.robot) == 0:
                        continue
                    loss = self._policy_loss(part, statistics, divergence)
                    loss = loss + self._value_loss(part, statistics)
                    if loss.requires_grad:  # otherwise no sample counts
                        (loss * (len(part.robot) / rows)).backward()
                self._descend(statistics)
            divergence = [value for values in all_gather_object(divergence) for value in values]
            mean_kl = sum(divergence) / max(len(divergence), 1)
            if self.config.target_kl is not None and mean_kl > self.config.target_kl:
                break

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
        """Return the loss of all levels over the selected steps."""
        row, step = data.selected.nonzero(as_tuple=True)
        samples = {level: of_level[row, step] for level, of_level in data.levels.items()}  # [P]
        index = {
            level: of_level["decides"].nonzero().squeeze(1) for level, of_level in samples.items()
        }
        embeddings = self.policy.embed(
            data.sequences,
            row * (data.selected.shape[1] + 1) + step,  # sequences have one more step
            samples[LOCAL].get("waypoint_features", None),
            index,
        )
        total = torch.zeros((), device=self.policy.device)
        for level, embedding in embeddings.items():
            decisions = samples[level][index[level]]
            if len(decisions) == 0:
                continue
            decisions["embedding"], decisions["row"] = embedding, row[index[level]]
            terms = self.losses[level](decisions)
            # Every decision has the same weight. The macro level decides rarely: averaged
            # separately, its noise would drown the local level's signal to the shared encoder.
            share = len(decisions) / len(row)
            total = total + share * (terms["loss_objective"] + terms["loss_entropy"])
            divergence.append(float(terms["kl_approx"]))
            for key, name in STATISTICS.items():
                statistics[f"losses/{level}_{name}"].append(float(terms[key].detach()))
            if level == LOCAL:
                total = total + self._auxiliary_loss(decisions, statistics)
        return total

    def _auxiliary_loss(self, decisions: TensorDict, statistics: Statistics) -> Tensor:
        """Return the penalties on the local level's means: robots' limits and the shield."""
        c = self.config
        total = torch.zeros((), device=self.policy.device)
        if c.action_limit_penalty == 0.0 and not self.uses_shield_targets:
            return total
        mean, std = self.policy.distribution(LOCAL, decisions["embedding"], decisions["row"])
        if c.action_limit_penalty > 0.0:
            speed, limits = decisions["speed"], decisions["action_limits"]
            beyond = excess(mean, std, speed, limits, c.action_limit_slack).mean()
            total = total + c.action_limit_penalty * beyond
            statistics["losses/action_limit_penalty"].append(float(beyond.detach()))
        if self.uses_shield_targets:
            unsafe = decisions["unsafe"]
            error = (mean - decisions["safe_action"]).square().sum(-1)
            wrong = (error * unsafe).mean()
            total = total + c.shield_coefficient * wrong
            statistics["losses/unsafe"].append(float(unsafe.float().mean()))
            statistics["losses/shield_error"].append(float(wrong.detach()))
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
