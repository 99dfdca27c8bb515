"""Base class of all agents."""

from __future__ import annotations

import hashlib
import inspect
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario, World
from mrsan.features import TIME
from mrsan.fields import check_numbers, short_repr
from mrsan.world import checked_actions
from samarl.policies.explanation import Explanation


class ScopeWarning(UserWarning):
    """An agent is used in a scenario outside of those of its training."""


class Controller(Protocol):
    """What drives all robots; `Agent` is one."""

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the memory of the worlds [E] in which an episode begins."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action of every robot, [E, N, A]."""


def checked_act(
    agent: Controller, observation: Observation, scenario: Scenario, role: str = "agent"
) -> NDArray[np.float32]:
    """Return the actions of an agent, [E, N, A].

    Raises:
        ActionError: an action is not a number, is out of range or has the wrong shape; the message
            names the agent.
    """
    return checked_actions(
        agent.act(observation),
        (*observation.ego.shape[:2], scenario.action_size),
        np.rint(observation.ego[:, 0, TIME] * scenario.time_limit_steps).astype(int),
        f"{role} {getattr(agent, 'label', '') or type(agent).__name__}: ",
    )


def act_and_tell(agent: Controller, observation: Observation, world: World) -> NDArray[np.float32]:
    """Return the actions of an agent [E, N, A], after its robots have told what they do.

    Raises:
        ActionError: see `checked_act`.
    """
    action = checked_act(agent, observation, world.scenario)
    if world.scenario.team_messages and hasattr(agent, "macro_actions"):
        macro_actions = agent.macro_actions()
        if macro_actions is not None:
            world.tell(macro_actions)
    return action


@dataclass
class Agent(ABC):
    """Controller of all robots of E worlds; each robot acts on its own observations only.

    Subclasses are dataclasses. Their fields are the settings of their YAML file in `conf/agent/`.
    """

    scenario: Scenario

    def __init_subclass__(cls, **arguments: Any) -> None:
        """Keep the short `repr`, which dataclasses would replace."""
        super().__init_subclass__(**arguments)
        if "__repr__" not in vars(cls):
            cls.__repr__ = Agent.__repr__  # type: ignore[method-assign]

    def __repr__(self) -> str:
        """Return the settings that differ from the defaults, and how the scenario does."""
        return self._settings(repr(self.scenario))

    def _settings(self, scenario: str | None = None) -> str:
        """Return the agent as Python code, by default without its scenario."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        inner = {n: agent._settings() for n, agent in values.items() if isinstance(agent, Agent)}
        return short_repr(self, inner | {"scenario": scenario})

    label = ""  # name in tables, which `samarl.load_agent` sets; empty: the name of the class

    def __post_init__(self) -> None:
        """Check every number of the subclass.

        Raises:
            ConfigurationError: a number is out of range.
        """
        check_numbers(self, "agent")

    def for_scenario(self, scenario: Scenario) -> Self:
        """Return a new agent with the same settings for another scenario.

        Raises:
            ConfigurationError: the agent cannot drive the robots of the scenario.
        """
        return replace(self, scenario=scenario)

    def reset(self, worlds: NDArray[np.bool_]) -> None:  # noqa: B027 (stateless agents need none)
        """Clear the memory of the worlds [E] in which an episode begins."""

    def version(self) -> str:
        """Return a digest of the source files of the class and its bases.

        It changes with whatever determines the actions besides the fields.
        """
        files = {inspect.getsourcefile(base) for base in type(self).__mro__[:-2]}
        digest = hashlib.sha256()
        for file in sorted(filter(None, files)):
            digest.update(Path(file).read_bytes())
        return digest.hexdigest()[:16]

    def scope_warning(self) -> str | None:
        """Return one line about how this scenario differs from the training scenarios, or None."""
        return None

    def focus(self, robots: NDArray[np.bool_]) -> None:  # noqa: B027 (it only saves time)
        """Tell the agent which actions of the next `act` will have an effect.

        The others may be any: those of robots that have arrived and of episodes that are over.
        """

    @abstractmethod
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the action of every robot, [E, N, A] in [-1, 1]."""

    def macro_actions(self) -> NDArray[np.int32] | None:
        """Return what robots tell team-mates that they are doing [E, N], or None (`World.tell`)."""
        return None

    def explain(self) -> Explanation | None:
        """Return what led to the last action, for visualisation, or None."""
        return None
