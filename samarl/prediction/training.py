"""Configuration of the training of the predictor."""

from __future__ import annotations

from dataclasses import dataclass

from mrsan import ConfigurationError
from mrsan.fields import check_numbers, required
from mrsan.prediction import MOST_HISTORY


@dataclass
class Training:
    """Configuration of the network, its training and its training data."""

    hidden: int = required(1, 1024, help="hidden units of the network")
    history: int = required(2, MOST_HISTORY, help="input positions H")
    steps: int = required(1, 200, help="steps K that are predicted in training")
    rounds: int = required(1, 10**6, help="rounds; each simulates new cases")
    worlds: int = required(1, 10**5, help="worlds per crowd and round")
    duration: int = required(1, 10**5, help="simulated steps of each world")
    batch: int = required(1, 10**6, help="windows per optimiser step")
    learning_rate: float = required(
        0.0, 1.0, help="initial learning rate; follows a cosine to zero"
    )
    max_gradient_norm: float = required(0.0, 1e6, help="largest gradient norm")
    newly_seen: float = required(0.0, 1.0, help="share of windows with a shortened history")
    seed: int = required(
        0, 10**6, help="seed of the initial weights and of the order of the windows"
    )

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
