"""Configuration of the training of the predictor."""

from __future__ import annotations

from dataclasses import dataclass

from mrsan import ConfigurationError
from mrsan.prediction import MOST_HISTORY
from mrsan.scenario import check_numbers, required


@dataclass
class Training:
    """Configuration of the network, its training and its training data."""

    hidden: int = required(1, 1024)  # hidden units of the network
    history: int = required(2, MOST_HISTORY)  # input positions, H
    steps: int = required(1, 200)  # predicted in training, K
    rounds: int = required(1, 10**6)  # each simulates new cases
    worlds: int = required(1, 10**5)  # per crowd in a round
    duration: int = required(1, 10**5)  # simulated steps of each world
    batch: int = required(1, 10**6)  # windows per optimiser step
    learning_rate: float = required(0.0, 1.0)  # initial; follows a cosine to zero
    max_gradient_norm: float = required(0.0, 1e6)
    newly_seen: float = required(0.0, 1.0)  # share of windows with a shortened history
    seed: int = required(0, 10**6)  # of the initial weights and the order of the windows

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: a number is out of range, or `duration` is too short.
        """
        check_numbers(self, "training")
        if self.duration < self.history + self.steps:
            raise ConfigurationError(
                f"training.duration is {self.duration}; it must be at least training.history + "
                f"training.steps ({self.history + self.steps})"
            )
