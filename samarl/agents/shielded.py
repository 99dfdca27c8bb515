"""The safety shield over an agent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.prediction import find_predictor
from samarl.agents.agent import Agent
from samarl.observations.tracker import Tracker
from samarl.planning.foresight import Foresight
from samarl.planning.shield import STRAIGHT, Shield, shielded
from samarl.policies.explanation import Explanation


@dataclass
class Shielded(Agent):
    """Any agent, with a shield that checks its actions."""

    agent: Agent
    shield: Shield

    def __post_init__(self) -> None:
        """Remember nothing yet."""
        super().__post_init__()
        self._tracker = Tracker(self.shield.track_steps, self.scenario.time_step)
        self._foresight = None
        if self.shield.predictor != STRAIGHT:
            predictor = find_predictor(
                self.shield.predictor, self.scenario.time_step, "agent.shield.predictor"
            )
            self._foresight = Foresight(predictor, self.shield.steps)
        self._begin(0)

    def _begin(self, worlds: int) -> None:
        s = self.scenario
        self._tracks = self._tracker.initial(worlds, s.robots, s.humans)
        if self._foresight:
            self._foresight.begin(worlds, s.robots, s.humans)
        self._is_init = np.ones(worlds, np.bool_)
        self._replaced = np.zeros((worlds, s.robots), np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget what was remembered of the worlds [E] in which an episode begins."""
        self.agent.reset(worlds)
        if len(worlds) != len(self._is_init):
            self._begin(len(worlds))
        self._is_init |= worlds

    def version(self) -> str:
        """A digest of the code of both."""
        return f"{super().version()}.{self.agent.version()}"

    def caution(self) -> str | None:
        """That of the agent."""
        return self.agent.caution()

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """What the agent does, [E, N, A], as far as the shield lets it pass."""
        action = self.agent.act(observation)
        if len(action) != len(self._is_init):
            self._begin(len(action))
        known = self._tracker.update(observation, self._tracks, self._is_init)
        aside = None
        if self._foresight:
            aside = self._foresight.update(known.ego, self._tracks, self._is_init)
        self._is_init = np.zeros(len(action), np.bool_)
        checked = shielded(known, action, self.scenario, self.shield, aside)
        self._replaced = (checked != action).any(-1)
        return checked

    def explain(self) -> Explanation | None:
        """What the agent had in mind, and where the shield stepped in."""
        return (self.agent.explain() or Explanation())._replace(shielded=self._replaced)
