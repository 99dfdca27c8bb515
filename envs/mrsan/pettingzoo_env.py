"""One world as a PettingZoo parallel environment."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from mrsan.gymnasium_env import (
    FARTHEST,
    as_spaces,
    end_info,
    robot_observations,
    robot_reward_parts,
)
from mrsan.observation import Observation
from mrsan.rendering import RENDER_MODES, Renderer
from mrsan.scenario import Scenario
from mrsan.tasks import overridden
from mrsan.world import ActionError, World

Array = NDArray[Any]


class PettingZooEnv(ParallelEnv[str, dict[str, Array], Array]):
    """N robots named `robot_0`, ... in one world.

    All robots stay until the joint episode ends (by a collision, the last arrival or the time
    limit). A robot that has arrived parks: its action is ignored and may be omitted, and it still
    receives the team's bonus. `reset(seed=s)` begins case `s`; without a seed, the next episode of
    the same case. The infos of a step contain `arrived` and `reward_parts`, numbers by the names of
    `mrsan.RewardParts`, and those of the last step also the entries of `end_info`.

    Examples:
        >>> env = PettingZooEnv(humans=5)
        >>> observations, infos = env.reset(seed=7)
        >>> observations["robot_0"]["humans"].shape
        (5, 5)
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "mrsan_v0",
        "render_modes": RENDER_MODES,
        "render_fps": 4,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: Scenario | str | None = None,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        """Create one world.

        Args:
            scenario: the task, or its id, such as `mrsan/Doorway-v0`. None: SAMARL's.
            render_mode: None, "rgb_array" or "human".
            **overrides: fields of the scenario, such as `humans=5`.
        """
        self.scenario = overridden(scenario, overrides)
        self.world = World(self.scenario)
        self._renderer = Renderer(render_mode, self.scenario)
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, **self._renderer.metadata}  # type: ignore[misc]
        self.possible_agents = [f"robot_{i}" for i in range(self.scenario.robots)]
        self.agents: list[str] = []
        observation, action = as_spaces(self.scenario)
        self.observation_spaces = dict.fromkeys(self.possible_agents, observation)
        self.action_spaces = dict.fromkeys(self.possible_agents, action)
        numbers = 8 * self.scenario.robots + 6 * self.scenario.humans
        self.state_space = spaces.Box(-FARTHEST, FARTHEST, (numbers,), np.float32)
        self._is_first_reset = True

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the observation space of `agent`."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the action space of `agent`."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, dict[str, Array]], dict[str, dict[str, Any]]]:
        """Begin case `seed`; without a seed, the next episode of the same case."""
        if seed is None and self._is_first_reset:
            seed = int(np.random.default_rng().integers(2**31))
        self._is_first_reset = False
        observation = self.world.reset(None if seed is None else [seed])
        self.agents = list(self.possible_agents)
        self._renderer.update_window(self.world)
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
                raise ActionError(f"action of {agent} is missing; only arrived robots may omit it")
        step = self.world.step(joint)
        self._renderer.update_window(self.world)
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
            self._split(step.observation),
            {agent: float(step.reward[0, i]) for i, agent in enumerate(agents)},
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            infos,
        )

    def render(self) -> Array | None:
        """Return the picture in mode "rgb_array", [512, 512, 3] uint8; otherwise None."""
        return self._renderer.frame(self.world)

    def close(self) -> None:
        """Close the window if there is one."""
        self._renderer.close()

    def state(self) -> Array:
        """Return the true state of all agents as one array, in the units of `mrsan.World`.

        Returns:
            [8 N + 6 M]: the position, velocity, heading, goal and arrival (0 or 1) of each robot,
            then the presence (0 or 1), position, velocity and radius of each human, all zero for
            absent humans.
        """
        s, e = self.world.state, 0
        robots = (
            s.robot_position[e],
            s.robot_velocity[e],
            s.robot_heading[e, :, None],
            s.robot_goal[e],
            s.arrived[e, :, None],
        )
        present = s.human_present[e, :, None]
        humans = np.concatenate(
            [present, s.human_position[e], s.human_velocity[e], s.human_radius[e, :, None]], axis=1
        )
        return np.concatenate(
            [np.concatenate(robots, axis=1).ravel(), (humans * present).ravel()]
        ).astype(np.float32)

    def _split(self, observation: Observation) -> dict[str, dict[str, Array]]:
        return dict(zip(self.possible_agents, robot_observations(observation, 0), strict=True))
