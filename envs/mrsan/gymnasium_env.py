"""Single-robot worlds as a Gymnasium environment and as a vector environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from mrsan.features import EGO_FEATURES, OTHER_FEATURES
from mrsan.metrics import Outcome, episodes_of, social_score
from mrsan.scenario import ConfigurationError, Scenario, overridden
from mrsan.world import ActionError, Observation, World

Array = NDArray[Any]


def as_spaces(scenario: Scenario) -> tuple[spaces.Dict, spaces.Box]:
    """The observation and action space of one robot."""

    def floats(*shape: int) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, shape, np.float32)

    def flags(*shape: int) -> spaces.Box:
        return spaces.Box(0, 1, shape, np.int8)

    features, others = len(OTHER_FEATURES), scenario.robots - 1
    entries: dict[str, spaces.Space[Any]] = {
        "ego": floats(len(EGO_FEATURES)),
        "humans": floats(scenario.humans, features),
        "humans_visible": flags(scenario.humans),
        "robots": floats(others, features),
        "robots_visible": flags(others),
    }
    if not others:
        del entries["robots"], entries["robots_visible"]
    return spaces.Dict(entries), spaces.Box(-1.0, 1.0, (scenario.action_size,), np.float32)


def robot_observation(observation: Observation, world: int, robot: int) -> dict[str, Array]:
    """What one robot observes, as `as_spaces` describes it."""
    return {key: value[world, robot] for key, value in _arrays(observation).items()}


def end_info(world: World, index: int, robot: int) -> dict[str, Any]:
    """How the episode of world `index` ended for `robot`."""
    mask = np.arange(world.worlds) == index
    episodes = episodes_of(world.state, world.scenario, mask)
    return {
        "outcome": Outcome(episodes.outcome[0, robot]).name,
        "social_score": float(social_score(episodes)[0, robot]),
    }


def refuse_rendering(render_mode: object) -> None:
    """There is nothing to render with."""
    if render_mode is not None:
        raise ConfigurationError(
            f"render_mode is {render_mode!r}; it must be None (samarl-render draws a case)"
        )


def _arrays(observation: Observation) -> dict[str, Array]:
    arrays: dict[str, Array] = observation._asdict()
    arrays["humans_visible"] = observation.humans_visible.view(np.int8)
    arrays["robots_visible"] = observation.robots_visible.view(np.int8)
    if not observation.robots.shape[2]:
        del arrays["robots"], arrays["robots_visible"]
    return arrays


def _single_robot(scenario: Scenario | None, overrides: dict[str, Any]) -> Scenario:
    if scenario is None:
        overrides = {"robots": 1, **overrides}
    scenario = overridden(scenario, overrides)
    if scenario.robots != 1:
        raise ConfigurationError(
            f"scenario.robots is {scenario.robots}; Gymnasium drives 1, use the PettingZoo or "
            "TorchRL environment for several"
        )
    return scenario


class GymnasiumEnv(gymnasium.Env[dict[str, Array], Array]):
    """One robot in one world; `gymnasium.make("mrsan/SocialNavigation-v0", humans=5)`.

    `reset(seed=s)` plays case `s`; without a seed the next episode of it.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (as Gymnasium declares it)

    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]

    def __init__(
        self, scenario: Scenario | None = None, render_mode: None = None, **overrides: Any
    ) -> None:
        """Make a world of `scenario` (SAMARL's with one robot) with `overrides` of its fields."""
        refuse_rendering(render_mode)
        self.scenario = _single_robot(scenario, overrides)
        self.world = World(self.scenario)
        self.observation_space, self.action_space = as_spaces(self.scenario)
        self._fresh = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin case `seed`, or the next episode."""
        super().reset(seed=seed)
        if seed is None and self._fresh:
            seed = int(self.np_random.integers(2**31))
        self._fresh = False
        observation = self.world.reset(None if seed is None else [seed])
        return robot_observation(observation, 0, 0), {"arrived": False}

    def step(self, action: Array) -> tuple[dict[str, Array], float, bool, bool, dict[str, Any]]:
        """Move by one time step.

        Raises:
            ActionError: the action is not a number, out of range or of the wrong shape.
        """
        action = np.asarray(action)
        if action.shape != self.action_space.shape:
            raise ActionError(
                f"action has shape {action.shape}; it must have {self.action_space.shape}"
            )
        step = self.world.step(action[None, None])
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        info: dict[str, Any] = {"arrived": bool(self.world.state.arrived[0, 0])}
        if terminated or truncated:
            info |= end_info(self.world, 0, 0)
        observation = robot_observation(step.observation, 0, 0)
        return observation, float(step.reward[0, 0]), terminated, truncated, info


class GymnasiumVectorEnv(VectorEnv[dict[str, Array], Array, Array]):
    """E single-robot worlds stepped together, with Gymnasium's three autoreset modes.

    `gymnasium.make_vec("mrsan/SocialNavigation-v0", num_envs=64, autoreset_mode="SameStep")`.
    World `e` plays case `seed + e`, so it gives the numbers that `SyncVectorEnv` of E single
    environments gives.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: Scenario | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: None = None,
        **overrides: Any,
    ) -> None:
        """Make `num_envs` worlds of `scenario` with `overrides` of its fields."""
        refuse_rendering(render_mode)
        self.scenario = _single_robot(scenario, overrides)
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": []}
        self.single_observation_space, self.single_action_space = as_spaces(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.world = World(self.scenario, num_envs)
        self._fresh = True

    def reset(
        self,
        *,
        seed: int | list[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin cases `seed`, `seed + 1`, ...; `options["reset_mask"]` [E] resets only some."""
        mask = np.ones(self.num_envs, np.bool_)
        if options is not None and "reset_mask" in options:
            mask = np.asarray(options["reset_mask"])
            if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
                raise ValueError(f"reset_mask is {mask!r}; it must be {self.num_envs} booleans")
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is None and self._fresh:
            seed = int(self.np_random.integers(2**31))
        self._fresh = False
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
        """Move every world by one time step, and reset those that ended as the mode says.

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
        step = self.world.step(action[:, None])
        observation, done = step.observation, step.terminated | step.truncated
        everywhere = np.ones(self.num_envs, np.bool_)
        infos: dict[str, Any] = {
            "arrived": self.world.state.arrived[:, 0].copy(),
            "_arrived": everywhere,
        }
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and ended_before.any():
            observation = self.world.reset(worlds=ended_before)
            step.terminated[ended_before] = step.truncated[ended_before] = False
            infos["arrived"][ended_before] = False
            done = done & ~ended_before
        if done.any():
            ending = self._endings(done)
            if self.autoreset_mode is AutoresetMode.SAME_STEP:
                infos["final_obs"] = np.full(self.num_envs, None, dtype=object)
                for e in np.flatnonzero(done).tolist():
                    infos["final_obs"][e] = robot_observation(observation, e, 0)
                final = {"arrived": infos["arrived"] & done, "_arrived": done}
                infos |= {"_final_obs": done, "final_info": final | ending, "_final_info": done}
                observation = self.world.reset(worlds=done)
                infos["arrived"] = infos["arrived"] & ~done
            else:
                infos |= ending
        reward = step.reward[:, 0].astype(np.float64)
        return self._batch(observation), reward, step.terminated, step.truncated, infos

    def _endings(self, done: Array) -> dict[str, Any]:
        """Outcome and social score of the worlds that ended, in Gymnasium's vector form."""
        episodes = episodes_of(self.world.state, self.scenario, done)
        outcome = np.full(self.num_envs, None, dtype=object)
        outcome[done] = [Outcome(value).name for value in episodes.outcome[:, 0]]
        score = np.zeros(self.num_envs)
        score[done] = social_score(episodes)[:, 0]
        return {
            "outcome": outcome,
            "_outcome": done,
            "social_score": score,
            "_social_score": done,
        }

    def _batch(self, observation: Observation) -> dict[str, Array]:
        return {key: value[:, 0] for key, value in _arrays(observation).items()}
