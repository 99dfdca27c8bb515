"""Worlds with one controller as a Gymnasium environment and as a vector environment.

Observations and actions of several robots have one more axis, [N, ...]: one controller drives the
team. The reward is their mean.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mrsan.features import (
    EGO_FEATURES,
    HEADING_COS,
    HEADING_SIN,
    PREFERRED_SPEED,
    RADIUS,
    TIME,
)
from mrsan.fields import ConfigurationError
from mrsan.metrics import Outcome, episodes_of, social_score
from mrsan.observation import Observation
from mrsan.rendering import RENDER_MODES, Renderer
from mrsan.scenario import Scenario
from mrsan.sensors.suite import SensorSuite
from mrsan.tasks import overridden
from mrsan.world import ActionError, Step, World

Array = NDArray[Any]


FARTHEST = np.float32(1e6)  # m and m/s, beyond everything that robots observe
_LARGEST = np.finfo(np.float32).max
_ALL = slice(None)


def as_spaces(scenario: Scenario) -> tuple[spaces.Dict, spaces.Box]:
    """Return the observation and the action space of one robot.

    The bounds are finite, as libraries expect: those of registered sensors, whose units are not
    known, are the largest numbers.
    """
    low = np.full(len(EGO_FEATURES), -FARTHEST, np.float32)
    high = -low
    low[[HEADING_COS, HEADING_SIN]], high[[HEADING_COS, HEADING_SIN]] = -1.0, 1.0
    low[[RADIUS, PREFERRED_SPEED, TIME]] = 0.0
    high[[RADIUS, PREFERRED_SPEED, TIME]] = scenario.robot_radius, scenario.robot_speed, 1.0
    entries: dict[str, spaces.Space[Any]] = {"ego": spaces.Box(low, high, dtype=np.float32)}
    for key, array in arrays_in_space(SensorSuite(scenario).empty(1)).items():
        if key != "ego":
            shape = array.shape[2:]
            bound = _LARGEST if key in scenario.sensors else FARTHEST
            if array.dtype == np.int8:
                entries[key] = spaces.Box(0, 1, shape, np.int8)
            elif key == "lidar":
                entries[key] = spaces.Box(0.0, np.float32(scenario.lidar_range), shape, np.float32)
            else:
                entries[key] = spaces.Box(-bound, bound, shape, np.float32)
    return spaces.Dict(entries), spaces.Box(-1.0, 1.0, (scenario.action_size,), np.float32)


def robot_observations(observation: Observation, world: int) -> list[dict[str, Array]]:
    """Return the observation of each robot of a world, in the form of `as_spaces`."""
    arrays = arrays_in_space(observation).items()
    robots = range(observation.ego.shape[1])
    return [{key: value[world, robot] for key, value in arrays} for robot in robots]


def robot_reward_parts(step: Step, world: int, robots: int | slice) -> dict[str, float]:
    """Return the terms of the reward by the names of `mrsan.RewardParts`, means over robots."""
    parts = step.reward_parts._asdict().items()
    return {name: float(part[world, robots].mean(dtype=np.float64)) for name, part in parts}


def end_info(world: World, index: int, robots: int | slice) -> dict[str, Any]:
    """Return how the episode of world `index` ended for the team and for some of its robots."""
    mask = np.arange(world.worlds) == index
    episodes = episodes_of(world.state, world.scenario, mask)
    return {
        "is_success": bool(episodes.success[0]),
        "outcome": _names(episodes.outcome[0, robots]),
        "social_score": float(social_score(episodes)[0, robots].mean()),
    }


def _names(outcomes: Array) -> str:
    return " ".join(Outcome(value).name for value in np.ravel(outcomes))


def arrays_in_space(observation: Observation) -> dict[str, Array]:
    """Return the arrays of an observation in the form of `as_spaces`, masks as integers.

    Without empty ones, which some libraries drop from spaces but not from observations.
    """
    return {
        key: value.view(np.int8) if value.dtype == np.bool_ else value
        for key, value in observation.arrays().items()
        if 0 not in value.shape[2:]
    }


def _team_observation(observation: Observation, world: int) -> dict[str, Array]:
    """Return the observation of the controller of one world."""
    robots = _ALL if observation.ego.shape[1] > 1 else 0
    return {key: value[world, robots] for key, value in arrays_in_space(observation).items()}


def _team_spaces(scenario: Scenario) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
    """Return the observation and the action space of the controller."""
    observation, action = as_spaces(scenario)
    if scenario.robots == 1:
        return observation, action
    return batch_space(observation, scenario.robots), batch_space(action, scenario.robots)


def _batched_parts(step: Step, worlds: Array) -> dict[str, Any]:
    """Return the terms of the reward of some worlds [E] in Gymnasium's vector form."""
    if not worlds.any():
        return {}
    parts: dict[str, Array] = {}
    for name, part in step.reward_parts._asdict().items():
        parts[name] = np.where(worlds, part.mean(1, dtype=np.float64), 0.0)
        parts[f"_{name}"] = worlds
    return {"reward_parts": parts, "_reward_parts": worlds}


