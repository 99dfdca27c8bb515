"""The worlds as a vector environment of Stable-Baselines3 (extra `examples`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan.gymnasium_env import arrays_in_space, as_spaces
from mrsan.metrics import Episodes, Outcome, social_score
from mrsan.observation import Observation
from mrsan.rendering import Renderer
from mrsan.scenario import Scenario
from mrsan.tasks import overridden
from mrsan.world import World

try:
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
except ModuleNotFoundError:
    raise ImportError(
        "mrsan.sb3_env needs stable-baselines3: pip install 'samarl[examples]'"
    ) from None

Array = NDArray[Any]


class SB3VecEnv(VecEnv):
    """E worlds of N robots, stepped together; robot n of world e is environment e N + n.

    All robots share the policy. The episodes of the robots of a world end together: `terminated`
    after a collision or when all have arrived, and truncated (`info["TimeLimit.truncated"]`) at the
    time limit. A robot that has arrived parks: its actions have no effect until then, and its
    `info["arrived"]` is true. The last `info` of an episode also has `terminal_observation`,
    `is_success`, `outcome` and `social_score`.

    World e plays case `seed + e`, and one episode of this case after another.

    Examples:
        >>> envs = SB3VecEnv(worlds=4, humans=5, robots=3)
        >>> envs.seed(0)[0], envs.num_envs, envs.reset()["humans"].shape
        (0, 12, (12, 5, 5))
    """

    actions: Array

    def __init__(
        self,
        scenario: Scenario | str | None = None,
        worlds: int = 32,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        """Create the worlds.

        Args:
            scenario: the task, or its id, such as `mrsan/Doorway-v0`. None: SAMARL's.
            worlds: their number E.
            render_mode: None or "rgb_array".
            **overrides: fields of the scenario, such as `humans=5`.
        """
        self.scenario = overridden(scenario, overrides)
        self.world = World(self.scenario, worlds, auto_reset=True)
        self._renderer = Renderer(render_mode, self.scenario)
        self.render_mode = render_mode
        super().__init__(worlds * self.scenario.robots, *as_spaces(self.scenario))

    def reset(self) -> dict[str, Array]:
        """Begin the cases of `seed`; without a seed, random ones at first, then next episodes."""
        if self._seeds[0] is None and (self.world.state.episode < 0).all():
            self.seed()
        cases = None
        if (seed := self._seeds[0]) is not None:
            cases = seed + np.arange(self.world.worlds)
        observation = self.world.reset(cases)
        self._reset_seeds()
        self._reset_options()
        return self._batch(observation)

    def step_async(self, actions: Array) -> None:
        """Store the actions [E N, A] for `step_wait`."""
        self.actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Move every world by one time step; worlds that have ended begin their next episode.

        Raises:
            ActionError: an action is not a number, out of range or of the wrong shape.
        """
        e, n = self.world.worlds, self.scenario.robots
        step = self.world.step(np.asarray(self.actions).reshape(e, n, -1))
        infos: list[dict[str, Any]]
        infos = [{"arrived": value} for value in self.world.state.arrived.ravel().tolist()]
        done = step.terminated | step.truncated
        if step.finished is not None and step.final_observation is not None:
            final = self._batch(step.final_observation)
            rows = (np.flatnonzero(done)[:, None] * n + np.arange(n)).ravel()
            truncated = np.repeat(step.truncated[done] & ~step.terminated[done], n)
            for index, (row, info) in enumerate(zip(rows, _endings(step.finished), strict=True)):
                infos[row] = {
                    **info,
                    "terminal_observation": {key: value[index] for key, value in final.items()},
                    "TimeLimit.truncated": bool(truncated[index]),
                }
        return self._batch(step.observation), step.reward.ravel(), np.repeat(done, n), infos

    def close(self) -> None:
        """Close the renderer."""
        self._renderer.close()

    def get_images(self) -> Sequence[Array | None]:
        """Return a picture [512, 512, 3] of each world."""
        return [self._renderer.picture(self.world, e) for e in range(self.world.worlds)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute, which all environments share."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all environments."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Raise an error, because the environments are no objects of their own.

        Raises:
            AttributeError: always.
        """
        raise AttributeError(f"SB3VecEnv has no environments with a method {method_name!r}")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return false for every environment: wrap the vector environment itself."""
        return [False for _ in self._get_indices(indices)]

    def _batch(self, observation: Observation) -> dict[str, Array]:
        """Return the arrays of an observation, [E N, ...]."""
        arrays = arrays_in_space(observation)
        return {key: value.reshape(-1, *value.shape[2:]) for key, value in arrays.items()}


def _endings(episodes: Episodes) -> list[dict[str, Any]]:
    """Return how the episodes ended, for each robot of each episode."""
    scores = social_score(episodes)
    return [
        {
            "arrived": bool(episodes.arrived[b, i]),
            "is_success": bool(episodes.success[b]),
            "outcome": Outcome(int(episodes.outcome[b, i])).name,
            "social_score": float(scores[b, i]),
        }
        for b, i in np.ndindex(scores.shape)
    ]
