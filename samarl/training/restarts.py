"""Training episodes that do not begin at the start, so that what is hard is practised more."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mrsan import Scenario, Split, State, World

_FAR_AWAY = 1000.0  # m, where nobody is met
_LEAST_GAP = 1.5  # m between robots that are placed


class SnapshotBuffer:
    """The last moments of E worlds, to go back to from before a collision.

    Collisions are rare and what would have avoided them is rarely tried. The same situation again,
    with the same people doing the same, tries something else.
    """

    def __init__(self, steps: int) -> None:
        """Keep the last `steps` moments."""
        self.steps = steps
        self.kept: deque[tuple[State, list[Tensor]]] = deque(maxlen=steps)

    def keep(self, world: World, memory: list[Tensor]) -> None:
        """Copy the state of the worlds and what else makes up the present, [E, ...] each."""
        self.kept.append((world.snapshot(), [tensor.clone() for tensor in memory]))

    def restore(self, world: World, memory: list[Tensor], back: NDArray[np.integer]) -> None:
        """Take worlds back.

        Args:
            world: its state is written.
            memory: as it was given to `keep`; written.
            back: [E] by how many of the kept moments, 1: the last; 0: not at all.
        """
        for steps in np.unique(back[back > 0]):
            worlds = back == steps
            snapshot, remembered = self.kept[-int(steps)]
            world.restore(snapshot, worlds)
            for tensor, past in zip(memory, remembered, strict=True):
                tensor[torch.from_numpy(worlds)] = past[torch.from_numpy(worlds)]


class Crowd:
    """E crowds that go on walking for ever, without robots.

    Nine tenths of the way round a crowd are empty; what is hard is going in to the goal.
    """

    def __init__(self, scenario: Scenario, worlds: int, first: int) -> None:
        """Let people walk as in `scenario`, in the training cases from `first` on."""
        endless = replace(scenario, robots=1, time_limit=10000.0, arena_radius=None)
        self.world = World(endless, worlds)
        self.world.reset([Split.training.case(first + e) for e in range(worlds)])
        self._send_away(np.ones(worlds, np.bool_))

    def step(self) -> None:
        """Walk for one step."""
        state = self.world.state
        self.world.step(np.zeros((self.world.worlds, 1, self.world.scenario.action_size)))
        if state.truncated.any():
            self.world.reset(worlds=state.truncated.copy())
            self._send_away(state.clock == 0)

    def _send_away(self, worlds: NDArray[np.bool_]) -> None:
        self._change(self.world, worlds, robot_position=np.float32(_FAR_AWAY))

    @staticmethod
    def _change(world: World, worlds: NDArray[np.bool_], **arrays: Any) -> None:
        """Put other values into the state of some worlds."""
        now = world.snapshot()
        for name, value in arrays.items():
            getattr(now, name)[worlds] = value
        world.restore(now, worlds)

    def enter(self, world: World, worlds: NDArray[np.bool_], radius: float) -> None:
        """Put these people into `worlds` [E], and its robots on their way round, at full speed.

        Robots are put on the circle of `radius` between start and goal, counter-clockwise; where
        two would be too near to each other, the world stays as it is.
        """
        state, crowd, scenario = world.state, self.world.state, world.scenario
        start, goal = (
            np.arctan2(place[..., 1], place[..., 0])
            for place in (state.robot_start, state.robot_goal)
        )
        way = (goal - start) % (2 * np.pi)
        done = torch.rand(start.shape).numpy()
        bearing = start + done * way
        place = radius * np.stack([np.cos(bearing), np.sin(bearing)], -1)
        gap = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
        gap[:, np.arange(scenario.robots), np.arange(scenario.robots)] = np.inf
        chosen = worlds & (gap > _LEAST_GAP).all((1, 2))
        heading = bearing + np.pi / 2
        ahead = np.stack([np.cos(heading), np.sin(heading)], -1)
        steps = (done * way).mean(1) * radius / (scenario.robot_speed * scenario.time_step)
        people = {
            name: getattr(crowd, name)[chosen]
            for name in State._fields
            if name.startswith("human_")
        }
        self._change(
            world,
            chosen,
            robot_position=place[chosen],
            robot_heading=((heading + np.pi) % (2 * np.pi) - np.pi)[chosen],
            robot_velocity=scenario.robot_speed * ahead[chosen],
            clock=steps[chosen],
            **people,
        )
