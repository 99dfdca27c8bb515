"""The numbers of a training of the predictor."""

from __future__ import annotations

from dataclasses import dataclass

from mrsan import ConfigurationError
from mrsan.prediction import MOST_HISTORY
from mrsan.scenario import check_numbers, required


@dataclass
class Training:
    """How the network is trained, and on what."""

    hidden: int = required(1, 1024)  # units of the network
    history: int = required(2, MOST_HISTORY)  # positions that it reads, H
    steps: int = required(1, 200)  # that it learns to foresee, K
    rounds: int = required(1, 10**6)  # each plays cases that were not played before
    worlds: int = required(1, 10**5)  # of each crowd in a round
    duration: int = required(1, 10**5)  # steps for which a crowd is watched
    batch: int = required(1, 10**6)  # windows in a step of the optimiser
    learning_rate: float = required(0.0, 1.0)  # at first; it falls to zero along half a cosine
    max_gradient_norm: float = required(0.0, 1e6)
    newly_seen: float = required(0.0, 1.0)  # share of the windows whose history is cut short
    seed: int = required(0, 10**6)  # of the first weights and the order of the windows

    def __post_init__(self) -> None:
        """Check every number, and that crowds are watched for long enough.

        Raises:
            ConfigurationError: names the field, its value and what would be right.
        """
        check_numbers(self, "training")
        if self.duration < self.history + self.steps:
            raise ConfigurationError(
                f"training.duration is {self.duration}; it must be at least training.history + "
                f"training.steps ({self.history + self.steps})"
            )
