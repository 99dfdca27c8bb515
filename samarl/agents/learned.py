"""A trained policy as an agent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Kinematics, Observation, Scenario
from mrsan.fields import setting
from mrsan.parameters import kernel_parameters
from samarl.agents.agent import Agent
from samarl.planning.tracking import as_driven
from samarl.policies.checkpoint import find_policy, load_policy
from samarl.policies.explanation import Explanation
from samarl.policies.hierarchical import HierarchicalPolicy, Waypoints
from samarl.policies.policy import Decision, Policy
from samarl.registry import needed

# Fields of a scenario outside of whose trained values a policy may fail, with label and unit.
_SCOPE = {
    "fov_degrees": ("view", "degrees"),
    "time_step": ("time step", "s"),
    "robot_speed": ("robot speed", "m/s"),
    "robot_radius": ("robot radius", "m"),
}


class Deployed:
    """A policy driving the robots of E worlds, without exploration noise.

    Every robot's action depends on its own observations alone.
    """

    def __init__(
        self, policy: Policy, scenario: Scenario, waypoints: Waypoints = Waypoints.learned
    ) -> None:
        """Deploy `policy` in worlds of `scenario`.

        Raises:
            ConfigurationError: it cannot drive these robots, or has no waypoints to change.
        """
        policy.check(scenario)
        if isinstance(policy, HierarchicalPolicy):
            policy.waypoint_source, policy.team_size = waypoints, scenario.robots
        elif waypoints is not Waypoints.learned:
            raise ConfigurationError(
                f"agent.waypoints is {waypoints.name}; it must be learned for a policy without a "
                "macro level"
            )
        self.policy, self.scenario = policy, scenario
        self._worlds = -1
        self._begin(0)

    def _begin(self, worlds: int) -> None:
        self._worlds = worlds
        self._state = self.policy.initial_state(worlds, self.scenario)
        self._is_init = np.ones(worlds, np.bool_)
        self._decision: Decision | None = None

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""
        if len(worlds) != self._worlds:
            self._begin(len(worlds))
        self._is_init |= worlds

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The mean action, [E, N, A]."""
        if len(observation.ego) != self._worlds:
            self._begin(len(observation.ego))
        decision = self.policy.act(observation, self._state, self._is_init, self.scenario)
        self._decision = decision
        self._is_init = np.zeros(self._worlds, np.bool_)
        return decision.action

    def explain(self) -> Explanation | None:
        """See `Policy.explain`."""
        if self._decision is None:
            return None
        return self.policy.explain(self._decision)


@dataclass
class Learned(Agent):
    """A policy from a checkpoint."""

    checkpoint: str = needed(help="checkpoint file, or the name of one that ships")
    waypoints: Waypoints = setting(Waypoints.learned, help="source of the waypoints")
    track_velocity: bool = setting(
        False, help="track the velocities of robots of the kind it was trained on"
    )

    def __post_init__(self) -> None:
        """Load the checkpoint.

        Raises:
            ConfigurationError: it cannot be loaded, or was trained for another kind of robot.
        """
        super().__post_init__()
        self.policy, self.card = load_policy(find_policy(self.checkpoint))
        made, here = self.card.made.get("configuration"), self.scenario.kinematics
        known = {str(name).rpartition(".")[2] for name in _values(made, "kinematics")}
        self._own = self.scenario
        if known and here.name not in known:
            if not self.track_velocity:
                raise ConfigurationError(
                    f"scenario.kinematics is {here.name}; {self.checkpoint} drives "
                    f"{' or '.join(sorted(known))} robots (with agent.track_velocity=true others "
                    "track its velocities)"
                )
            self._own = replace(self.scenario, kinematics=Kinematics[min(known)])
        self._deployed = Deployed(self.policy, self._own, self.waypoints)

    @property
    def is_foreign(self) -> bool:
        """It drives robots of another kind than it was trained on."""
        return self._own is not self.scenario

    def version(self) -> str:
        """A digest of the code and of the weights."""
        return f"{super().version()}.{self.card.sha256[:16]}"

    def scope_warning(self) -> str | None:
        """Name the numbers of the scenario that lie outside of what the policy was trained for.

        Or say that it was trained among the recorded people that it meets here, who are recognised
        by the name of their file.
        """
        here, configuration = self.scenario, self.card.made.get("configuration")
        recording = Path(here.recording or "").name
        training_files = {Path(str(file)).name for file in _values(configuration, "recording")}
        if recording and recording in training_files:
            return f"{self.checkpoint} was trained among the people of {recording}"
        trained, actual = [], []
        for name, (label, unit) in _SCOPE.items():
            numbers = [v for v in _values(configuration, name) if isinstance(v, int | float)]
            value = getattr(here, name)
            if numbers and not min(numbers) <= value <= max(numbers):
                limits = " to ".join(f"{v:g}" for v in sorted({min(numbers), max(numbers)}))
                trained.append(f"a {label} of {limits} {unit}")
                actual.append(f"{value:g} {unit}")
        if not trained:
            return None
        return (
            f"{self.checkpoint} was trained for {' and '.join(trained)}; "
            f"here it is {' and '.join(actual)}"
        )

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""
        self._deployed.reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The mean action, [E, N, A]."""
        action = self._deployed.act(observation)
        if not self.is_foreign:
            return action
        own, here = kernel_parameters(self._own), kernel_parameters(self.scenario)
        return as_driven(observation.ego, action, own, here)

    def explain(self) -> Explanation | None:
        """Its waypoints and its attention."""
        return self._deployed.explain()


def _values(tree: Any, key: str) -> Iterator[Any]:
    """All values under `key` in a nested structure of a card."""
    if isinstance(tree, dict):
        for name, value in tree.items():
            if name == key:
                yield value
            else:
                yield from _values(value, key)
    elif isinstance(tree, list):
        for value in tree:
            yield from _values(value, key)
