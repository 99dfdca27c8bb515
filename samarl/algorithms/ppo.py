"""Proximal policy optimisation of every level of a policy (SAMARL, Eq. 9 and Algorithm 1).

What differs between MAPPO and independent PPO, the critic, stands in their own files.
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

from mrsan.scenario import number, required
from samarl.algorithms.action_limits import excess
from samarl.algorithms.advantages import macro_advantages, step_advantages, streams
from samarl.algorithms.algorithm import Algorithm
from samarl.algorithms.critics import PopArtHead, SetEncoder
from samarl.distributed import all_gather_cat, all_gather_object, average_gradients
from samarl.observations.frames import Frames
from samarl.policies.policy import LOCAL, MACRO, TOLD, Policy, Taken
from samarl.rollout import Rollout, level_key

MACRO_RISE = 0.3
"""Share of a training in which the macro level's least noise rises: first its waypoints stay put,
so that the local level learns to drive to them."""

AT_ONCE = 16384
"""Frames that the critics read at once when they learn nothing: thousands of worlds have more than
is well in memory."""


@dataclass
class PPOConfig:
    """Numbers of the update."""

    learning_rate: float = required(0.0, 1.0)  # falls linearly
    epochs: int = required(1, 100)
    minibatches: int = required(1, 1000)
    discount: float = required(0.0, 1.0)  # per step, of the macro level
    local_discount: float = required(0.0, 0.9999)  # per step, of the local level
    gae_lambda: float = required(0.0, 1.0)
    clip_epsilon: float = required(0.0, 0.99)
    entropy_coefficient: float = required(0.0, 10.0)
    critic_coefficient: float = required(0.0, 100.0)
    max_gradient_norm: float = required(0.0, 1e6)  # of the policy and of the critics, each
    kept_share: float = required(0.01, 1.0)  # of the samples, those of the largest advantages
    action_limit_penalty: float = required(0.0, 10.0)  # of commands beyond the robots' limits ...
    action_limit_slack: float = required(0.0, 10.0)  # ... by more than so many deviations
    path_penalty: float = required(0.0, 100.0)  # off the reward per metre, falls linearly to 0
    shield_coefficient: float = required(0.0, 100.0)  # of acting as the shield would, where unsafe
    std_start: float = required(0.01, 10.0)  # cap of the exploration noise ...
    std_end: float = required(0.01, 10.0)  # ... falls linearly to this
    macro_std: float = required(0.0, 10.0)  # the macro level's is at least this, unless capped
    critic_width: int = required(8, 1024)  # of the critics' encoder
    critic_heads: int = required(1, 64)
    critic_features: int = required(8, 4096)
    target_kl: float | None = number(None, 0.0, 1e6)  # no more epochs beyond it; None: all of them


class Prepared(NamedTuple):
    """What an update needs of one level of a rollout, [S, T, N] each."""

    where: Tensor  # the level decided something that counts
    valued: Tensor  # its critic learns from the step
    advantage: Tensor  # normalised
    target: Tensor  # normalised
    value: Tensor  # normalised, of before the update


class PPO(Algorithm):
    """Clipped PPO with TorchRL's loss, of all levels at once."""

    heads: Mapping[str, PopArtHead]
    averages = True

    def __init__(self, policy: Policy, config: Any) -> None:
        """See `Algorithm`."""
        super().__init__(policy, config)
        self.encoder, features = self._make_critic(config), config.critic_features
        # The local critic is told the waypoint, as its actor is.
        self.heads = nn.ModuleDict(  # type: ignore[assignment]
            {
                name: PopArtHead(features + (TOLD if name == LOCAL else 0), config.critic_features)
                for name in policy.levels
            }
        )
        self.loss = _torchrl_loss(config)
        self.taught = config.shield_coefficient > 0.0
        self.path_penalty = config.path_penalty
        self.to(policy.device)
        self.optimiser = torch.optim.Adam(
            [*policy.parameters(), *self.parameters()], lr=config.learning_rate, eps=1e-5
        )

    @abstractmethod
    def _make_critic(self, config: Any) -> SetEncoder:
        """The critics' encoder."""

    @abstractmethod
    def _critic_frames(self, rollout: Rollout) -> Frames:
        """What the critics are given, [B, T + 1, ...]."""

    def _reward(self, rollout: Rollout, level: str) -> Tensor:
        """What a level is paid, [S, T, N], less what it costs to drive so far."""
        paid = rollout.steps[("next", *level_key(level), "reward")][:, :-1]
        agents = rollout.steps["agents"]
        driven = agents["speed"][:, 1:] * agents["active_mask"][:, :-1] * rollout.scenario.time_step
        return paid - self.path_penalty * driven

    def set_progress(self, share: float) -> None:
        """Learning rate, exploration and what a metre costs fall linearly.

        The noise of the macro level rises first: then its waypoints can be followed.
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
        """All epochs over the rollouts of one or several scenarios."""
        rollouts = [rollout.to(self.policy.device) for rollout in rollouts]
        statistics: dict[str, list[float]] = defaultdict(list)
        prepared = self.prepare(rollouts, statistics)
        kept = self._kept(prepared)
        if self.taught:
            for rollout, data, keep in zip(rollouts, prepared, kept, strict=True):
                keep |= data[LOCAL].where & rollout.steps["agents", "unsafe"][:, :-1]
        for epoch in range(1, self.config.epochs + 1):
            statistics["losses/epochs"] = [float(epoch)]  # the last one it came to
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
                        if loss.requires_grad:  # else nothing in it counts
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
    ) -> list[dict[str, Prepared]]:
        """Advantages and value targets of all levels; the value scales are updated once."""
        out: list[dict[str, Prepared]] = [{} for _ in rollouts]
        features = []
        for rollout in rollouts:
            given = Frames(*(x.flatten(0, 1) for x in self._critic_frames(rollout)))
            read = torch.cat([self.encoder(part) for part in given.split(AT_ONCE)])
            shape = (len(rollout.steps), rollout.robots, -1, read.shape[-1])
            features.append(read.view(shape).transpose(1, 2))  # [S, T + 1, N, F]
        for name, head in self.heads.items():
            found = []
            for rollout, feature in zip(rollouts, features, strict=True):
                told = rollout.steps["agents", "target"]
                value = head.denormalise(head(_told(name, feature, told)))
                found.append((*self._advantages(name, rollout, value), value[:, :-1]))
            chosen = all_gather_cat(
                torch.cat([advantage[where] for advantage, _, where, _, _ in found])
            )
            targets = all_gather_cat(
                torch.cat([target[valued] for _, target, _, valued, _ in found])
            )
            values = all_gather_cat(torch.cat([value[valued] for _, _, _, valued, value in found]))
            mean, std = chosen.new_zeros(()), chosen.new_ones(())
            if len(chosen) > 1:  # in a short rollout the macro level may decide nothing
                mean, std = chosen.mean(), chosen.std().clamp_min(1e-4)
            if len(targets) > 1:
                unexplained = (targets - values).var() / targets.var().clamp_min(1e-8)
                statistics[f"losses/{name}_explained_variance"].append(1.0 - float(unexplained))
                head.update(targets)
            for data, (advantage, target, where, valued, value) in zip(out, found, strict=True):
                data[name] = Prepared(
                    where, valued, (advantage - mean) / std, head.normalise(target),
                    head.normalise(value),
                )  # fmt: skip
        return out

    def _advantages(
        self, level: str, rollout: Rollout, value: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Advantage, target, where the level decided and where its critic learns, [S, T, N]."""
        c, of, reward = self.config, streams(rollout.steps), self._reward(rollout, level)
        if level == LOCAL:
            found = step_advantages(of, reward, value, c.local_discount, c.gae_lambda)
            return *found, of.acts, of.counts
        decided = rollout.steps["agents", level, "decision_mask"][:, :-1]
        advantage, target, where = macro_advantages(
            of, decided, reward, value, c.discount, c.gae_lambda
        )
        return advantage, target, where & decided, where

    def _kept(self, prepared: list[dict[str, Prepared]]) -> list[Tensor]:
        """Which samples [S, T, N] the policy learns from: those whose advantages are largest.

        Most steps are as good as expected and teach nothing (Cusumano-Towner et al., Robust
        autonomy emerges from self-play, 2025).
        """
        sizes = []
        for data in prepared:
            size = torch.zeros_like(data[LOCAL].advantage)
            for level in data.values():
                size = torch.where(level.where, torch.maximum(size, level.advantage.abs()), size)
            sizes.append(size)
        acts = [data[LOCAL].where for data in prepared]
        if self.config.kept_share >= 1.0:
            return acts
        every = all_gather_cat(
            torch.cat([size[where] for size, where in zip(sizes, acts, strict=True)])
        )
        least = every.kthvalue(max(int((1.0 - self.config.kept_share) * len(every)), 1)).values
        # Not `>=`: what is not a number must be kept, and stop the run.
        return [where & ~(size < least) for size, where in zip(sizes, acts, strict=True)]

    def _loss(
        self, rollout: Rollout, data: dict[str, Prepared], kept: Tensor, sequences: Tensor,
        statistics: dict[str, list[float]], divergence: list[float],
    ) -> Tensor:  # fmt: skip
        steps, n = rollout.steps[sequences], rollout.robots
        chosen = kept[sequences].transpose(1, 2)  # [S, N, T], as the rows of the sequences are
        s, _, t = chosen.shape
        flat = chosen.reshape(s * n, t).nonzero()
        samples = flat[:, 0] * (t + 1) + flat[:, 1]
        world, robot, step = flat[:, 0] // n, flat[:, 0] % n, flat[:, 1]
        at = (world, step, robot)
        taken, of_level = {}, {}
        for name in data:
            where = data[name].where[sequences][at].nonzero().squeeze(1)
            of_level[name] = tuple(index[where] for index in at)
            action = steps[(*level_key(name), "action")][of_level[name]]
            noise = steps["agents", "noise"][of_level[name]] if name == LOCAL else action
            taken[name] = Taken(where, action, noise)
        choices = self.policy.evaluate(
            rollout.sequences(sequences), samples, steps["agents", "target"][at], taken,
            rollout.correlation,
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
                            "action": taken[name].action,
                            "action_log_prob": before,
                            "advantage": level.advantage[sequences][decided].unsqueeze(-1),
                        },
                        [len(decided[0])],
                    )
                )
                # Every decision counts the same. The macro level decides rarely: with a mean of its
                # own its noise would drown what the local one tells the encoder they share.
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
            if name == LOCAL and len(decided[0]) > 0 and self.taught:
                unsafe = steps["agents", "unsafe"][decided]
                error = choice.mean - steps["agents", "safe_action"][decided]
                wrong = (error.square().sum(-1) * unsafe).mean()
                total = total + self.config.shield_coefficient * wrong
                statistics["losses/unsafe"].append(float(unsafe.float().mean()))
                statistics["losses/shield_error"].append(float(wrong.detach()))
        return total + self._critic_loss(rollout, data, sequences, chosen, statistics)

    def _critic_loss(
        self, rollout: Rollout, data: dict[str, Prepared], sequences: Tensor, chosen: Tensor,
        statistics: dict[str, list[float]],
    ) -> Tensor:  # fmt: skip
        """Of the samples that the policy learns from, and of those that wait for the team."""
        acts, counts = (x[sequences].transpose(1, 2) for x in data[LOCAL][:2])
        where = (chosen | (counts & ~acts)).nonzero(as_tuple=True)  # [S, N, T]
        world, robot, step = where
        at = (sequences[world], step, robot)
        row = sequences[world] * rollout.robots + robot
        features = self.encoder(Frames(*(x[row, step] for x in self._critic_frames(rollout))))
        told = rollout.steps["agents", "target"][at]
        total = features.new_zeros(())
        for name, level in data.items():
            valued = level.valued[at]
            if not valued.any():
                continue
            value = self.heads[name](_told(name, features, told)[valued])
            before, target = level.value[at][valued], level.target[at][valued]
            loss = value_loss(value, before, target, self.config.clip_epsilon)
            total = total + self.config.critic_coefficient * loss
            statistics[f"losses/{name}_critic"].append(float(loss.detach()))
        return total


