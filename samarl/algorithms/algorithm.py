"""Base class of learning algorithms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Protocol

from torch import nn

from samarl.policies.policy import Policy
from samarl.registry import Registry
from samarl.reward_shaping import RewardShaping
from samarl.rollout import Rollout

ALGORITHMS: Registry[Algorithm] = Registry("algorithm")


class AlgorithmConfig(Protocol):
    """What the dataclasses of all algorithms have."""

    learning_rate: float


class Algorithm(nn.Module, ABC):
    """Trains a policy on rollouts.

    Critics and other networks are its submodules, and numbers that it adapts are buffers
    (`register_buffer`): both are saved with the run.
    """

    policy: Policy
    reward_shaping = RewardShaping()  # of its next rollouts
    uses_global_state = False  # rollouts must hold the global state
    uses_shield_targets = False  # rollouts must hold the actions of the safety shield
    imitates = False  # rollouts must hold the actions of the teachers, where there are any
    teacher: str | None = None  # agent that is the teacher of stages which name none
    supports_data_parallel = False  # gradients can be averaged over processes

    def __init__(self, policy: Policy, config: AlgorithmConfig) -> None:
        """Create critics and optimisers."""
        super().__init__()
        self.config = config
        self.__dict__["policy"] = policy  # not a submodule: the trainer saves it separately

    @abstractmethod
    def set_progress(self, progress: float) -> None:
        """Set the learning rate and exploration for a training progress from 0 to 1."""

    @abstractmethod
    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Learn from the rollouts of all active stages; return statistics by name."""

    @abstractmethod
    def optimisers(self) -> dict[str, Any]:
        """Return all optimisers by name; the trainer saves their states."""

    def _set_learning_rate(self, progress: float) -> None:
        """Decay the learning rate linearly over the training, to 2 % of its initial value."""
        for optimiser in self.optimisers().values():
            for group in optimiser.param_groups:
                group["lr"] = self.config.learning_rate * max(1.0 - progress, 0.02)
