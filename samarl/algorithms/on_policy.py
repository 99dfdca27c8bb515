"""What on-policy algorithms share: schedules, minibatches, critics' inputs and auxiliary losses."""

from __future__ import annotations

from abc import abstractmethod
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor, nn

from mrsan import ConfigurationError
from mrsan.fields import required
from samarl.algorithms.action_limits import action_limits, excess
from samarl.algorithms.algorithm import Algorithm
from samarl.algorithms.critics import CriticEncoder
from samarl.algorithms.training_data import TrainingData, merge
from samarl.distributed import all_gather_object, average_gradients
from samarl.observations.features import state_sizes
from samarl.observations.frames import Frames
from samarl.policies.policy import LOCAL, MACRO, Policy
from samarl.policies.stochastic import Sequences, StochasticPolicy
from samarl.rollout import Rollout, level_key

MACRO_RISE = 0.3
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
)
"""What the local level's losses read of a rollout, as far as it is there."""

Statistics = dict[str, list[float]]


@dataclass
class OnPolicyConfig:
    """Hyperparameters of all on-policy algorithms."""

    teacher: str | None  # agent of `conf/agent/` that the local level imitates at first
    learning_rate: float = required(0.0, 1.0, help="initial learning rate; falls linearly to 0")
    epochs: int = required(1, 100, help="passes over each rollout")
    minibatches: int = required(1, 1000, help="minibatches per epoch")
    discount: float = required(0.0, 1.0, help="discount of the macro level, per step")
    local_discount: float = required(0.0, 0.9999, help="discount of the local level, per step")
    gae_lambda: float = required(0.0, 1.0, help="lambda of the multi-step returns")
    max_gradient_norm: float = required(
        0.0, 1e6, help="largest gradient norm, of the policy and of the critics separately"
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
    teacher_coefficient: float = required(
        0.0, 100.0, help="initial weight of imitating the teacher; falls linearly to 0"
    )
    teacher_end: float = required(
        0.001, 1.0, help="share of the training after which the teacher is not imitated any more"
    )
    std_start: float = required(0.01, 10.0, help="initial upper bound of the exploration noise")
    std_end: float = required(
        0.01, 10.0, help="final upper bound of the exploration noise, approached linearly"
    )
    local_std: float = required(
        0.0, 10.0, help="lower bound of the local level's noise, below its upper bound"
    )
    macro_std: float = required(
        0.0, 10.0, help="lower bound of the macro level's noise, below its upper bound"
    )
    critic_width: int = required(8, 1024, help="width of the critics' encoder")
    critic_features: int = required(8, 4096, help="output size of the critics' encoder")


class OnPolicy(Algorithm):
    """Updates all levels of a policy, and their critics, from the newest rollouts alone."""

    policy: StochasticPolicy
    config: OnPolicyConfig
    uses_global_state = True
    supports_data_parallel = True

    def __init__(self, policy: Policy, config: OnPolicyConfig) -> None:
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
        self.encoder = self._make_critic_encoder(config)
        # The local critic observes the waypoint, as its actor does.
        extra = {LOCAL: policy.waypoint_size, MACRO: 0}
        self.heads = nn.ModuleDict(
            {
                level: self._make_head(level, config.critic_features + extra[level])
                for level in policy.levels
            }
        )
        self.uses_shield_targets = config.shield_coefficient > 0.0
        self.teacher = config.teacher
        self.teacher_weight = config.teacher_coefficient
        self.to(policy.device)
        self.optimiser = torch.optim.Adam(
            [*policy.parameters(), *self.parameters()],
            lr=config.learning_rate,
            eps=1e-5,
            fused=policy.device.type in ("cpu", "cuda"),
        )

    @abstractmethod
    def _make_head(self, level: str, inputs: int) -> nn.Module:
        """Return the critic of a level, which reads `inputs` features."""

    def _make_critic_encoder(self, config: OnPolicyConfig) -> CriticEncoder:
        """Return the encoder of the critics' inputs, by default of the global state."""
        sizes = config.critic_width, config.critic_features
        return CriticEncoder(state_sizes(self.policy.sizes, self.policy.waypoint_size), *sizes)

    def _critic_frames(self, rollout: Rollout) -> Frames:
        """Return the input of the critics, [B, T + 1, ...]; by default the global state."""
        assert rollout.state is not None
        return rollout.state

    @abstractmethod
    def _level_batches(
        self, rollouts: list[Rollout], statistics: Statistics
    ) -> list[dict[str, TensorDict]]:
        """Return what the losses of each level read, for each rollout; see `prepare`."""

    @abstractmethod
    def _loss(self, data: TrainingData, statistics: Statistics, divergence: list[float]) -> Tensor:
        """Return the loss of a minibatch; append the KL divergence from the old policy."""

    def _select(self, batches: list[dict[str, TensorDict]]) -> list[Tensor]:
        """Return the steps [B, T] of each rollout from which the policy learns."""
        return [batch[LOCAL]["decides"] for batch in batches]

    def _finish_epoch(self, divergence: list[float]) -> bool:
        """Return whether to stop after an epoch with these KL divergences of all processes."""
        return False

    def set_progress(self, share: float) -> None:
        """Decay learning rate, exploration, path penalty and imitation of the teacher linearly.

        The minimal noise of the macro level rises during the first part, see `MACRO_RISE`.
        """
        c = self.config
        self.reward_shaping.path_penalty = c.path_penalty * (1.0 - share)
        self._set_learning_rate(share)
        self.teacher_weight = c.teacher_coefficient * max(1.0 - share / c.teacher_end, 0.0)
        self.teacher = c.teacher if self.teacher_weight > 0.0 else None
        largest = c.std_start + (c.std_end - c.std_start) * share
        for level in self.policy.levels:
            rising = min(share / MACRO_RISE, 1.0)
            least = c.macro_std * rising if level == MACRO else c.local_std
            self.policy.bound_std(level, least, largest)

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
        """Return what the losses read: all rollouts, in as few parts as `merge` allows.

        Each level has a TensorDict [B, T] with its `action`, the inputs of actor and critic but the
        encoded ones, the targets of its losses, and the masks `decides` (the level made a decision
        that counts) and `valued` (the critic learns from this step).
        """
        batches = self._level_batches(rollouts, statistics)
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

    def _level_data(self, level: str, rollout: Rollout) -> dict[str, Tensor]:
        """Return what a rollout says about one level, without targets, [S, T, N, ...] each."""
        agents, of_level = rollout.steps["agents"], rollout.steps[level_key(level)]
        data = {key: of_level[key][:, :-1] for key in ("action", "sample_log_prob")}
        if level == LOCAL:
            present = [key for key in LOCAL_KEYS if agents.get(key, None) is not None]
            data |= {key: agents[key][:, :-1] for key in present}
            shape, device = data["sample_log_prob"].shape, self.policy.device
            correlation = torch.full((*shape, 1), rollout.correlation, device=device)
            limits = torch.tensor(action_limits(rollout.scenario), device=device)
            data |= {"noise_correlation": correlation, "action_limits": limits.expand(*shape, -1)}
        return data

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
                    loss = self._loss(part, statistics, divergence)
                    if loss.requires_grad:  # otherwise no sample counts
                        (loss * (len(part.robot) / rows)).backward()
                self._descend(statistics)
            divergence = [value for values in all_gather_object(divergence) for value in values]
            if self._finish_epoch(divergence):
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

    def _auxiliary_loss(
        self, mean: Tensor, std: Tensor, decisions: TensorDict, statistics: Statistics
    ) -> Tensor:
        """Return the penalties on the local level's means [Q, A]: limits, shield and teacher."""
        c = self.config
        total = mean.new_zeros(())
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
        if self.teacher is not None:
            error = (mean - decisions["teacher_action"]).square().sum(-1).mean()
            total = total + self.teacher_weight * error
            statistics["losses/teacher_error"].append(float(error.detach()))
        return total


def selected_decisions(
    policy: StochasticPolicy, data: TrainingData
) -> tuple[int, dict[str, TensorDict]]:
    """Encode the selected steps of a minibatch.

    Returns:
        The number P of selected steps, and each level's decisions in them [Q]: its data with the
        inputs `embedding` and `row` of `StochasticPolicy.actor`, and `sample`, which of the P.
    """
    row, step = data.selected.nonzero(as_tuple=True)
    samples = {level: of_level[row, step] for level, of_level in data.levels.items()}  # [P]
    index = {level: of_level["decides"].nonzero().squeeze(1) for level, of_level in samples.items()}
    embeddings = policy.embed(
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
        decisions[level]["sample"] = index[level]
    return len(row), decisions


def by_row(data: dict[str, Tensor]) -> TensorDict:
    """Return tensors [S, T, N, ...] as a TensorDict [B, T] of rows s N + n."""
    rows = {key: x.transpose(1, 2).flatten(0, 1) for key, x in data.items()}
    return TensorDict(rows, next(iter(rows.values())).shape[:2])