def _told(level: str, features: Tensor, told: Tensor) -> Tensor:
    """What the critic of a level reads: the local one is told all that its actor is."""
    return torch.cat([features, told], -1) if level == LOCAL else features


_STATISTICS = {
    "loss_objective": "objective",
    "kl_approx": "approx_kl",
    "clip_fraction": "clip_fraction",
    "ESS": "effective_samples",
}


def value_loss(value: Tensor, before: Tensor, target: Tensor, clip_epsilon: float) -> Tensor:
    """Clipped squared error, mean of [R]; all in units of the value scale (Yu et al., 2022)."""
    clipped = before + (value - before).clamp(-clip_epsilon, clip_epsilon)
    worst = torch.maximum((value - target).square(), (clipped - target).square())
    return worst.mean()


class _Known(torch.distributions.Distribution):
    """A distribution of which only the log-probability of what was done is known."""

    arg_constraints: ClassVar[dict[str, Any]] = {}

    def __init__(self, new_log_prob: Tensor, entropy_of: Tensor) -> None:
        super().__init__(new_log_prob.shape, validate_args=False)
        self._log_prob, self._entropy = new_log_prob, entropy_of

    def log_prob(self, value: Tensor) -> Tensor:
        return self._log_prob

    def entropy(self) -> Tensor:
        return self._entropy


def _torchrl_loss(config: Any) -> ClipPPOLoss:
    """TorchRL's clipped objective over log-probabilities that the policy has computed."""
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
