"""The worlds as a batched TorchRL environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from mrsan.observation import Observation
from mrsan.reward import RewardParts
from mrsan.scenario import Scenario
from mrsan.sensors.suite import SensorSuite
from mrsan.tasks import overridden
from mrsan.world import World


class TorchRLEnv(EnvBase):
    """E worlds of N robots with batch size [E]; keys of robots are nested under `agents`.

    - `("agents", "observation", *)`: `ego` [E, N, 11], `humans` [E, N, M, 5], `robots`
      [E, N, N - 1, 5] and the masks `humans_visible` and `robots_visible`; with team perception
      also `humans_reported` and `robots_reported`; and the sensors of `Scenario.sensors`.
    - `("agents", "active_mask")` [E, N, 1]: False once a robot has parked.
    - `("agents", "action")` [E, N, A].
    - `("agents", "reward")` [E, N, 1].
    - `("agents", "reward_parts", *)` [E, N, 1]: the terms of the reward, named as in
      `mrsan.RewardParts`; zero after a reset. They belong to the observation spec, because TorchRL
      would treat them as further rewards.
    - `success` [E, 1]: all robots have arrived and none has collided.
    - `terminated` (all robots have arrived, or a collision ended the episode), `truncated` (the
      time limit was reached) and `done` [E, 1].

    `reset(TensorDict({"case": numbers}, [E]))` begins these cases; without it, each world begins
    the next episode of its case. Partial resets use `_reset`.

    Examples:
        >>> env = TorchRLEnv(Scenario(), worlds=64)
        >>> env.rollout(10, break_when_any_done=False)["agents", "observation", "ego"].shape
        torch.Size([64, 10, 3, 11])
    """

    def __init__(
        self,
        scenario: Scenario | str | None = None,
        worlds: int = 1,
        device: torch.device | str = "cpu",
        seed: int | None = None,
        **overrides: Any,
    ) -> None:
        """Create the worlds.

        Args:
            scenario: the task, or its id, such as `mrsan/Doorway-v0`. None: SAMARL's.
            worlds: their number E.
            device: device of the tensors; the simulation runs on the CPU.
            seed: world `e` plays case `seed + e`. None: drawn at random.
            **overrides: fields of the scenario, such as `humans=5`.
        """
        super().__init__(device=device, batch_size=torch.Size([worlds]))
        self.scenario = overridden(scenario, overrides)
        self.world = World(self.scenario, worlds)
        self.group_map = {"agents": [f"robot_{i}" for i in range(self.scenario.robots)]}
        self._make_specs()
        self._set_seed(int(np.random.default_rng().integers(2**31)) if seed is None else seed)

    def _make_specs(self) -> None:
        e, n = self.world.worlds, self.scenario.robots

        def floats(*shape: int) -> Unbounded:
            return Unbounded(shape=(e, n, *shape), dtype=torch.float32, device=self.device)

        def flags(*shape: int) -> Binary:
            return Binary(shape=(e, *shape), dtype=torch.bool, device=self.device)

        observation = Composite(shape=(e, n))
        for key, array in SensorSuite(self.scenario).empty(1).arrays().items():
            shape = array.shape[2:]
            observation.set(key, flags(n, *shape) if array.dtype == np.bool_ else floats(*shape))
        parts = Composite({name: floats(1) for name in RewardParts._fields}, shape=(e, n))
        agents = Composite(
            observation=observation, active_mask=flags(n, 1), reward_parts=parts, shape=(e, n)
        )
        self.observation_spec = Composite(agents=agents, success=flags(1), shape=(e,))
        action = Bounded(
            -1.0, 1.0, (e, n, self.scenario.action_size), dtype=torch.float32, device=self.device
        )
        self.action_spec = Composite(agents=Composite(action=action, shape=(e, n)), shape=(e,))
        self.reward_spec = Composite(agents=Composite(reward=floats(1), shape=(e, n)), shape=(e,))
        self.done_spec = Composite(
            done=flags(1), terminated=flags(1), truncated=flags(1), shape=(e,)
        )

    def _set_seed(self, seed: int | None) -> None:
        if seed is None:
            return
        self.world.state.case[:] = seed + np.arange(self.world.worlds)
        self.world.state.episode[:] = -1  # the next reset begins episode 0

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDict:
        mask = np.ones(self.world.worlds, np.bool_)
        cases = None
        if tensordict is not None:
            if (reset := tensordict.get("_reset", None)) is not None:
                mask = reset.reshape(-1).cpu().numpy()
            if (numbers := tensordict.get("case", None)) is not None:
                cases = numbers.reshape(-1).cpu().numpy()
        observation = self.world.reset(cases=cases, worlds=mask)
        state = self.world.state
        zeros = np.zeros((len(RewardParts._fields), *state.arrived.shape), np.float32)
        return self._tensors(observation, RewardParts(*zeros), state.terminated, state.truncated)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        step = self.world.step(tensordict["agents", "action"].detach().cpu().numpy())
        out = self._tensors(step.observation, step.reward_parts, step.terminated, step.truncated)
        out["agents", "reward"] = torch.from_numpy(step.reward[..., None]).to(self.device)
        return out

    def _tensors(
        self,
        observation: Observation,
        parts: RewardParts,
        terminated: np.ndarray,
        truncated: np.ndarray,
    ) -> TensorDict:
        e, n = self.batch_size[0], self.scenario.robots
        arrived, collision = self.world.state.arrived, self.world.state.collision
        terms = {name: torch.from_numpy(part[..., None]) for name, part in parts._asdict().items()}
        features = {key: torch.from_numpy(array) for key, array in observation.arrays().items()}
        out = TensorDict(
            {
                "agents": TensorDict(
                    {
                        "observation": TensorDict(features, [e, n]),
                        "reward_parts": TensorDict(terms, [e, n]),
                        "active_mask": torch.from_numpy(~arrived[..., None]),
                    },
                    [e, n],
                ),
                "success": torch.from_numpy((arrived & (collision == 0)).all(1, keepdims=True)),
                "terminated": torch.tensor(terminated[:, None]),
                "truncated": torch.tensor(truncated[:, None]),
                "done": torch.from_numpy((terminated | truncated)[:, None]),
            },
            [e],
        )
        return out.to(self.device)
