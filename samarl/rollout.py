"""What happened in T steps of many worlds, as a learner is given it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.utils._pytree import tree_map

from mrsan import Episodes, Scenario
from samarl.observations.frames import Frames
from samarl.policies.policy import LOCAL
from samarl.policies.stochastic import Sequences


def level_key(level: str) -> tuple[str, ...]:
    """Where the data of a level begins in `Rollout.steps`."""
    return ("agents",) if level == LOCAL else ("agents", level)


@dataclass
class Rollout:
    """S sequences of T steps, and the step after them, of N robots.

    Shapes: row s N + n of `frames`, `is_init` and `state` is robot n of sequence s; B = S N. A
    sequence is a world, or the part of a world's steps after it was taken back in time.

    `steps` is a TensorDict [S, T + 1] with TorchRL's names. Its last step was decided but not yet
    taken: values are bootstrapped from states in which something was decided, with what was decided
    there. It is the first step of the next rollout, which was thus decided before the last update.
    Keys:

    - `mask` [S, T + 1, 1], False: padding; `is_init` [S, T + 1, 1];
    - `("agents", "active_mask")` [S, T + 1, N], the robot was on its way;
    - `("agents", "speed")` [S, T + 1, N], m/s;
    - `("agents", ...)` with `action`, `sample_log_prob` and `previous_noise` (of the step before)
      of the local level, and with a macro level `waypoint_features` [S, T + 1, N, 3];
    - `("agents", "macro", ...)` with `action`, `sample_log_prob` and `decision_mask`;
    - `("next", "agents", "reward")` and `("next", "agents", "macro", "reward")` [S, T + 1, N];
    - `("next", "done")` [S, T + 1, 1];
    - `("next", "agents", "terminated")` [S, T + 1, N]; where only `done` is set, the time limit or
      a team-mate's collision cut the robot's episode short.
    """

    scenario: Scenario
    correlation: float  # of the exploration noise of the local level
    steps: TensorDict
    frames: Frames  # [B, h + T + 1, ...] what was known
    is_init: Tensor  # [B, h + T + 1]
    encoder: tuple[Any, ...]  # state of the encoder of each set of parameters, before step 0
    state: Frames | None  # [B, T + 1, ...] the true state, for central critics
    episodes: list[Episodes]  # those that ended
    environment_steps: int

    @property
    def robots(self) -> int:
        """N."""
        return self.scenario.robots

    def rows(self, sequences: Tensor) -> Tensor:
        """The rows of some sequences."""
        n = self.robots
        return (sequences.unsqueeze(1) * n + torch.arange(n, device=sequences.device)).flatten()

    def sequences(self, which: Tensor) -> Sequences:
        """What the robots of some sequences knew."""
        rows, sets = self.rows(which), len(self.encoder)
        states = tuple(
            tree_map(lambda tensor, i=i: tensor[rows[i::sets] // sets], state)
            for i, state in enumerate(self.encoder)
        )
        return Sequences(self.frames.select(rows), self.is_init[rows], states)

    def to(self, device: torch.device) -> Rollout:
        """The same on another device."""

        def move(value: Any) -> Any:
            return tree_map(lambda tensor: tensor.to(device, non_blocking=True), value)

        return Rollout(
            self.scenario,
            self.correlation,
            self.steps.to(device),
            move(self.frames),
            move(self.is_init),
            move(self.encoder),
            None if self.state is None else move(self.state),
            self.episodes,
            self.environment_steps,
        )
