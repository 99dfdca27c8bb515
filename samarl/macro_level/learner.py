"""MAPPO on the decisions of the macro level."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mrsan import ConfigurationError
from mrsan.metrics import Episodes
from samarl.agents.agent import Agent
from samarl.errors import TrainingError
from samarl.macro_level.decisions import Collector, Decisions
from samarl.macro_level.network import PassageNetwork
from samarl.macro_level.settings import MacroTraining
from samarl.planning.passage_features import MATE, TRUTH
from samarl.policies.checkpoint import restore_learner, save_learner
from samarl.progress import progress_bar

_CASES = 10_000_000  # between the first cases of two seeds
_SHOWN = 500  # episodes of which the success rate is shown
_SAVED = 10  # rounds between two savings
_LAST_RATE = 0.2  # of the learning rate


class _Batch(NamedTuple):
    """The finished decisions of a rollout."""

    own: Tensor  # [B, OWN]
    mates: Tensor  # [B, N - 1, MATE]
    truth: Tensor  # [B, N - 1, MATE + TRUTH]
    choice: Tensor  # [B]
    log_prob: Tensor  # [B]
    advantage: Tensor  # [B] normalised
    target: Tensor  # [B] of the critic


class Learner:
    """Trains a macro level; its state is saved to a file, from which training can be resumed."""

    def __init__(self, training: MacroTraining, agents: Mapping[str, Agent], state: Path) -> None:
        """Start a training run, or resume it from the file `state`.

        Args:
            training: its configuration.
            agents: one for each scenario; the macro level decides who enters for its robots.
            state: file.

        Raises:
            ConfigurationError: there are more scenarios than worlds, or the file belongs to another
                training run.
        """
        if training.worlds < len(agents):
            raise ConfigurationError(
                f"training.worlds is {training.worlds}; it must be at least {len(agents)}, the "
                "number of scenarios"
            )
        self.training, self.path, self.steps = training, state, 0
        settings = {name: (asdict(a.scenario), repr(a)) for name, a in agents.items()}
        self._run = hashlib.sha256(repr((asdict(training), settings)).encode()).hexdigest()
        torch.manual_seed(training.seed)
        self.actor = PassageNetwork(training.network)
        self.critic = PassageNetwork(training.network, MATE + TRUTH, 1)
        parameters = [*self.actor.parameters(), *self.critic.parameters()]
        self.optimiser = torch.optim.Adam(parameters, training.learning_rate, eps=1e-5)
        if state.is_file():
            self.restore()
        worlds = training.worlds // len(agents)
        self.collectors = {
            name: Collector(
                agent,
                worlds,
                training.rollout,
                _CASES * (training.seed + 1) + self.steps // 16 + _CASES // 100 * number,
                training.rewards,
                training.discount,
            )
            for number, (name, agent) in enumerate(agents.items())
        }
        self._recent: dict[str, list[Episodes]] = {name: [] for name in agents}
        self.curve: list[dict[str, float]] = []

    def learn(self) -> None:
        """Train for the remaining steps; the state is saved now and then.

        Raises:
            TrainingError: a gradient is not finite.
        """
        bar = progress_bar(
            total=self.training.steps, initial=self.steps, desc="training", unit="step"
        )
        rounds = 0
        while self.steps < self.training.steps:
            row = self._one_round()
            self.curve.append(row)
            shown = ", ".join(
                f"{name} {row[name]:.0f} %" for name in self.collectors if name in row
            )
            bar.set_postfix_str(f"{shown}, entropy {row['entropy']:.2f}", refresh=False)
            bar.update(int(row["steps"]) - bar.n)
            rounds += 1
            if rounds % _SAVED == 0:
                self.save()
        self.save()
        bar.close()

    def _one_round(self) -> dict[str, float]:
        """Collect a rollout and learn from it; return the figures of its curve."""
        for name, collector in self.collectors.items():
            recent = self._recent[name] = self._recent[name] + collector.collect(self._choose)
            while sum(len(part.case) for part in recent[1:]) >= _SHOWN:
                del recent[0]
            self.steps += len(collector.decisions.number) * self.training.rollout
        entropy = self._update()
        row = {"steps": float(self.steps), "entropy": entropy}
        for name, recent in self._recent.items():
            if recent:
                row[name] = 100.0 * float(np.concatenate([part.success for part in recent]).mean())
        return row

    @torch.no_grad()
    def _choose(
        self, own: NDArray[np.float32], mates: NDArray[np.float32]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Draw choices; see `Collector.collect`."""
        logits = self.actor(torch.from_numpy(own), torch.from_numpy(mates))
        distribution = torch.distributions.Categorical(logits=logits)
        choice = distribution.sample()
        return choice.numpy(), distribution.log_prob(choice).numpy()

    def _update(self) -> float:
        """Learn from the finished decisions of all collectors; return the mean entropy."""
        t = self.training
        progress = min(self.steps / t.steps, 1.0)
        entropy_weight = t.entropy + progress * (t.entropy_end - t.entropy)
        for group in self.optimiser.param_groups:
            group["lr"] = t.learning_rate * (1.0 - (1.0 - _LAST_RATE) * progress)
        parts = [self._batch(collector.decisions) for collector in self.collectors.values()]
        mates = max(part.mates.shape[1] for part in parts)
        parts = [
            part._replace(mates=_pad(part.mates, mates), truth=_pad(part.truth, mates))
            for part in parts
        ]
        batch = _Batch(*(torch.cat(part) for part in zip(*parts, strict=True)))
        if len(batch.choice) < 2:
            return 0.0
        advantage = batch.advantage
        batch = batch._replace(advantage=(advantage - advantage.mean()) / (advantage.std() + 1e-8))
        entropies = []
        for _ in range(t.epochs):
            for index in torch.randperm(len(batch.choice)).split(t.minibatch):
                sample = _Batch(*(values[index] for values in batch))
                entropies.append(self._gradient_step(sample, entropy_weight))
        return float(np.mean(entropies))

    def _gradient_step(self, sample: _Batch, entropy_weight: float) -> float:
        """Take one step of PPO; return the mean entropy."""
        t = self.training
        distribution = torch.distributions.Categorical(logits=self.actor(sample.own, sample.mates))
        entropy = distribution.entropy().mean()
        ratio = (distribution.log_prob(sample.choice) - sample.log_prob).exp()
        clipped = ratio.clamp(1.0 - t.clip, 1.0 + t.clip)
        gain = torch.minimum(ratio * sample.advantage, clipped * sample.advantage).mean()
        value = self.critic(sample.own, sample.truth).squeeze(1)
        error = (value - sample.target).square().mean()
        loss = t.value_weight * error - gain - entropy_weight * entropy
        self.optimiser.zero_grad()
        loss.backward()
        parameters = self.optimiser.param_groups[0]["params"]
        norm = nn.utils.clip_grad_norm_(parameters, t.max_gradient_norm)
        if not torch.isfinite(norm):
            raise TrainingError(
                f"training stopped at step {self.steps}: the gradient is not finite"
            )
        self.optimiser.step()
        return float(entropy.detach())

    @torch.no_grad()
    def _batch(self, d: Decisions) -> _Batch:
        """Return the finished decisions with their advantages."""
        filled = d.is_filled
        value = np.zeros(d.choice.shape)
        own, truth = torch.from_numpy(d.own[filled]), torch.from_numpy(d.truth[filled])
        value[filled] = self.critic(own, truth).squeeze(1).numpy()
        advantage = advantages(d, value, self.training.discount, self.training.gae_lambda)
        over = d.is_over
        return _Batch(
            torch.from_numpy(d.own[over]),
            torch.from_numpy(d.mates[over]),
            torch.from_numpy(d.truth[over]),
            torch.from_numpy(d.choice[over]),
            torch.from_numpy(d.log_prob[over]),
            torch.from_numpy(advantage[over].astype(np.float32)),
            torch.from_numpy((advantage + value)[over].astype(np.float32)),
        )

    @property
    def _networks(self) -> dict[str, nn.Module]:
        return {"actor": self.actor, "critic": self.critic}

    def save(self) -> None:
        """Write the state atomically."""
        progress = "steps", self.steps
        save_learner(self.path, self._networks, self.optimiser, self._run, progress)

    def restore(self) -> None:
        """Restore the state from the file.

        Raises:
            ConfigurationError: the file is damaged, or belongs to another training run.
        """
        self.steps = restore_learner(self.path, self._networks, self.optimiser, self._run, "steps")


