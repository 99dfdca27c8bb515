"""Training episodes that do not begin at the start, so that what is hard is practised more."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from mrsan import Scenario, Split, World

_FAR_AWAY = 1000.0  # m, where nobody is met
_LEAST_GAP = 1.5  # m between robots that are placed


class Past:
    """The last states of E worlds, to go back to from before a collision.

    Collisions are rare and what would have avoided them is rarely tried. The same situation again,
    with the same people doing the same, tries something else.
    """

    def __init__(self, steps: int) -> None:
        """Keep the last `steps` states."""
        self.kept: deque[list[NDArray[Any]]] = deque(maxlen=steps)

    def keep(self, arrays: list[NDArray[Any]]) -> None:
        """Copy what makes up the present state; each array [E, ...]."""
        self.kept.append([array.copy() for array in arrays])

    def restore(self, arrays: list[NDArray[Any]], worlds: NDArray[np.bool_], age: Any) -> None:
        """Take some worlds back.

        Args:
            arrays: those that were kept; written.
            worlds: [E] which.
            age: [E] by how many of the kept states, at least 1: the last.
        """
        for e in np.flatnonzero(worlds):
            for array, past in zip(arrays, self.kept[-int(age[e])], strict=True):
                array[e] = past[e]


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
        self.world.state.robot_position[worlds] = _FAR_AWAY

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
        state.robot_position[chosen] = place[chosen]
        state.robot_heading[chosen] = ((heading + np.pi) % (2 * np.pi) - np.pi)[chosen]
        state.robot_velocity[chosen] = scenario.robot_speed * ahead[chosen]
        steps = (done * way).mean(1) * radius / (scenario.robot_speed * scenario.time_step)
        state.clock[chosen] = steps[chosen]
        for name in ("present", "position", "velocity", "goal", "radius", "speed"):
            getattr(state, f"human_{name}")[chosen] = getattr(crowd, f"human_{name}")[chosen]
