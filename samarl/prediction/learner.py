"""Training of the network that predicts people (`mrsan.prediction.RecurrentPredictor`).

It is trained on simulated crowds without robots nearby, in training cases only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from mrsan import ConfigurationError, Scenario, Split
from mrsan.prediction import (
    FORMAT,
    ConstantVelocity,
    RecurrentPredictor,
    own_frame,
    shapes,
)
from mrsan.se2 import unrotate_vectors
from samarl.errors import TrainingError
from samarl.files import write_json
from samarl.policies.checkpoint import restore_learner, save_learner, write_tensors
from samarl.prediction.training import Training
from samarl.prediction.windows import Windows, simulate_windows
from samarl.progress import progress_bar

ROUNDING = 1e-4  # m^2; keeps the gradient of a distance finite at zero


class Network(nn.Module):
    """Trainable version of the network of `mrsan.kernels.recurrent`."""

    def __init__(self, hidden: int) -> None:
        """Initialise the network to zero offsets, which is constant velocity."""
        super().__init__()
        sizes = shapes(hidden)
        self.w_input = nn.Parameter(torch.randn(sizes["w_input"]) / 2**0.5)
        self.w_hidden = nn.Parameter(torch.randn(sizes["w_hidden"]) / hidden**0.5)
        self.bias = nn.Parameter(torch.zeros(sizes["bias"]))
        self.w_output = nn.Parameter(torch.zeros(sizes["w_output"]))

    def forward(self, velocities: Tensor, mask: Tensor, steps: int, time_step: float) -> Tensor:
        """Return the offsets [B, K, 2] in m, as `mrsan.kernels.recurrent.predict_offsets` does."""
        hidden = velocities.new_zeros(len(velocities), len(self.w_hidden))
        for t in range(velocities.shape[1]):
            updated = self._update(velocities[:, t], hidden)
            hidden = torch.where(mask[:, t, None], updated, hidden)
        velocity_offset = position_offset = torch.zeros_like(velocities[:, 0])
        offsets = []
        for k in range(steps):
            if k > 0:
                hidden = self._update(velocities[:, -1] + velocity_offset, hidden)
            velocity_offset = velocity_offset + hidden @ self.w_output
            position_offset = position_offset + velocity_offset * time_step
            offsets.append(position_offset)
        return torch.stack(offsets, 1)

    def _update(self, velocity: Tensor, hidden: Tensor) -> Tensor:
        """One step of a gated recurrent unit with softsign gates."""
        x_update, x_reset, x_candidate = (velocity @ self.w_input + self.bias).chunk(3, -1)
        h_update, h_reset, h_candidate = (hidden @ self.w_hidden).chunk(3, -1)
        gate, reset = _gate(x_update + h_update), _gate(x_reset + h_reset)
        candidate = nn.functional.softsign(x_candidate + reset * h_candidate)
        return candidate + gate * (hidden - candidate)

    def predictor(self, history: int, time_step: float) -> RecurrentPredictor:
        """Return the predictor for the simulator with the current weights."""
        weights = {name: weight.detach().numpy() for name, weight in self.named_parameters()}
        return RecurrentPredictor(weights, history, time_step)


def _gate(x: Tensor) -> Tensor:
    return 0.5 + 0.5 * nn.functional.softsign(x)


class Learner:
    """Trains the network; its state is saved to a file, from which training can be resumed."""

    def __init__(self, training: Training, crowds: Mapping[str, Scenario], state: Path) -> None:
        """Start a training run, or resume it from the file `state`.

        Raises:
            ConfigurationError: the crowds have different time steps, or the file belongs to another
                training.
        """
        self.training, self.crowds, self.path = training, crowds, state
        steps = {scenario.time_step for scenario in crowds.values()}
        if len(steps) != 1:
            raise ConfigurationError(
                f"crowds have the time steps {sorted(steps)}; there must be exactly one"
            )
        (self.time_step,) = steps
        torch.manual_seed(training.seed)
        self.network = Network(training.hidden)
        self.optimiser = torch.optim.Adam(self.network.parameters(), training.learning_rate)
        self.round = 0
        settings = {name: asdict(scenario) for name, scenario in crowds.items()}
        self._run = hashlib.sha256(repr((asdict(training), settings)).encode()).hexdigest()
        if state.is_file():
            self.restore()

    def learn(self) -> None:
        """Run the remaining rounds; the state is saved after every tenth.

        Raises:
            TrainingError: a gradient is not finite.
        """
        rounds = range(self.round, self.training.rounds)
        bar = progress_bar(
            rounds, total=self.training.rounds, initial=self.round, desc="training", unit="round"
        )
        for self.round in bar:
            bar.set_postfix_str(f"mean error {self._one_round():.3f} m", refresh=False)
            if (self.round + 1) % 10 == 0 or self.round + 1 == self.training.rounds:
                self.save()
        self.round = self.training.rounds

    def predictor(self) -> RecurrentPredictor:
        """Return the trained predictor."""
        return self.network.predictor(self.training.history, self.time_step)

    def _one_round(self) -> float:
        """Train on new cases of every crowd, each window once; return the mean error, m."""
        t = self.training
        rng = np.random.default_rng((t.seed, self.round))
        velocities, mask, target, order = self._samples(rng)
        for group in self.optimiser.param_groups:
            group["lr"] = 0.5 * t.learning_rate * (1 + np.cos(np.pi * self.round / t.rounds))
        losses = []
        for batch in order.split(t.batch):
            offset = self.network(velocities[batch], mask[batch], t.steps, self.time_step)
            loss = ((offset - target[batch]).square().sum(-1) + ROUNDING).sqrt().mean()
            self.optimiser.zero_grad()
            loss.backward()
            norm = nn.utils.clip_grad_norm_(self.network.parameters(), t.max_gradient_norm)
            if not torch.isfinite(norm):
                raise TrainingError(
                    f"training stopped in round {self.round}: the gradient is not finite"
                )
            self.optimiser.step()
            losses.append(float(loss.detach()))
        return float(np.mean(losses))

    def _samples(self, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return inputs, input mask and target offsets of a round, and a random order of them.

        Some histories are shortened at random, as for people who have just come into view.
        """
        t = self.training
        cases = Split.training.case(t.worlds * self.round) + np.arange(t.worlds, dtype=np.int64)
        crowds = [simulate_windows(scenario, cases, t) for scenario in self.crowds.values()]
        windows = Windows(*(np.concatenate(part) for part in zip(*crowds, strict=True)))
        start = rng.integers(0, t.history, len(windows.past))
        start[rng.random(len(start)) >= t.newly_seen] = 0
        known = windows.known & (np.arange(t.history) >= start[:, None])
        step = np.float32(self.time_step)
        velocities, mask, heading = own_frame(windows.past, known, windows.velocity, step)
        straight = ConstantVelocity(self.time_step).predict(
            windows.past, known, windows.velocity, t.steps
        )
        target = unrotate_vectors(windows.future - straight, heading[:, None])
        order = torch.from_numpy(rng.permutation(np.flatnonzero(heading.any(-1))))
        return torch.from_numpy(velocities), torch.from_numpy(mask), torch.from_numpy(target), order

    @property
    def _networks(self) -> dict[str, nn.Module]:
        return {"network": self.network}

    def save(self) -> None:
        """Write the state atomically."""
        progress = "rounds", self.round + 1
        save_learner(self.path, self._networks, self.optimiser, self._run, progress)

    def restore(self) -> None:
        """Restore the state from the file.

        Raises:
            ConfigurationError: the file is damaged, or belongs to another training run.
        """
        self.round = restore_learner(self.path, self._networks, self.optimiser, self._run, "rounds")


def save_predictor(path: Path, predictor: RecurrentPredictor, provenance: dict[str, Any]) -> None:
    """Write the weights to `path` (ending in .safetensors) and their card next to it."""
    tensors = {
        name: torch.from_numpy(weight)
        for name, weight in zip(shapes(1), predictor.weights, strict=True)
    }
    digest = write_tensors(path, tensors, {})
    card = {
        "format": FORMAT,
        "history": predictor.history,
        "time_step": float(predictor.time_step),
        "provenance": provenance,
        "sha256": digest,
    }
    write_json(path.with_suffix(".json"), card)
