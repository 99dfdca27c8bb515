"""The numbers of a training of the predictor."""

from __future__ import annotations

from dataclasses import dataclass

from mrsan import ConfigurationError
from mrsan.fields import check_numbers, required
from mrsan.prediction import MOST_HISTORY


@dataclass
class Training:
    """How the network is trained, and on what."""

    hidden: int = required(1, 1024, help="hidden units of the network")
    history: int = required(2, MOST_HISTORY, help="positions H that it reads")
    steps: int = required(1, 200, help="steps K that it learns to predict")
    rounds: int = required(1, 10**6, help="rounds; each plays new cases")
    worlds: int = required(1, 10**5, help="worlds of each crowd per round")
    duration: int = required(1, 10**5, help="steps for which a crowd is observed")
    batch: int = required(1, 10**6, help="windows per gradient step")
    learning_rate: float = required(
        0.0, 1.0, help="initial learning rate; falls to 0 along half a cosine"
    )
    max_gradient_norm: float = required(0.0, 1e6, help="largest gradient norm")
    newly_seen: float = required(0.0, 1.0, help="share of the windows whose history is truncated")
    seed: int = required(
        0, 10**6, help="seed of the initial weights and of the order of the windows"
    )

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
