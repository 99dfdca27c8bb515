"""The interface of everything that drives robots."""

from __future__ import annotations

import hashlib
import inspect
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.fields import check_numbers
from samarl.policies.explanation import Explanation


@dataclass
class Agent(ABC):
    """Drives all robots of E worlds, each from its own observations alone.

    Subclasses are dataclasses: their fields are the knobs of their YAML file in `conf/agent/`.
    """

    scenario: Scenario

    def __post_init__(self) -> None:
        """Check every number of the subclass."""
        check_numbers(self, "agent")

    def reset(self, worlds: NDArray[np.bool_]) -> None:  # noqa: B027 (planners remember nothing)
        """Forget what was remembered of the worlds [E] in which an episode begins."""

    def version(self) -> str:
        """A digest of what decides its actions besides its fields: the files of its class."""
        files = {inspect.getsourcefile(base) for base in type(self).__mro__[:-2]}
        digest = hashlib.sha256()
        for file in sorted(filter(None, files)):
            digest.update(Path(file).read_bytes())
        return digest.hexdigest()[:16]

    def scope_warning(self) -> str | None:
        """What a user should know before it is played in this scenario, in one line."""
        return None

    @abstractmethod
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The action of every robot, [E, N, A] in [-1, 1]."""

    def explain(self) -> Explanation | None:
        """What led to the last action, for pictures; most agents have nothing to say."""
        return None
