"""MAPPO on two levels (SAMARL, Eq. 9 and Algorithm 1) with TorchRL's losses and estimators."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.modules import ProbabilisticActor
from torchrl.objectives.multiagent import MAPPOLoss
from torchrl.objectives.value import MultiAgentGAE

from mrsan.scenario import number, required
from samarl.algorithms.excess import excess
from samarl.policies.central import Critic, joint_features
from samarl.policies.hierarchical import HierarchicalPolicy
from samarl.training.rollout import Batch, Steps


@dataclass
class MAPPO:
    """Knobs of the update."""

    learning_rate: float = required(0.0, 1.0)
    epochs: int = required(1, 100)
    minibatches: int = required(1, 1000)
    discount: float = required(0.0, 1.0)  # per step, of the macro level
    local_discount: float = required(0.0, 0.9999)  # per step, of the local level
    gae_lambda: float = required(0.0, 1.0)
    clip_epsilon: float = required(0.0, 10.0)
    entropy_coefficient: float = required(0.0, 10.0)
    critic_coefficient: float = required(0.0, 100.0)
    max_gradient_norm: float = required(0.0, 1e6)
    excess_coefficient: float = required(0.0, 10.0)  # of commands beyond what robots can do ...
    excess_slack: float = number(1.0, 0.0, 10.0)  # ... by more than so many deviations of the noise
    deviation_start: float = number(1.0, 0.01, 10.0)  # cap of the exploration noise ...
    deviation_end: float = number(0.2, 0.01, 10.0)  # ... falls linearly to this


class ValueNormaliser(nn.Module):
    """Running mean and variance of value targets, as MAPPO uses them (Yu et al., 2022)."""

    mean: Tensor
    square: Tensor
    weight: Tensor

    def __init__(self, decay: float = 0.99) -> None:
        super().__init__()
        self.decay = decay
        self.register_buffer("mean", torch.zeros(()))
        self.register_buffer("square", torch.zeros(()))
        self.register_buffer("weight", torch.zeros(()))

    def update(self, targets: Tensor) -> None:
        """Take in targets [R]."""
        self.mean.mul_(self.decay).add_((1 - self.decay) * targets.mean())
        self.square.mul_(self.decay).add_((1 - self.decay) * targets.square().mean())
        self.weight.mul_(self.decay).add_(1 - self.decay)

    def _moments(self) -> tuple[Tensor, Tensor]:
        weight = self.weight.clamp_min(1e-8)
        mean = self.mean / weight
        variance = (self.square / weight - mean.square()).clamp_min(1e-2)
        return mean, variance.sqrt()

    def normalise(self, value: Tensor) -> Tensor:
        """From the scale of returns to the scale of the critic."""
        mean, deviation = self._moments()
        return (value - mean) / deviation if self.weight > 0 else value

    def denormalise(self, value: Tensor) -> Tensor:
        """From the scale of the critic to the scale of returns."""
        mean, deviation = self._moments()
        return value * deviation + mean if self.weight > 0 else value


class Level(nn.Module):
    """The loss of one level: its actor, its critic, its value scale."""

    def __init__(self, actor: nn.Module, critic: Critic, mappo: MAPPO) -> None:
        super().__init__()
        self.critic = critic
        self.values = ValueNormaliser()
        operator = ProbabilisticActor(
            TensorDictModule(actor, in_keys=["feature", "robot"], out_keys=["loc", "scale"]),
            in_keys=["loc", "scale"],
            out_keys=["action"],
            distribution_class=_independent_normal,
            return_log_prob=True,
        )
        self.loss = MAPPOLoss(
            operator,
            TensorDictModule(critic, in_keys=["joint"], out_keys=["state_value"]),
            clip_epsilon=mappo.clip_epsilon,
            entropy_coeff=mappo.entropy_coefficient,
            critic_coeff=mappo.critic_coefficient,
            clip_value=True,
            normalize_advantage=False,
            functional=False,
        )
        self.loss.set_keys(value="state_value", action="action", sample_log_prob="log_prob")

    def value(self, joint: Tensor) -> Tensor:
        """Value [..., 1] in the scale of returns."""
        return self.values.denormalise(self.critic(joint))


def _independent_normal(loc: Tensor, scale: Tensor) -> torch.distributions.Distribution:
    return torch.distributions.Independent(torch.distributions.Normal(loc, scale), 1)


def advantages(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    done: Tensor,
    terminated: Tensor,
    discount: float,
    gae_lambda: float,
    duration: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Advantage and value target, [E, T, N], of a level's own time axis.

    Args:
        reward: [E, T, N]; of a macro action already discounted within its duration.
        value: [E, T, N].
        next_value: [E, T, N] of the state each step led to, before any reset.
        done: [E, T, N] the robot's stream ends here.
        terminated: [E, T, N] and its value is zero; where only `done`, `next_value` bootstraps.
        discount: per environment step.
        gae_lambda: per decision.
        duration: [E, T, N] environment steps of each decision; None: one each.
    """
    estimator = MultiAgentGAE(
        gamma=discount, lmbda=gae_lambda, value_network=None, average_gae=False, vectorized=False
    )
    data = TensorDict(
        {
            "state_value": value.unsqueeze(-1),
            "next": TensorDict(
                {
                    "state_value": next_value.unsqueeze(-1),
                    "reward": reward.unsqueeze(-1),
                    "done": done.unsqueeze(-1),
                    "terminated": terminated.unsqueeze(-1),
                },
                value.shape[:2],
            ),
        },
        value.shape[:2],
    )
    if duration is not None:
        data["steps_to_next_obs"] = duration.unsqueeze(-1)
    result = estimator(data)
    return result["advantage"].squeeze(-1), result["value_target"].squeeze(-1)