def _pad(mates: Tensor, number: int) -> Tensor:
    """Return `mates` [B, K, F] with absent ones, which are zeros, up to [B, `number`, F]."""
    return nn.functional.pad(mates, (0, 0, 0, number - mates.shape[1]))


def advantages(
    d: Decisions, value: NDArray[np.float64], discount: float, gae_lambda: float
) -> NDArray[np.float64]:
    """Return generalised advantage estimates [E, N, K] on every robot's own time axis.

    A decision that lasts `m` steps is discounted like `m` steps (a semi-Markov decision process).

    Args:
        d: the decisions of a rollout.
        value: [E, N, K] of the critic, also for decisions that go on.
        discount: per step.
        gae_lambda: per decision.
    """
    over, slots = d.is_over, d.choice.shape[2]
    advantage = np.zeros((*value.shape[:2], slots + 1))
    following = np.concatenate([value, np.zeros((*value.shape[:2], 1))], 2)
    for k in range(slots - 1, -1, -1):
        factor = np.where(d.ended[..., k], 0.0, discount ** d.duration[..., k])
        error = d.reward[..., k] + factor * following[..., k + 1] - value[..., k]
        # 0 for a decision that is not over, whose rewards are not known yet
        rest = factor * gae_lambda * advantage[..., k + 1]
        advantage[..., k] = np.where(over[..., k], error + rest, 0.0)
    return advantage[..., :slots]
