"""A trained hierarchical policy as an agent."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from mrsan import ConfigurationError, Observation, Scenario
from samarl.agents.agent import Agent
from samarl.agents.hierarchical import HierarchicalPolicy, Waypoints, decide, frames_of
from samarl.agents.tracker import Tracker
from samarl.encoders.spatio_temporal import Window


class Deployed:
    """A policy driving the robots of E worlds, with what they remember: tracks, waypoints, frames.

    Every robot's action depends on its own observations alone.
    """

    def __init__(self, policy: HierarchicalPolicy, scenario: Scenario) -> None:
        """Deploy `policy` in worlds of `scenario`, without exploration noise."""
        if policy.action_size != scenario.action_size:
            raise ConfigurationError(
                f"scenario.kinematics is {scenario.kinematics.name} with {scenario.action_size} "
                f"numbers per action; this policy was trained with {policy.action_size}"
            )
        self.policy, self.scenario = policy, scenario
        self.tracker = Tracker(policy.architecture.track_steps, scenario.time_step)
        self._worlds = 0

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""
        if len(worlds) != self._worlds:
            self._remember_nothing(len(worlds))
        self.tracker.reset(worlds)
        self.waypoints.reset(worlds)
        self._began |= worlds

    def _remember_nothing(self, worlds: int) -> None:
        self._worlds = worlds
        self.waypoints = Waypoints(worlds, self.scenario.robots, self.policy.architecture)
        self._windows: tuple[Window, Window] | None = None
        self._began = np.ones(worlds, np.bool_)

    @torch.no_grad()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The mean action, [E, N, A]."""
        e, n = observation.ego.shape[:2]
        tracks = self.tracker.update(observation)
        frame = frames_of(tracks, self.scenario)
        if self._windows is None:
            self._windows = self.policy.encoder.windows(frame)
        began = torch.from_numpy(np.repeat(self._began, n))
        self._began = np.zeros(e, np.bool_)
        y, self._windows = self.policy.encoder.step(frame, began, self._windows)
        y = y.view(e, n, -1)
        choice = decide(self.policy, y, tracks.ego, self.waypoints, deterministic=True)
        return choice.action.clamp(-1, 1).numpy()


@dataclass
class Learned(Agent):
    """A policy from a checkpoint file."""

    checkpoint: str

    def __post_init__(self) -> None:
        """Load the checkpoint."""
        from samarl.training.checkpoint import load_policy

        super().__post_init__()
        policy, self.card = load_policy(Path(self.checkpoint))
        self._deployed = Deployed(policy, self.scenario)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""
        self._deployed.reset(worlds)

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The mean action, [E, N, A]."""
        return self._deployed.act(observation)