@dataclass
class MacroRecords:
    """The macro actions of a rollout, one after another per robot: [E, K, N]."""

    reward: Tensor  # discounted within the duration
    duration: Tensor  # environment steps
    done: Tensor
    terminated: Tensor
    start: Tensor  # the step in which each was chosen
    end: Tensor  # the last step of each
    valid: Tensor  # False: padding


def macro_records(steps: Steps, discount: float) -> MacroRecords:
    """Cut a rollout at its macro decisions: R = sum of discount^j r_j over the duration."""
    due, driving = steps.due, steps.driving
    e, t, n = due.shape
    number_of = due.long().cumsum(1) - 1  # [E, T, N] which macro action a step belongs to
    belongs = driving & (number_of >= 0)
    k = int(number_of.max()) + 1
    slot = number_of.clamp_min(0)
    step = torch.arange(t, device=due.device).view(1, t, 1).expand(e, t, n)

    def gather(values: Tensor, reduce: str, where: Tensor, empty: float) -> Tensor:
        out = values.new_full((e, k + 1, n), empty)
        index = torch.where(where, slot, k)  # what does not count goes to the slot that is cut off
        return out.scatter_reduce(1, index, values, reduce, include_self=True)[:, :k]

    start = gather(step, "amax", due, 0)
    within = step - start.gather(1, slot)
    reward = gather(steps.macro_reward * discount**within, "sum", belongs, 0.0)
    duration = gather(torch.ones_like(step), "sum", belongs, 0)
    end = gather(step, "amax", belongs, 0)
    valid = duration > 0
    done = steps.done.gather(1, end) | ~valid
    terminated = steps.terminated.gather(1, end) | ~valid
    return MacroRecords(reward, duration, done, terminated, start, end, valid)


