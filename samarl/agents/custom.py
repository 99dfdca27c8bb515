"""Agents made of any function or object that returns actions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from samarl.agents.agent import Agent


@dataclass
class Custom(Agent):
    """Drives with a function `observation -> actions`, or with an object that has such an `act`.

    The object may have `reset(worlds)` as well, see `Agent.reset`.
    """

    controller: Callable[[Observation], Any] | Any

    def __post_init__(self) -> None:
        """Name it after the function or the class."""
        super().__post_init__()
        named = self.controller if hasattr(self.controller, "__name__") else type(self.controller)
        self.label = named.__name__

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Tell the object in which worlds [E] an episode begins."""
        reset = getattr(self.controller, "reset", None)
        if reset is not None:
            reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action of every robot, [E, N, A] in [-1, 1]."""
        act: Callable[[Observation], Any] = getattr(self.controller, "act", self.controller)
        return act(observation)
