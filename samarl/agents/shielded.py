"""The safety shield over an agent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from samarl.agents.agent import Agent
from samarl.planning.foresight import Lookout
from samarl.planning.shield import Shield, shielded
from samarl.policies.explanation import Explanation


@dataclass
class Shielded(Agent):
    """Any agent, with a shield that checks its actions."""

    agent: Agent
    shield: Shield

    def __post_init__(self) -> None:
        """Remember nothing yet."""
        super().__post_init__()
        numbers, field = self.shield, "agent.shield.predictor"
        self._lookout = Lookout(
            self.scenario, numbers.track_time, numbers.predictor, numbers.horizon, field
        )
        self._replaced = np.zeros((0, self.scenario.robots), np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget what was remembered of the worlds [E] in which an episode begins."""
        self.agent.reset(worlds)
        self._lookout.reset(worlds)

    def version(self) -> str:
        """A digest of the code of both."""
        return f"{super().version()}.{self.agent.version()}"

    def scope_warning(self) -> str | None:
        """That of the agent."""
        return self.agent.scope_warning()

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """What the agent does, [E, N, A], as far as the shield lets it pass."""
        action = self.agent.act(observation)
        known, aside = self._lookout.update(observation)
        checked = shielded(known, action, self.scenario, self.shield, aside)
        self._replaced = (checked != action).any(-1)
        return checked

    def explain(self) -> Explanation | None:
        """What the agent had in mind, and where the shield stepped in."""
        return (self.agent.explain() or Explanation())._replace(shielded=self._replaced)