class Learner:
    """Updates a hierarchical policy from rollouts."""

    def __init__(self, policy: HierarchicalPolicy, mappo: MAPPO) -> None:
        """Make the losses of both levels and one optimiser for everything."""
        self.policy, self.mappo = policy, mappo
        self.macro = Level(policy.macro_actor, policy.macro_critic, mappo)
        self.local = Level(policy.local_actor, policy.local_critic, mappo)
        for level in (self.macro, self.local):
            level.values.to(policy.device)
        self.levels = {"macro": self.macro, "local": self.local}
        if policy.architecture.levels == 1:
            del self.levels["macro"]
        self.optimiser = torch.optim.Adam(policy.parameters(), lr=mappo.learning_rate, eps=1e-5)

    def set_progress(self, share: float) -> None:
        """Learning rate and exploration noise after this share of the training."""
        m = self.mappo
        for group in self.optimiser.param_groups:
            group["lr"] = m.learning_rate * max(1.0 - share, 0.02)
        cap = m.deviation_start + (m.deviation_end - m.deviation_start) * share
        for actor in (self.policy.macro_actor, self.policy.local_actor):
            actor.cap_deviation(cap)

    @torch.no_grad()
    def prepare(self, batch: Batch) -> dict[str, Tensor]:
        """Advantages and targets of both levels; names begin with `macro_` or `local_`."""
        e, t, n = batch.steps.driving.shape
        features = self.policy.encode_state(batch.state).view(e, n, t + 1, -1).transpose(1, 2)
        own, after = features[:, :t], features[:, 1:].clone()  # [E, T, N, F]
        told_after = torch.cat([batch.steps.waypoint[:, 1:], batch.last_waypoint.unsqueeze(1)], 1)
        world, step = batch.ends.unbind(1)  # there the next state is not that of the next episode
        final = self.policy.encode_state(batch.final_state)
        after[world, step] = final.view(len(world), n, own.shape[-1])
        told_after[world, step] = batch.final_waypoint
        out: dict[str, Tensor] = {}
        for name, level in self.levels.items():
            steps, where = batch.steps, self._decided(name, batch.steps)
            if name == "macro":
                advantage, target, value = self._macro_advantages(steps, own, after)
            else:
                value = level.value(joint_features(torch.cat([own, steps.waypoint], -1)))
                next_value = level.value(joint_features(torch.cat([after, told_after], -1)))
                value = value.squeeze(-1)
                advantage, target = advantages(
                    steps.local_reward, value, next_value.squeeze(-1), steps.done,
                    steps.terminated, self.mappo.local_discount, self.mappo.gae_lambda,
                )  # fmt: skip
            chosen = advantage[where]
            unexplained = (target - value)[where].var() / target[where].var().clamp_min(1e-8)
            out[f"{name}_explained"] = 1.0 - unexplained
            mean, deviation = chosen.mean(), chosen.std().clamp_min(1e-4)
            level.values.update(target[where])
            out[f"{name}_advantage"] = (advantage - mean) / deviation
            out[f"{name}_target"] = level.values.normalise(target)
            out[f"{name}_value"] = level.values.normalise(value)
        return out

    def _macro_advantages(
        self, steps: Steps, own: Tensor, after: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Advantage and target, [E, T, N] at the step of each decision, and the values."""
        e, t, n = steps.driving.shape
        value = self.macro.value(joint_features(own)).squeeze(-1)
        next_value = self.macro.value(joint_features(after)).squeeze(-1)
        records = macro_records(steps, self.mappo.discount)
        found = advantages(
            records.reward, value.gather(1, records.start), next_value.gather(1, records.end),
            records.done, records.terminated, self.mappo.discount, self.mappo.gae_lambda,
            records.duration,
        )  # fmt: skip
        start = torch.where(records.valid, records.start, t)
        advantage, target = (
            value.new_zeros(e, t + 1, n).scatter(1, start, of_records)[:, :t]
            for of_records in found
        )
        return advantage, target, value

    @staticmethod
    def _decided(level: str, steps: Steps) -> Tensor:
        """In which steps [E, T, N] a level decided something."""
        return steps.due if level == "macro" else steps.driving

    def update(self, batches: list[Batch]) -> dict[str, float]:
        """All epochs over the rollouts of one or several scenarios; returns mean statistics."""
        batches = [batch.to(self.policy.device) for batch in batches]
        prepared = [self.prepare(batch) for batch in batches]
        statistics: dict[str, list[float]] = defaultdict(list)
        for data in prepared:
            for name in self.levels:
                statistics[f"losses/{name}_explained"].append(float(data[f"{name}_explained"]))
        for _ in range(self.mappo.epochs):
            pieces = [
                torch.randperm(len(batch.steps.driving))
                .to(self.policy.device)
                .tensor_split(self.mappo.minibatches)
                for batch in batches
            ]
            for minibatch in zip(*pieces, strict=True):
                self.optimiser.zero_grad(set_to_none=True)
                for batch, data, worlds in zip(batches, prepared, minibatch, strict=True):
                    loss = self._loss(batch, data, worlds, statistics) / len(batches)
                    loss.backward()
                norm = nn.utils.clip_grad_norm_(
                    self.policy.parameters(), self.mappo.max_gradient_norm
                )
                if not torch.isfinite(norm):
                    raise FloatingPointError("the gradient is not finite")
                self.optimiser.step()
                statistics["losses/gradient_norm"].append(float(norm))
        return {key: sum(values) / len(values) for key, values in statistics.items()}

    def _loss(
        self, batch: Batch, data: dict[str, Tensor], worlds: Tensor, statistics: dict
    ) -> Tensor:
        e, (_, t, n) = len(worlds), batch.steps.driving.shape
        rows = (worlds.unsqueeze(1) * n + torch.arange(n, device=worlds.device)).flatten()
        frames, begins = batch.frames.of(rows), batch.begins[rows]

        def by_world(features: Tensor) -> Tensor:
            return features.view(e, n, t, -1).transpose(1, 2)

        y = by_world(self.policy.encode(frames, begins))
        critic = by_world(self.policy.encode_state(batch.state.of(rows).at(slice(0, t))))
        told = batch.steps.waypoint[worlds]
        robot = torch.arange(n, device=y.device).expand(e, t, n)
        total = y.new_zeros(())
        for name, level in self.levels.items():
            feature, own = y, critic
            action, log_prob = batch.steps.macro, batch.steps.macro_log_prob
            if name == "local":
                feature, own = torch.cat([y, told], -1), torch.cat([critic, told], -1)
                action, log_prob = batch.steps.action, batch.steps.action_log_prob
            counts = self._decided(name, batch.steps)[worlds]
            losses = level.loss(
                TensorDict(
                    {
                        "feature": feature[counts],
                        "robot": robot[counts],
                        "joint": joint_features(own)[counts],
                        "action": action[worlds][counts],
                        "log_prob": log_prob[worlds][counts],
                        "advantage": data[f"{name}_advantage"][worlds][counts].unsqueeze(-1),
                        "value_target": data[f"{name}_target"][worlds][counts].unsqueeze(-1),
                        "state_value": data[f"{name}_value"][worlds][counts].unsqueeze(-1),
                    },
                    [int(counts.sum())],
                )
            )
            total = total + losses["loss_objective"] + losses["loss_critic"]
            total = total + losses["loss_entropy"]
            if name == "local":
                mean, deviation = self.policy.local_actor(feature[counts], robot[counts])
                speed = batch.steps.speed[worlds][counts]
                beyond = excess(mean, deviation, speed, batch.scenario, self.mappo.excess_slack)
                total = total + self.mappo.excess_coefficient * beyond.mean()
                statistics["losses/local_excess"].append(beyond.mean().item())
            for key in ("loss_objective", "loss_critic", "entropy", "kl_approx", "clip_fraction"):
                statistics[f"losses/{name}_{key.removeprefix('loss_')}"].append(losses[key].item())
        return total
