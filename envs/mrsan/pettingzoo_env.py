"""One world as a PettingZoo parallel environment."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from mrsan.gymnasium_env import (
    as_spaces,
    end_info,
    refuse_rendering,
    robot_observation,
    robot_reward_parts,
)
from mrsan.scenario import Scenario, overridden
from mrsan.world import ActionError, Observation, World

Array = NDArray[Any]


class PettingZooEnv(ParallelEnv[str, dict[str, Array], Array]):
    """N robots named `robot_0`, ... in one world.

    All robots stay until the joint episode ends (a collision, all arrived, the time limit): a
    robot that has arrived parks, its action is ignored and may be left out, and it still shares
    the team's bonus. `reset(seed=s)` plays case `s`; without a seed the next episode of it. The
    infos of a step have `arrived` and `reward_parts` [5], in the order of `mrsan.RewardParts`.

    Example:
        >>> env = PettingZooEnv(humans=5)
        >>> observations, infos = env.reset(seed=7)
        >>> observations["robot_0"]["humans"].shape
        (5, 5)
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "mrsan_v0",
        "render_modes": [],
        "is_parallelizable": True,
    }

    def __init__(
        self, scenario: Scenario | None = None, render_mode: None = None, **overrides: Any
    ) -> None:
        """Make one world of `scenario` (SAMARL's by default) with `overrides` of its fields."""
        refuse_rendering(render_mode)
        self.scenario = overridden(scenario, overrides)
        self.world = World(self.scenario)
        self.render_mode = None
        self.possible_agents = [f"robot_{i}" for i in range(self.scenario.robots)]
        self.agents: list[str] = []
        observation, action = as_spaces(self.scenario)
        self.observation_spaces = dict.fromkeys(self.possible_agents, observation)
        self.action_spaces = dict.fromkeys(self.possible_agents, action)
        self._fresh = True

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What `agent` observes."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """How `agent` acts."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, dict[str, Array]], dict[str, dict[str, Any]]]:
        """Begin case `seed`, or the next episode."""
        if seed is None and self._fresh:
            seed = int(np.random.default_rng().integers(2**31))
        self._fresh = False
        observation = self.world.reset(None if seed is None else [seed])
        self.agents = list(self.possible_agents)
        return self._split(observation), {agent: {"arrived": False} for agent in self.agents}

    def step(
        self, actions: dict[str, Array]
    ) -> tuple[
        dict[str, dict[str, Array]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Move all robots by one time step.

        Raises:
            ActionError: an action is missing, not a number, out of range or of the wrong shape.
        """
        agents = self.agents
        joint = np.zeros((1, self.scenario.robots, self.scenario.action_size), np.float32)
        for i, agent in enumerate(agents):
            if agent in actions:
                action = np.asarray(actions[agent])
                if action.shape != joint.shape[2:]:
                    raise ActionError(
                        f"action of {agent} has shape {action.shape}; it must have "
                        f"{joint.shape[2:]}"
                    )
                joint[0, i] = action
            elif not self.world.state.arrived[0, i]:
                raise ActionError(f"action of {agent} is missing; it is still on its way")
        step = self.world.step(joint)
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        arrived = self.world.state.arrived[0]
        infos: dict[str, dict[str, Any]] = {
            agent: {"arrived": bool(arrived[i]), "reward_parts": robot_reward_parts(step, 0, i)}
            for i, agent in enumerate(agents)
        }
        if terminated or truncated:
            for i, agent in enumerate(agents):
                infos[agent] |= end_info(self.world, 0, i)
            self.agents = []
        return (
            {agent: robot_observation(step.observation, 0, i) for i, agent in enumerate(agents)},
            {agent: float(step.reward[0, i]) for i, agent in enumerate(agents)},
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            infos,
        )

    def _split(self, observation: Observation) -> dict[str, dict[str, Array]]:
        return {
            agent: robot_observation(observation, 0, i)
            for i, agent in enumerate(self.possible_agents)
        }
