"""What is trained on, and when."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from mrsan import ConfigurationError, Scenario
from mrsan.scenario import check_numbers, number


@dataclass
class Group:
    """A scenario that is trained on, in how many worlds, and when: several make a curriculum."""

    worlds: int = number(MISSING, 1, 10**6)
    begin: float = number(0.0, 0.0, 1.0)  # share of the training after which it is trained on ...
    end: float = number(1.0, 0.0, 1.0)  # ... and until which
    begun_share: float = number(0.0, 0.0, 1.0)  # of the episodes, begin on the way round the crowd
    retried_share: float = number(0.0, 0.0, 1.0)  # of the collisions, tried again
    noise_correlation: float = number(0.0, 0.0, 0.999)  # of the local level, from step to step
    scenario: Scenario = field(default_factory=Scenario)

    def check(self, name: str) -> None:
        """Check every number.

        Raises:
            ConfigurationError: names the field of the group `name` that is wrong.
        """
        check_numbers(self, name)
        if self.begin >= self.end:
            raise ConfigurationError(
                f"{name}.begin is {self.begin}; it must be less than {name}.end ({self.end})"
            )
