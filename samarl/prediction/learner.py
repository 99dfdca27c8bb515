"""Training the network that predicts people (`mrsan.prediction.RecurrentPredictor`).

It learns from simulated crowds that no robot disturbs, in training cases only.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import safe_open
from torch import Tensor, nn
from tqdm import tqdm

from mrsan import ConfigurationError, Scenario, Split
from mrsan.prediction import (
    FORMAT,
    ConstantVelocity,
    RecurrentPredictor,
    own_frame,
    shapes,
)
from mrsan.se2 import unrotate_vectors
from samarl.files import write_json
from samarl.policies.checkpoint import attribute_errors_to, check_finite, write_tensors
from samarl.prediction.training import Training
from samarl.prediction.windows import Windows, watch

ROUNDING = 1e-4  # m^2; keeps the slope of a distance finite at zero


class Network(nn.Module):
    """The network of `mrsan.kernels.recurrent`, for learning."""

    def __init__(self, hidden: int) -> None:
        """Begin as constant velocity: nothing is added to it yet."""
        super().__init__()
        sizes = shapes(hidden)
        self.w_input = nn.Parameter(torch.randn(sizes["w_input"]) / 2**0.5)
        self.w_hidden = nn.Parameter(torch.randn(sizes["w_hidden"]) / hidden**0.5)
        self.bias = nn.Parameter(torch.zeros(sizes["bias"]))
        self.w_output = nn.Parameter(torch.zeros(sizes["w_output"]))

    def forward(self, velocities: Tensor, known: Tensor, steps: int, time_step: float) -> Tensor:
        """See `mrsan.kernels.recurrent.predict_offsets`."""
        hidden = velocities.new_zeros(len(velocities), len(self.w_hidden))
        for t in range(velocities.shape[1]):
            read = self._read(velocities[:, t], hidden)
            hidden = torch.where(known[:, t, None], read, hidden)
        added = place = torch.zeros_like(velocities[:, 0])
        places = []
        for k in range(steps):
            if k > 0:
                hidden = self._read(velocities[:, -1] + added, hidden)
            added = added + hidden @ self.w_output
            place = place + added * time_step
            places.append(place)
        return torch.stack(places, 1)

    def _read(self, velocity: Tensor, hidden: Tensor) -> Tensor:
        update, reset, candidate = (velocity @ self.w_input + self.bias).chunk(3, -1)
        was_update, was_reset, was_candidate = (hidden @ self.w_hidden).chunk(3, -1)
        gate, reset = _gate(update + was_update), _gate(reset + was_reset)
        candidate = nn.functional.softsign(candidate + reset * was_candidate)
        return candidate + gate * (hidden - candidate)

    def predictor(self, history: int, time_step: float) -> RecurrentPredictor:
        """The same network as the simulator runs it."""
        weights = {name: weight.detach().numpy() for name, weight in self.named_parameters()}
        return RecurrentPredictor(weights, history, time_step)


def _gate(x: Tensor) -> Tensor:
    return 0.5 + 0.5 * nn.functional.softsign(x)


class Learner:
    """Trains the network; its state is a file, so that it can go on where it was interrupted."""

    def __init__(self, training: Training, crowds: Mapping[str, Scenario], state: Path) -> None:
        """Begin, or go on from the file `state`.

        Raises:
            ConfigurationError: the crowds have different time steps, or the file is of another run.
        """
        self.training, self.crowds, self.path = training, crowds, state
        steps = {scenario.time_step for scenario in crowds.values()}
        if len(steps) != 1:
            raise ConfigurationError(
                f"crowds have the time steps {sorted(steps)}; there must be crowds, all of one step"
            )
        (self.time_step,) = steps
        torch.manual_seed(training.seed)
        self.network = Network(training.hidden)
        self.optimiser = torch.optim.Adam(self.network.parameters(), training.learning_rate)
        self.round = 0
        plain = {name: asdict(scenario) for name, scenario in crowds.items()}
        self._run = hashlib.sha256(repr((asdict(training), plain)).encode()).hexdigest()
        if state.is_file():
            self.restore()

    def learn(self) -> None:
        """The rounds that are left; the state is written after every tenth."""
        rounds = range(self.round, self.training.rounds)
        bar = tqdm(rounds, "rounds", self.training.rounds, initial=self.round, disable=None)
        for self.round in bar:
            bar.set_postfix_str(f"mean error {self._one_round():.3f} m")
            if (self.round + 1) % 10 == 0 or self.round + 1 == self.training.rounds:
                self.save()
        self.round = self.training.rounds

    def predictor(self) -> RecurrentPredictor:
        """What has been learned."""
        return self.network.predictor(self.training.history, self.time_step)

    def _one_round(self) -> float:
        """New cases of every crowd, each window once; returns the mean error, m."""
        t = self.training
        rng = np.random.default_rng((t.seed, self.round))
        cases = Split.training.case(t.worlds * self.round) + np.arange(t.worlds, dtype=np.int64)
        seen = [watch(scenario, cases, t) for scenario in self.crowds.values()]
        windows = Windows(*(np.concatenate(part) for part in zip(*seen, strict=True)))
        cut = rng.integers(0, t.history, len(windows.past))  # for newly seen people
        cut[rng.random(len(cut)) >= t.newly_seen] = 0
        known = windows.known & (np.arange(t.history) >= cut[:, None])
        step = np.float32(self.time_step)
        velocities, readable, ahead = own_frame(windows.past, known, windows.velocity, step)
        straight = ConstantVelocity(self.time_step).predict(
            windows.past, known, windows.velocity, t.steps
        )
        displacements = unrotate_vectors(windows.future - straight, ahead[:, None])
        tensors = [torch.from_numpy(array) for array in (velocities, readable, displacements)]
        order = torch.from_numpy(rng.permutation(np.flatnonzero(ahead.any(-1))))
        for group in self.optimiser.param_groups:
            group["lr"] = 0.5 * t.learning_rate * (1 + np.cos(np.pi * self.round / t.rounds))
        losses = []
        for batch in order.split(t.batch):
            velocity, may_read, target = (tensor[batch] for tensor in tensors)
            found = self.network(velocity, may_read, t.steps, self.time_step)
            loss = ((found - target).square().sum(-1) + ROUNDING).sqrt().mean()
            self.optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(self.network.parameters(), t.max_gradient_norm)
            self.optimiser.step()
            losses.append(float(loss.detach()))
        return float(np.mean(losses))

    def _tensors(self) -> dict[str, Tensor]:
        """What changes in training; the optimiser's part only once it has begun."""
        found = {f"network/{name}": value for name, value in self.network.state_dict().items()}
        for number, moments in self.optimiser.state_dict()["state"].items():
            found |= {f"optimiser/{number}/{name}": value for name, value in moments.items()}
        return found

    def save(self) -> None:
        """Write the file, whole or not at all."""
        progress = {"run": self._run, "rounds": str(self.round + 1)}
        write_tensors(self.path, self._tensors(), progress)

    def restore(self) -> None:
        """Go on from the file.

        Raises:
            ConfigurationError: it is damaged, or of another training.
        """
        with attribute_errors_to(self.path), safe_open(self.path, "pt") as file:
            progress = {"run": "", **(file.metadata() or {})}
            found = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        if progress["run"] != self._run:
            raise ConfigurationError(
                f"{self.path} is of another training; choose another output, or remove it"
            )
        with attribute_errors_to(self.path):
            self._load_state(found, int(progress["rounds"]))

    def _load_state(self, found: Mapping[str, Tensor], rounds: int) -> None:
        network: dict[str, Tensor] = {}
        moments: dict[int, dict[str, Tensor]] = {}
        for name, value in found.items():
            kind, *rest = name.split("/")
            if kind == "network":
                network[rest[0]] = value
            else:
                moments.setdefault(int(rest[0]), {})[rest[1]] = value
        check_finite(self.path, network)
        self.network.load_state_dict(network)
        groups = self.optimiser.state_dict()["param_groups"]
        self.optimiser.load_state_dict({"state": moments, "param_groups": groups})
        self.round = rounds


def save_predictor(path: Path, predictor: RecurrentPredictor, made: dict[str, Any]) -> None:
    """Write the weights `path` (ending in .safetensors) and their card beside it."""
    tensors = {
        name: torch.from_numpy(weight)
        for name, weight in zip(shapes(1), predictor.weights, strict=True)
    }
    digest = write_tensors(path, tensors, {})
    card = {
        "format": FORMAT, "history": predictor.history, "time_step": float(predictor.time_step),
        "made": made, "sha256": digest,
    }  # fmt: skip
    write_json(path.with_suffix(".json"), card)
