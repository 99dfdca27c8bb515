"""A trained hierarchical policy as an agent."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from samarl.agents.agent import Agent, Explanation
from samarl.encoders import Frames
from samarl.observations.features import frames_of
from samarl.observations.tracker import Tracker
from samarl.policies.hierarchical import Architecture, HierarchicalPolicy, Waypoints, decide


class FirstWaypoints(Waypoints):
    """An ablation: the waypoint an episode began with is never renewed."""

    def due(self, ego: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Only at the beginning, [E, N]."""
        return super().due(ego) & (self.clock <= 0)

    def tick(self) -> None:
        """Time does not count."""


class RandomWaypoints(Waypoints):
    """An ablation: waypoints are drawn uniformly from where the macro level could put them."""

    def __init__(self, worlds: int, scenario: Scenario, architecture: Architecture) -> None:
        """The same draws every time."""
        super().__init__(worlds, scenario, architecture)
        self.random = np.random.default_rng(0)

    def set(
        self, ego: NDArray[np.float32], due: NDArray[np.bool_], macro: NDArray[np.float32]
    ) -> None:
        """Ignore the macro actions [E, N, 2]."""
        super().set(ego, due, self.random.uniform(-1, 1, macro.shape).astype(np.float32))


class Plan(Enum):
    """Which waypoints the local level is given."""

    learned = "those of the macro level"
    first = "the one an episode began with"
    random = "random ones"


WAYPOINTS = {Plan.learned: Waypoints, Plan.first: FirstWaypoints, Plan.random: RandomWaypoints}


class Deployed:
    """A policy driving the robots of E worlds, with what they remember: tracks, waypoints, frames.

    Every robot's action depends on its own observations alone.
    """

    def __init__(
        self, policy: HierarchicalPolicy, scenario: Scenario, plan: Plan = Plan.learned
    ) -> None:
        """Deploy `policy` in worlds of `scenario`, without exploration noise."""
        policy.check(scenario)
        self.policy, self.scenario, self.plan = policy, scenario, plan
        self.tracker = Tracker(policy.architecture.track_steps, scenario.time_step)
        self._remember_nothing(0)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""
        if len(worlds) != self._worlds:
            self._remember_nothing(len(worlds))
        self.tracker.reset(worlds)
        self.waypoints.reset(worlds)
        self._began |= worlds

    def _remember_nothing(self, worlds: int) -> None:
        self._worlds = worlds
        kind = WAYPOINTS[self.plan]
        self.waypoints: Waypoints = kind(worlds, self.scenario, self.policy.architecture)
        self._windows: Any = None
        self._frame: Frames | None = None
        self._began = np.ones(worlds, np.bool_)

    @torch.no_grad()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The mean action, [E, N, A]."""
        e, n = observation.ego.shape[:2]
        if e != self._worlds:
            self._remember_nothing(e)
        tracks = self.tracker.update(observation)
        frame = self._frame = frames_of(tracks, self.scenario)
        if self._windows is None:
            self._windows = self.policy.encoder.windows(frame)
        began = torch.from_numpy(np.repeat(self._began, n))
        self._began = np.zeros(e, np.bool_)
        y, self._windows = self.policy.encoder.step(frame, began, self._windows)
        y = y.view(e, n, -1)
        choice = decide(self.policy, y, tracks.ego, self.waypoints)
        return choice.action.clamp(-1, 1).numpy()

    @torch.no_grad()
    def explain(self) -> Explanation | None:
        """The waypoints, and the attention among those in view or remembered."""
        if self._frame is None:
            return None
        planned = self.policy.architecture.levels > 1
        waypoint = self.waypoints.position.copy() if planned else None
        shares = self.policy.encoder.attention(self._frame)
        if shares is None:
            return Explanation(waypoint, None, None)
        robots, humans = (
            share.view(self._worlds, self.scenario.robots, -1).numpy() for share in shares
        )
        return Explanation(waypoint, humans, robots)


@dataclass
class Learned(Agent):
    """A policy from a checkpoint."""

    checkpoint: str  # a file, or the name of one that is shipped
    waypoints: Plan = Plan.learned

    def __post_init__(self) -> None:
        """Load the checkpoint."""
        from samarl.policies.checkpoint import find_policy, load_policy

        super().__post_init__()
        policy, self.card = load_policy(find_policy(self.checkpoint))
        self._deployed = Deployed(policy, self.scenario, self.waypoints)

    def version(self) -> str:
        """A digest of the code and of the weights."""
        return f"{super().version()}.{self.card.sha256[:16]}"

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""
        self._deployed.reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The mean action, [E, N, A]."""
        return self._deployed.act(observation)

    def explain(self) -> Explanation | None:
        """Its waypoints and its attention."""
        return self._deployed.explain()
