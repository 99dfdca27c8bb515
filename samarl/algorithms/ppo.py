"""Proximal policy optimisation of every level of a policy (SAMARL, Eq. 9 and Algorithm 1).

MAPPO and independent PPO differ in their critics, which are in `mappo.py` and `ippo.py`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from mrsan import ConfigurationError
from mrsan.fields import number, required
from samarl.algorithms.action_limits import excess
from samarl.algorithms.advantages import macro_advantages, step_advantages, streams
from samarl.algorithms.algorithm import Algorithm
from samarl.algorithms.critics import PopArtHead, SetEncoder
from samarl.distributed import all_gather_cat, all_gather_object, average_gradients
from samarl.observations.frames import Frames
from samarl.policies.hierarchical import WAYPOINT_FEATURES
from samarl.policies.policy import LOCAL, MACRO, Policy
from samarl.policies.stochastic import ActionBatch, StochasticPolicy
from samarl.rollout import Rollout, level_key

MACRO_RISE = 0.3
"""Share of the training in which the macro level's minimal noise rises from 0.

Waypoints hardly move at first, so that the local level learns to drive to them.
"""

CHUNK_SIZE = 16384
"""Frames per forward pass of the critics when no gradient is needed, to bound the memory."""


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
    critic_heads: int = required(1, 64, help="attention heads of the critics' encoder")
    critic_features: int = required(8, 4096, help="output size of the critics' encoder")
    target_kl: float | None = number(
        None, 0.0, 1e6, help="KL divergence beyond which epochs stop; null: never"
    )


class LevelBatch(NamedTuple):
    """The data of one level of a rollout for an update, [S, T, N] each."""

    where: Tensor  # bool: the level made a decision that counts
    valued: Tensor  # bool: the critic learns from this step
    advantage: Tensor  # normalised
    target: Tensor  # normalised
    value: Tensor  # normalised, before the update


class PPO(Algorithm):
    """Clipped PPO of all levels at once, with TorchRL's loss."""

    policy: StochasticPolicy
    heads: Mapping[str, PopArtHead]
    supports_data_parallel = True

    def __init__(self, policy: Policy, config: Any) -> None:
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
        self.encoder, features = self._make_critic(config), config.critic_features
        # The local critic sees the waypoint, as its actor does.
        waypoints = WAYPOINT_FEATURES if MACRO in policy.levels else 0
        self.heads = nn.ModuleDict(  # type: ignore[assignment]
            {
                name: PopArtHead(
                    features + (waypoints if name == LOCAL else 0), config.critic_features
                )
                for name in policy.levels
            }
        )
        self.loss = _torchrl_loss(config)
        self.uses_shield_targets = config.shield_coefficient > 0.0
        self.path_penalty = config.path_penalty
        self.to(policy.device)
        self.optimiser = torch.optim.Adam(
            [*policy.parameters(), *self.parameters()], lr=config.learning_rate, eps=1e-5
        )

    @abstractmethod
    def _make_critic(self, config: Any) -> SetEncoder:
        """Return the encoder of the critics."""

    @abstractmethod
    def _critic_frames(self, rollout: Rollout) -> Frames:
        """Return the input of the critics, [B, T + 1, ...]."""

    def _level_reward(self, rollout: Rollout, level: str) -> Tensor:
        """Return the reward of a level, [S, T, N], minus the path penalty."""
        paid = rollout.steps[("next", *level_key(level), "reward")][:, :-1]
        agents = rollout.steps["agents"]
        driven = agents["speed"][:, 1:] * agents["active_mask"][:, :-1] * rollout.scenario.time_step
        return paid - self.path_penalty * driven

    def set_progress(self, share: float) -> None:
        """Decay learning rate, exploration and path penalty linearly.

        The minimal noise of the macro level rises during the first part, see `MACRO_RISE`.
        """
        c = self.config
        self.path_penalty = c.path_penalty * (1.0 - share)
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
        statistics: dict[str, list[float]] = defaultdict(list)
        prepared = self.prepare(rollouts, statistics)
        kept = self._largest_advantages(prepared)
        if self.uses_shield_targets:
            for rollout, data, keep in zip(rollouts, prepared, kept, strict=True):
                keep |= data[LOCAL].where & rollout.steps["agents", "unsafe"][:, :-1]
        for epoch in range(1, self.config.epochs + 1):
            statistics["losses/epochs"] = [float(epoch)]  # the last one that was run
            divergence: list[float] = []
            pieces = [
                torch.randperm(len(rollout.steps)).tensor_split(self.config.minibatches)
                for rollout in rollouts
            ]
            for minibatch in zip(*pieces, strict=True):
                self.optimiser.zero_grad(set_to_none=True)
                for rollout, data, keep, sequences in zip(
                    rollouts, prepared, kept, minibatch, strict=True
                ):
                    if len(sequences):
                        of_piece = sequences.to(self.policy.device)
                        loss = self._loss(rollout, data, keep, of_piece, statistics, divergence)
                        if loss.requires_grad:  # otherwise no sample counts
                            (loss / len(rollouts)).backward()
                average_gradients([*self.policy.parameters(), *self.parameters()])
                for name, module in (("actor", self.policy), ("critic", self)):
                    norm = nn.utils.clip_grad_norm_(
                        module.parameters(), self.config.max_gradient_norm
                    )
                    if not torch.isfinite(norm):
                        raise FloatingPointError(f"the gradient of the {name} is not finite")
                    statistics[f"losses/{name}_gradient_norm"].append(float(norm))
                self.optimiser.step()
            divergence = [value for values in all_gather_object(divergence) for value in values]
            mean_kl = sum(divergence) / max(len(divergence), 1)
            if self.config.target_kl is not None and mean_kl > self.config.target_kl:
                break
        return {key: sum(values) / len(values) for key, values in statistics.items()}

    @torch.no_grad()
    def prepare(
        self, rollouts: list[Rollout], statistics: dict[str, list[float]]
    ) -> list[dict[str, LevelBatch]]:
        """Return advantages and value targets of all levels; update the value scales once."""
        out: list[dict[str, LevelBatch]] = [{} for _ in rollouts]
        features = []
        for rollout in rollouts:
            given = Frames(*(x.flatten(0, 1) for x in self._critic_frames(rollout)))
            read = torch.cat([self.encoder(part) for part in given.split(CHUNK_SIZE)])
            shape = (len(rollout.steps), rollout.robots, -1, read.shape[-1])
            features.append(read.view(shape).transpose(1, 2))  # [S, T + 1, N, F]
        for name, head in self.heads.items():
            found = []
            for rollout, feature in zip(rollouts, features, strict=True):
                waypoints = rollout.steps["agents"].get("waypoint_features")
                value = head.denormalise(head(_critic_input(name, feature, waypoints)))
                found.append((*self._advantages(name, rollout, value), value[:, :-1]))
            chosen = all_gather_cat(
                torch.cat([advantage[where] for advantage, _, where, _, _ in found])
            )
            targets = all_gather_cat(
                torch.cat([target[valued] for _, target, _, valued, _ in found])
            )
            values = all_gather_cat(torch.cat([value[valued] for _, _, _, valued, value in found]))
            mean, std = chosen.new_zeros(()), chosen.new_ones(())
            if len(chosen) > 1:  # in a short rollout the macro level may decide never
                mean, std = chosen.mean(), chosen.std().clamp_min(1e-4)
            if len(targets) > 1:
                unexplained = (targets - values).var() / targets.var().clamp_min(1e-8)
                statistics[f"losses/{name}_explained_variance"].append(1.0 - float(unexplained))
                head.update(targets)
            for data, (advantage, target, where, valued, value) in zip(out, found, strict=True):
                data[name] = LevelBatch(
                    where, valued, (advantage - mean) / std, head.normalise(target),
                    head.normalise(value),
                )  # fmt: skip
        return out

    def _advantages(
        self, level: str, rollout: Rollout, value: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return advantage, target, the level's decisions and its critic's samples, [S, T, N]."""
        c, of, reward = self.config, streams(rollout.steps), self._level_reward(rollout, level)
        if level == LOCAL:
            found = step_advantages(of, reward, value, c.local_discount, c.gae_lambda)
            return *found, of.acts, of.counts
        decided = rollout.steps["agents", level, "decision_mask"][:, :-1]
        advantage, target, where = macro_advantages(
            of, decided, reward, value, c.discount, c.gae_lambda
        )
        return advantage, target, where & decided, where

    def _largest_advantages(self, prepared: list[dict[str, LevelBatch]]) -> list[Tensor]:
        """Return the samples [S, T, N] with the largest advantages, from which the policy learns.

        Most steps are as good as expected and carry no signal (Cusumano-Towner et al., Robust
        autonomy emerges from self-play, 2025).
        """
        sizes = []
        for data in prepared:
            size = torch.zeros_like(data[LOCAL].advantage)
            for level in data.values():
                size = torch.where(level.where, torch.maximum(size, level.advantage.abs()), size)
            sizes.append(size)
        acts = [data[LOCAL].where for data in prepared]
        if self.config.advantage_filter_fraction >= 1.0:
            return acts
        every = all_gather_cat(
            torch.cat([size[where] for size, where in zip(sizes, acts, strict=True)])
        )
        dropped = int((1.0 - self.config.advantage_filter_fraction) * len(every))
        least = every.kthvalue(max(dropped, 1)).values
        # Not `>=`: NaN must be kept, so that it stops the run.
        return [where & ~(size < least) for size, where in zip(sizes, acts, strict=True)]

    def _loss(
        self, rollout: Rollout, data: dict[str, LevelBatch], kept: Tensor, sequences: Tensor,
        statistics: dict[str, list[float]], divergence: list[float],
    ) -> Tensor:  # fmt: skip
        steps, n = rollout.steps[sequences], rollout.robots
        chosen = kept[sequences].transpose(1, 2)  # [S, N, T], as the rows of the sequences are
        s, _, t = chosen.shape
        flat = chosen.reshape(s * n, t).nonzero()
        samples = flat[:, 0] * (t + 1) + flat[:, 1]
        world, robot, step = flat[:, 0] // n, flat[:, 0] % n, flat[:, 1]
        at = (world, step, robot)
        actions, of_level = {}, {}
        waypoints = steps["agents"].get("waypoint_features")
        for name in data:
            where = data[name].where[sequences][at].nonzero().squeeze(1)
            of_level[name] = tuple(index[where] for index in at)
            action = steps[(*level_key(name), "action")][of_level[name]]
            noise = steps["agents", "noise"][of_level[name]] if name == LOCAL else action
            actions[name] = ActionBatch(where, action, noise)
        choices = self.policy.evaluate(
            rollout.sequences(sequences), samples, None if waypoints is None else waypoints[at],
            actions, rollout.correlation,
        )  # fmt: skip
        total = torch.zeros((), device=samples.device)
        for name, choice in choices.items():
            level, decided = data[name], of_level[name]
            if len(decided[0]) > 0:
                before = steps[(*level_key(name), "sample_log_prob")][decided]
                losses = self.loss(
                    TensorDict(
                        {
                            "new_log_prob": choice.log_prob,
                            "entropy_of": choice.entropy,
                            "action": actions[name].action,
                            "action_log_prob": before,
                            "advantage": level.advantage[sequences][decided].unsqueeze(-1),
                        },
                        [len(decided[0])],
                    )
                )
                # Every decision has the same weight. The macro level decides rarely: averaged
                # separately, its noise would drown the local level's signal to the shared encoder.
                share = len(decided[0]) / len(samples)
                bonus = self.config.entropy_coefficient * choice.entropy.mean()
                total = total + share * (losses["loss_objective"] - bonus)
                divergence.append(float(losses["kl_approx"].detach()))
                for key, called in _STATISTICS.items():
                    statistics[f"losses/{name}_{called}"].append(float(losses[key].detach()))
                statistics[f"losses/{name}_entropy"].append(float(choice.entropy.mean().detach()))
            if name == LOCAL and len(decided[0]) > 0 and self.config.action_limit_penalty > 0.0:
                speed = steps["agents", "speed"][decided]
                beyond = excess(
                    choice.mean, choice.std, speed, rollout.scenario, self.config.action_limit_slack
                ).mean()
                total = total + self.config.action_limit_penalty * beyond
                statistics["losses/action_limit_penalty"].append(float(beyond.detach()))
            if name == LOCAL and len(decided[0]) > 0 and self.uses_shield_targets:
                unsafe = steps["agents", "unsafe"][decided]
                error = choice.mean - steps["agents", "safe_action"][decided]
                wrong = (error.square().sum(-1) * unsafe).mean()
                total = total + self.config.shield_coefficient * wrong
                statistics["losses/unsafe"].append(float(unsafe.float().mean()))
                statistics["losses/shield_error"].append(float(wrong.detach()))
        return total + self._critic_loss(rollout, data, sequences, chosen, statistics)

    def _critic_loss(
        self, rollout: Rollout, data: dict[str, LevelBatch], sequences: Tensor, chosen: Tensor,
        statistics: dict[str, list[float]],
    ) -> Tensor:  # fmt: skip
        """Return the value loss over the policy's samples and those of robots that wait."""
        acts, counts = (x[sequences].transpose(1, 2) for x in data[LOCAL][:2])
        where = (chosen | (counts & ~acts)).nonzero(as_tuple=True)  # [S, N, T]
        world, robot, step = where
        at = (sequences[world], step, robot)
        row = sequences[world] * rollout.robots + robot
        features = self.encoder(Frames(*(x[row, step] for x in self._critic_frames(rollout))))
        waypoints = rollout.steps["agents"].get("waypoint_features")
        waypoints = None if waypoints is None else waypoints[at]
        total = features.new_zeros(())
        for name, level in data.items():
            valued = level.valued[at]
            if not valued.any():
                continue
            value = self.heads[name](_critic_input(name, features, waypoints)[valued])
            before, target = level.value[at][valued], level.target[at][valued]
            loss = value_loss(value, before, target, self.config.clip_epsilon)
            total = total + self.config.critic_coefficient * loss
            statistics[f"losses/{name}_critic"].append(float(loss.detach()))
        return total


def _critic_input(level: str, features: Tensor, waypoint_features: Tensor | None) -> Tensor:
    """Return the input of a level's critic: the local one sees the waypoint, if there is one."""
    if level != LOCAL or waypoint_features is None:
        return features
    return torch.cat([features, waypoint_features], -1)


_STATISTICS = {
    "loss_objective": "objective",
    "kl_approx": "approx_kl",
    "clip_fraction": "clip_fraction",
    "ESS": "effective_samples",
}


def value_loss(value: Tensor, before: Tensor, target: Tensor, clip_epsilon: float) -> Tensor:
    """Return the mean clipped squared error of [R] normalised values (Yu et al., 2022)."""
    clipped = before + (value - before).clamp(-clip_epsilon, clip_epsilon)
    worst = torch.maximum((value - target).square(), (clipped - target).square())
    return worst.mean()


class _Known(torch.distributions.Distribution):
    """A distribution of which only the log-probability of the executed action is known."""

    arg_constraints: ClassVar[dict[str, Any]] = {}

    def __init__(self, new_log_prob: Tensor, entropy_of: Tensor) -> None:
        super().__init__(new_log_prob.shape, validate_args=False)
        self._log_prob, self._entropy = new_log_prob, entropy_of

    def log_prob(self, value: Tensor) -> Tensor:
        return self._log_prob

    def entropy(self) -> Tensor:
        return self._entropy


def _torchrl_loss(config: Any) -> ClipPPOLoss:
    """Return TorchRL's clipped objective over log-probabilities that the policy has computed."""
    operator = ProbabilisticActor(
        TensorDictModule(nn.Identity(), in_keys=["new_log_prob"], out_keys=["new_log_prob"]),
        in_keys=["new_log_prob", "entropy_of"],
        out_keys=["action"],
        distribution_class=_Known,
        return_log_prob=True,
    )
    return ClipPPOLoss(
        operator,
        None,
        clip_epsilon=config.clip_epsilon,
        entropy_bonus=False,
        critic_coeff=None,
        normalize_advantage=False,
        functional=False,
    )