def _scenario(scenario: Scenario | str | None, overrides: dict[str, Any]) -> Scenario:
    return overridden(scenario, {"robots": 1, **overrides} if scenario is None else overrides)


class GymnasiumEnv(gymnasium.Env[dict[str, Array], Array]):
    """One world; `gymnasium.make("mrsan/SocialNavigation-v0", humans=5)` has one robot.

    `gymnasium.make("mrsan/Doorway-v0")` is one of `mrsan.TASKS`, whose robots have one controller:
    observations and actions are [N, ...], the reward and its parts are means over the robots.
    `gymnasium.make("mrsan:mrsan/Doorway-v0")` also works where `mrsan` is not imported.
    `reset(seed=s)` begins case `s`; without a seed, the next episode of the same case. The `info`
    of a step contains `arrived` (all have) and `reward_parts`, numbers by the names of
    `mrsan.RewardParts`, and that of the last step also `is_success`, `outcome` (of each robot, with
    spaces between them) and `social_score`. `render_mode`
    "rgb_array" returns pictures [512, 512, 3]; "human" opens a window.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 4}  # noqa: RUF012 (as in Gymnasium)

    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]

    def __init__(
        self,
        scenario: Scenario | str | None = None,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        """Create a world.

        Args:
            scenario: the task, or its id, such as `mrsan/Doorway-v0`. None: SAMARL's,
                with one robot.
            render_mode: None, "rgb_array" or "human".
            **overrides: fields of the scenario, such as `humans=5`.
        """
        self.scenario = _scenario(scenario, overrides)
        self.world = World(self.scenario)
        self._action_shape = (1, self.scenario.robots, self.scenario.action_size)
        self._renderer = Renderer(render_mode, self.scenario)
        self.render_mode, self.metadata = render_mode, self._renderer.metadata
        self.observation_space, self.action_space = _team_spaces(self.scenario)
        self._is_first_reset = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin case `seed`; without a seed, the next episode of the same case."""
        super().reset(seed=seed)
        if seed is None and self._is_first_reset:
            seed = int(self.np_random.integers(2**31))
        self._is_first_reset = False
        observation = self.world.reset(None if seed is None else [seed])
        self._renderer.update_window(self.world)
        return _team_observation(observation, 0), {"arrived": False}

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Move the robot by one time step.

        Raises:
            ActionError: the action is not a number, out of range or of the wrong shape.
        """
        action = np.asarray(action)
        if action.shape != self.action_space.shape:
            raise ActionError(
                f"action has shape {action.shape}; it must have {self.action_space.shape}"
            )
        step = self.world.step(action.reshape(self._action_shape))
        self._renderer.update_window(self.world)
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        info: dict[str, Any] = {
            "arrived": bool(self.world.state.arrived[0].all()),
            "reward_parts": robot_reward_parts(step, 0, _ALL),
        }
        if terminated or truncated:
            info |= end_info(self.world, 0, _ALL)
        observation, reward = _team_observation(step.observation, 0), step.reward[0]
        return observation, float(reward.mean(dtype=np.float64)), terminated, truncated, info

    def render(self) -> Array | None:
        """Return the picture in mode "rgb_array", [512, 512, 3] uint8; otherwise None."""
        return self._renderer.frame(self.world)

    def close(self) -> None:
        """Close the window if there is one."""
        self._renderer.close()


class GymnasiumVectorEnv(VectorEnv[dict[str, Array], Array, Array]):
    """E worlds stepped together, with Gymnasium's three autoreset modes; see `GymnasiumEnv`.

    `gymnasium.make_vec("mrsan/SocialNavigation-v0", num_envs=64, autoreset_mode="SameStep")`.
    World `e` plays case `seed + e`, so the results equal those of a `SyncVectorEnv` of E
    environments.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Scenario | str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        """Create the worlds.

        Args:
            num_envs: their number E.
            scenario: the task, or its id, such as `mrsan/Doorway-v0`. None: SAMARL's,
                with one robot.
            autoreset_mode: when a world that has ended begins its next episode.
            render_mode: None or "rgb_array".
            **overrides: fields of the scenario, such as `humans=5`.
        """
        if render_mode == "human":
            raise ConfigurationError("render_mode is 'human'; it must be None or rgb_array")
        self.scenario = _scenario(scenario, overrides)
        self._action_shape = (num_envs, self.scenario.robots, self.scenario.action_size)
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self._renderer = Renderer(render_mode, self.scenario)
        self.render_mode = render_mode
        self.metadata = {"autoreset_mode": self.autoreset_mode, **self._renderer.metadata}
        self.single_observation_space, self.single_action_space = _team_spaces(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.world = World(self.scenario, num_envs)
        self._is_first_reset = True

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin cases `seed`, `seed + 1`, ...; without a seed, the next episodes of the same cases.

        Args:
            seed: case of the first world, or [E] the case of each; None: as before.
            options: `options["reset_mask"]`, [E] bool, are the worlds to reset; None: all.
        """
        mask = np.ones(self.num_envs, np.bool_)
        if options is not None and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
                raise ValueError(f"reset_mask is {mask!r}; it must be {self.num_envs} booleans")
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is None and self._is_first_reset:
            seed = int(self.np_random.integers(2**31))
        self._is_first_reset = False
        if seed is None or isinstance(seed, int):
            seeds = [None if seed is None else seed + e for e in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} numbers; it must have {self.num_envs}")
        seeded = mask & np.array([s is not None for s in seeds])
        if (mask & ~seeded).any():
            self.world.reset(worlds=mask & ~seeded)
        if seeded.any():
            self.world.reset([0 if s is None else s for s in seeds], seeded)
        info = {"arrived": np.zeros(self.num_envs, np.bool_), "_arrived": mask.copy()}
        return self._batch(self.world.observe()), info

    def step(self, actions: Array) -> tuple[dict[str, Array], Array, Array, Array, dict[str, Any]]:
        """Move every world by one time step; reset ended worlds according to the autoreset mode.

        Raises:
            ActionError: an action is not a number, out of range or of the wrong shape.
            RuntimeError: autoreset is disabled and a world that has ended was not reset.
        """
        ended_before = self.world.state.done
        if self.autoreset_mode is AutoresetMode.DISABLED and ended_before.any():
            raise RuntimeError(
                f"world {int(np.flatnonzero(ended_before)[0])} has ended; reset it with "
                "options={'reset_mask': ...} before stepping"
            )
        action = np.asarray(actions)
        if action.shape != self.action_space.shape:
            raise ActionError(
                f"actions have shape {action.shape}; they must have {self.action_space.shape}"
            )
        step = self.world.step(action.reshape(self._action_shape))
        observation, done = step.observation, step.terminated | step.truncated
        everywhere = np.ones(self.num_envs, np.bool_)
        infos: dict[str, Any] = {
            "arrived": self.world.state.arrived.all(1),
            "_arrived": everywhere,
        }
        stepped = everywhere
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and ended_before.any():
            observation = self.world.reset(worlds=ended_before)
            step.terminated[ended_before] = step.truncated[ended_before] = False
            infos["arrived"][ended_before] = False
            stepped = ~ended_before
            done = done & ~ended_before
        if done.any():
            ending = self._endings(done)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                infos["final_obs"] = np.full(self.num_envs, None, dtype=object)
                for e in np.flatnonzero(done).tolist():
                    infos["final_obs"][e] = _team_observation(observation, e)
                final = {
                    "arrived": infos["arrived"] & done,
                    "_arrived": done,
                    **_batched_parts(step, done),
                }
                stepped = ~done
                infos |= {"_final_obs": done, "final_info": final | ending, "_final_info": done}
                observation = self.world.reset(worlds=done)
                infos["arrived"] = infos["arrived"] & ~done
            else:
                infos |= ending
        infos |= _batched_parts(step, stepped)
        reward = step.reward.mean(1, dtype=np.float64)
        return self._batch(observation), reward, step.terminated, step.truncated, infos

    def render(self) -> tuple[Array, ...] | None:
        """Return pictures [512, 512, 3] uint8 of all worlds in mode "rgb_array"; otherwise None."""
        if self.render_mode is None:
            return None
        return tuple(self._renderer.picture(self.world, e) for e in range(self.num_envs))

    def _endings(self, done: Array) -> dict[str, Any]:
        """Return success, outcome and social score of ended worlds, in Gymnasium's vector form."""
        episodes = episodes_of(self.world.state, self.scenario, done)
        outcome = np.full(self.num_envs, None, dtype=object)
        outcome[done] = [_names(outcomes) for outcomes in episodes.outcome]
        success = np.zeros(self.num_envs, np.bool_)
        success[done] = episodes.success
        score = np.zeros(self.num_envs)
        score[done] = social_score(episodes).mean(1)
        return {
            "is_success": success,
            "_is_success": done,
            "outcome": outcome,
            "_outcome": done,
            "social_score": score,
            "_social_score": done,
        }

    def _batch(self, observation: Observation) -> dict[str, Array]:
        robots = _ALL if self.scenario.robots > 1 else 0
        return {key: value[:, robots] for key, value in arrays_in_space(observation).items()}
