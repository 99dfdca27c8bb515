"""What decides for robots in MuJoCo: an exported policy on each robot, or a planner."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.parameters import kernel_parameters
from samarl.agents import Agent
from samarl.agents.agent import checked_act
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.export import export_agent
from samarl.physics.world import Motion
from samarl.planning.velocity_control import action_to_motion
from samarl.runtime import Driver
from samarl.runtime.simulation import as_seen, sensor_readings, walls_in_view


class Controller(Protocol):
    """Decides for all robots of one world."""

    def reset(self) -> None:
        """Clear all memory: an episode begins."""

    def decide(self, observation: Observation, driving: NDArray[np.bool_], time: float) -> Motion:
        """Return the motion of every robot until the next decision.

        Args:
            observation: [1, N, ...].
            driving: [N] which robots have not arrived; the others get no motion.
            time: since the episode began, s.
        """


def controller_of(agent: Agent, name: str) -> Controller:
    """Return the controller of an agent: policies are exported and run on each robot.

    Raises:
        ConfigurationError: it is a policy that cannot be exported.
    """
    inner = agent.agent if isinstance(agent, Shielded) else agent
    if not isinstance(inner, Learned):
        return PlannerController(agent)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.onnx"
        export_agent(path, agent, name)
        drivers = [Driver.load(path) for _ in range(agent.scenario.robots)]
    return RuntimeController(drivers)


class RuntimeController:
    """An exported policy on every robot, through `samarl.runtime`."""

    def __init__(self, drivers: list[Driver]) -> None:
        """Drive robot i with driver i."""
        self.drivers = drivers

    def reset(self) -> None:
        """Clear all memory: an episode begins."""
        for driver in self.drivers:
            driver.reset(centre=(0.0, 0.0))

    def decide(self, observation: Observation, driving: NDArray[np.bool_], time: float) -> Motion:
        """Return the motion of every robot; see `Controller.decide`."""
        motion = _no_motion(len(driving))
        for i in np.flatnonzero(driving):
            driver = self.drivers[i]
            own, detections = as_seen(observation, int(i))
            sensors = {
                name: values
                for name, values in sensor_readings(observation, int(i)).items()
                if name in driver.sensor_inputs
            }
            walls = walls_in_view(observation, own, int(i)) if driver.avoids_walls else ()
            command = driver.step(own, detections, time, sensors, walls)
            motion.speed[i] = command.speed
            motion.turn[i] = command.turn_rate * driver.scenario.time_step
        return motion


class PlannerController:
    """An agent that is no policy; its actions become the motions that they mean in `mrsan`."""

    def __init__(self, agent: Agent) -> None:
        """Drive all robots with an agent."""
        self.agent, self._parameters = agent, kernel_parameters(agent.scenario)

    def reset(self) -> None:
        """Clear all memory: an episode begins."""
        self.agent.reset(np.ones(1, np.bool_))

    def decide(self, observation: Observation, driving: NDArray[np.bool_], time: float) -> Motion:
        """Return the motion of every robot; see `Controller.decide`."""
        action = checked_act(self.agent, observation, self.agent.scenario)
        motion = _no_motion(len(driving))
        for i in np.flatnonzero(driving):
            ego, own = observation.ego[:, i : i + 1], action[:, i : i + 1]
            motion.speed[i], motion.turn[i], *_ = action_to_motion(ego, own, self._parameters)
        return motion


def _no_motion(robots: int) -> Motion:
    return Motion(np.zeros(robots), np.zeros(robots))
