"""Trained policies as agents."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Kinematics, Observation, Scenario
from mrsan.fields import setting
from mrsan.parameters import kernel_parameters
from samarl.agents.agent import Agent
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.planning.velocity_control import retarget_actions
from samarl.policies.card import RULE, find_policy
from samarl.policies.checkpoint import load_policy
from samarl.policies.explanation import Explanation
from samarl.policies.hierarchical import HierarchicalPolicy
from samarl.policies.macro_actions import Waypoints
from samarl.policies.policy import Decision, Policy
from samarl.registry import needed

# Scenario fields outside whose training range a policy may fail, with label and unit.
_SCOPE = {
    "fov_degrees": ("view", "degrees"),
    "time_step": ("time step", "s"),
    "robot_speed": ("robot speed", "m/s"),
    "robot_radius": ("robot radius", "m"),
}


class DeployedPolicy:
    """A policy that drives the robots of E worlds without exploration noise.

    Every robot acts on its own observations, and on what team-mates tell a guide.
    """

    def __init__(
        self,
        policy: Policy,
        scenario: Scenario,
        waypoints: Waypoints = Waypoints.learned,
        guide: RightOfWay | None = None,
    ) -> None:
        """Deploy `policy` in worlds of `scenario`, or sent to its targets by a guide.

        Raises:
            ConfigurationError: the policy cannot drive these robots, or has no macro level
                and `waypoints` is not `learned`.
        """
        policy.check(scenario)
        if isinstance(policy, HierarchicalPolicy):
            policy = copy.copy(policy)  # others may drive with it
            policy.waypoint_source, policy.team_size = waypoints, scenario.robots
        elif waypoints is not Waypoints.learned:
            raise ConfigurationError(
                f"agent.waypoints is {waypoints.name}; it must be learned for a policy without a "
                "macro level"
            )
        if guide is not None:
            scenario = replace(scenario, team_messages=False)  # they are for the guide
        self.policy, self.scenario, self.guide = policy, scenario, guide
        self._worlds = -1
        self._initialize(0)

    def _initialize(self, worlds: int) -> None:
        self._worlds = worlds
        self._state = self.policy.initial_state(worlds, self.scenario)
        self._is_init = np.ones(worlds, np.bool_)
        self._active: NDArray[np.bool_] | None = None
        self._decision: Decision | None = None

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the memory of the worlds [E] in which an episode begins."""
        if len(worlds) != self._worlds:
            self._initialize(len(worlds))
        self._is_init |= worlds
        if self.guide is not None:
            self.guide.reset(worlds)

    def focus(self, robots: NDArray[np.bool_]) -> None:
        """See `Agent.focus`; `explain` needs an `act` without it."""
        self._active = robots

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the mean action, [E, N, A]."""
        if len(observation.ego) != self._worlds:
            self._initialize(len(observation.ego))
        if self.guide is not None:
            self.guide.decide(observation)
            observation = self.guide.direct()
        decision = self.policy.act(
            observation, self._state, self._is_init, self.scenario, active=self._active
        )
        self._decision, self._active = decision, None
        self._is_init = np.zeros(self._worlds, np.bool_)
        return decision.action

    def macro_actions(self) -> NDArray[np.int32] | None:
        """See `Agent.macro_actions`."""
        return None if self.guide is None else self.guide.macro_actions()

    def explain(self) -> Explanation | None:
        """Return the explanation of the last action; see `Policy.explain`."""
        if self._decision is None:
            return None
        explanation = self.policy.explain(self._decision)
        if self.guide is None:
            return explanation
        guided, explanation = self.guide.explain(), explanation or Explanation()
        if explanation.waypoint is None:
            explanation = explanation._replace(waypoint=guided.waypoint)
        return explanation._replace(activity=guided.activity)


@dataclass
class Learned(Agent):
    """A policy loaded from a checkpoint, without a shield.

    `samarl.load_agent("samarl")` adds the shield of the agent's YAML file.
    """

    checkpoint: str = needed(help="checkpoint file or the name of a shipped policy")
    waypoints: Waypoints = setting(Waypoints.learned, help="source of the waypoints")
    track_velocity: bool = setting(
        False, help="let robots of other kinematics track its velocities"
    )
    right_of_way: str | None = setting(
        None,
        help="who goes first through doors and corridors, if robots tell each other "
        "(scenario.team_messages): rule, or a trained macro level; null: nobody decides",
    )

    def __post_init__(self) -> None:
        """Load the checkpoint.

        Raises:
            ConfigurationError: the checkpoint cannot be loaded, or its kinematics differ and
                `track_velocity` is false.
        """
        super().__post_init__()
        self.policy, self.card = load_policy(find_policy(self.checkpoint))
        kinematics = self.scenario.kinematics.name
        trained = {
            str(name).rpartition(".")[2] for name in self.card.values_in_training("kinematics")
        }
        self._policy_scenario = self.scenario
        if trained and kinematics not in trained:
            if not self.track_velocity:
                raise ConfigurationError(
                    f"scenario.kinematics is {kinematics}; it must be "
                    f"{' or '.join(sorted(trained))}, which {self.checkpoint} was trained with, or "
                    "the agent's file must have track_velocity: true (where one agent is selected: "
                    "agent.track_velocity=true), so that the robots track its velocities"
                )
            self._policy_scenario = replace(self.scenario, kinematics=Kinematics[min(trained)])
        guide = None
        robots_tell = self.scenario.has_walls and self.scenario.team_messages
        if self.right_of_way is not None and robots_tell:
            macro_level = None if self.right_of_way == RULE else self.right_of_way
            guide = RightOfWay(self.scenario, macro_level=macro_level)
        self._deployed = DeployedPolicy(self.policy, self._policy_scenario, self.waypoints, guide)

    @property
    def guide(self) -> RightOfWay | None:
        """What tells robots who goes first, if anything does."""
        return self._deployed.guide

    @property
    def kinematics_mismatch(self) -> bool:
        """Whether the robots have other kinematics than those the policy was trained with."""
        return self._policy_scenario is not self.scenario

    def version(self) -> str:
        """Return a digest of the code and of the weights."""
        version = f"{super().version()}.{self.card.sha256[:16]}"
        return version if self.guide is None else f"{version}.{self.guide.version()}"

    def scope_warning(self) -> str | None:
        """Return one line about how the scenario differs from those of the training, or None.

        It names numbers outside their training range, or a recording that the policy was trained
        on; recordings are recognised by their file name.
        """
        in_training = self.card.values_in_training
        recording = Path(self.scenario.recording or "").name
        training_files = {Path(str(file)).name for file in in_training("recording")}
        if recording and recording in training_files:
            return f"{self.checkpoint} was trained among the people of {recording}"
        trained, actual = [], []
        for name, (label, unit) in _SCOPE.items():
            numbers = [v for v in in_training(name) if isinstance(v, int | float)]
            value = getattr(self.scenario, name)
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
        """Clear the memory of the worlds [E] in which an episode begins."""
        self._deployed.reset(worlds)

    def focus(self, robots: NDArray[np.bool_]) -> None:
        """See `Agent.focus`."""
        self._deployed.focus(robots)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the mean action, [E, N, A]."""
        action = self._deployed.act(observation)
        if not self.kinematics_mismatch:
            return action
        source, target = kernel_parameters(self._policy_scenario), kernel_parameters(self.scenario)
        return retarget_actions(observation.ego, action, source, target)

    def macro_actions(self) -> NDArray[np.int32] | None:
        """See `Agent.macro_actions`."""
        return self._deployed.macro_actions()

    def explain(self) -> Explanation | None:
        """Return its waypoints, its attention, and whose turn it is."""
        return self._deployed.explain()
