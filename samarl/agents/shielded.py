"""An agent with a safety shield."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from samarl.agents.agent import Agent, checked_act
from samarl.observations.tracker import EpisodeTracks
from samarl.planning.shield import Shield, apply_shield
from samarl.policies.explanation import Explanation


@dataclass
class Shielded(Agent):
    """Wrapper that applies the safety shield to the actions of an agent."""

    agent: Agent
    shield: Shield

    def __post_init__(self) -> None:
        """Start without tracks."""
        super().__post_init__()
        self._tracks = EpisodeTracks(self.scenario, self.shield.track_time)
        self._replaced = np.zeros((0, self.scenario.robots), np.bool_)

    def for_scenario(self, scenario: Scenario) -> Self:
        """Return a new agent with the same settings and shield for another scenario."""
        return replace(self, scenario=scenario, agent=self.agent.for_scenario(scenario))

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the memory of the worlds [E] in which an episode begins."""
        self.agent.reset(worlds)
        self._tracks.reset(worlds)

    def focus(self, robots: NDArray[np.bool_]) -> None:
        """See `Agent.focus`."""
        self.agent.focus(robots)

    def version(self) -> str:
        """Return a digest of the code of the shield and of the agent."""
        return f"{super().version()}.{self.agent.version()}"

    def scope_warning(self) -> str | None:
        """Return the warning of the wrapped agent."""
        return self.agent.scope_warning()

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the agent's actions [E, N, A], with unsafe ones replaced by the shield."""
        action = checked_act(self.agent, observation, self.scenario)
        tracks = self._tracks.update(observation)
        checked = apply_shield(tracks, action, self.scenario, self.shield)
        self._replaced = (checked != action).any(-1)
        self._proposed, self._known = action, tracks.humans
        return checked

    def macro_actions(self) -> NDArray[np.int32] | None:
        """Return what the robots of the wrapped agent tell."""
        return self.agent.macro_actions()

    def explain(self) -> Explanation | None:
        """Return the agent's explanation, with what the shield checked and replaced."""
        return (self.agent.explain() or Explanation())._replace(
            shielded=self._replaced, proposed=self._proposed, tracks=self._known
        )
