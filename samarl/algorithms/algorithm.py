"""The interface of what changes the weights of a policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from torch import nn

from samarl.policies.policy import Policy
from samarl.registry import Registry
from samarl.rollout import Rollout

ALGORITHMS: Registry[Algorithm] = Registry("algorithm")


class Algorithm(nn.Module, ABC):
    """Learns from rollouts; what it needs besides the policy (critics, say) are its submodules."""

    policy: Policy
    uses_global_state = False  # it needs the true state in the rollouts
    uses_shield_targets = False  # it needs what the safety shield would do
    supports_data_parallel = False  # its gradients, over processes: it can train in several

    def __init__(self, policy: Policy, config: Any) -> None:
        """Make critics and optimisers.

        Args:
            policy: whose weights to change.
            config: its numbers, an instance of the dataclass it is registered with.
        """
        super().__init__()
        self.config = config
        self.__dict__["policy"] = policy  # no submodule: it is saved by itself

    @abstractmethod
    def set_progress(self, share: float) -> None:
        """Adapt learning rate and exploration to the share of the training that is over."""

    @abstractmethod
    def update(self, rollouts: list[Rollout]) -> dict[str, float]:
        """Learn from one round of rollouts, one per scenario; gives statistics by name."""

    @abstractmethod
    def optimisers(self) -> dict[str, Any]:
        """All optimisers by name, to be saved."""

    def _set_learning_rate(self, share: float) -> None:
        """Let it fall linearly over the training, down to a fiftieth."""
        for optimiser in self.optimisers().values():
            for group in optimiser.param_groups:
                group["lr"] = self.config.learning_rate * max(1.0 - share, 0.02)
