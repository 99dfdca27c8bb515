"""Training episodes that start midway, so that difficult situations occur more often."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mrsan import Scenario, Split, State, World

_PLACE = ("place", "walls", "zones", "corners", "corner_distance")  # fixed during an episode
_FAR_AWAY = 1000.0  # m; the robot of a crowd's world is placed so far away that it meets nobody
_MIN_GAP = 1.5  # m between robots that are placed on the circle


class SnapshotBuffer:
    """Recent states of E worlds, to restart from shortly before a collision.

    Collisions are rare, and actions that would have avoided them are rarely tried. Replaying the
    same situation, in which people move as before, explores alternatives.
    """

    def __init__(self, steps: int) -> None:
        """Create a buffer for the last `steps` states."""
        self.steps = steps
        self.snapshots: deque[tuple[dict[str, NDArray], list[Tensor]]] = deque(maxlen=steps)

    def append(self, world: World, memory: list[Tensor]) -> None:
        """Copy the state of the worlds, and the memory of the policy, [E, ...] each."""
        arrays = world.state._asdict().items()
        state = {name: array.copy() for name, array in arrays if name not in _PLACE}
        self.snapshots.append((state, [tensor.clone() for tensor in memory]))

    def restore(self, world: World, memory: list[Tensor], back: NDArray[np.integer]) -> None:
        """Restore some worlds to earlier states of the same episode.

        Args:
            world: its state is written.
            memory: in the order passed to `append`; written.
            back: [E] how many states to go back, 1: to the last one; 0: leave the world alone.
        """
        for steps in np.unique(back[back > 0]):
            worlds = back == steps
            state, earlier_memory = self.snapshots[-int(steps)]
            world.restore(world.state._replace(**state), worlds)
            rows = torch.from_numpy(worlds)
            for tensor, earlier_tensor in zip(memory, earlier_memory, strict=True):
                tensor[rows] = earlier_tensor[rows]


class WarmStartCrowd:
    """E crowds that walk without robots, into which training episodes can start.

    Nine tenths of a route around a crowd are empty; entering the crowd at the goal is the hard
    part. Robots that start close to it practise it more often.
    """

    def __init__(self, scenario: Scenario, worlds: int, first: int) -> None:
        """Start crowds as in `scenario`, in the training cases from `first` on."""
        endless = replace(scenario, robots=1, time_limit=10000.0, arena_radius=None)
        self.world = World(endless, worlds)
        self.world.reset([Split.training.case(first + e) for e in range(worlds)])
        self._remove_robot(np.ones(worlds, np.bool_))

    def step(self) -> None:
        """Advance all crowds by one step."""
        state = self.world.state
        self.world.step(np.zeros((self.world.worlds, 1, self.world.scenario.action_size)))
        if state.truncated.any():
            self.world.reset(worlds=state.truncated.copy())
            self._remove_robot(state.clock == 0)

    def _remove_robot(self, worlds: NDArray[np.bool_]) -> None:
        self._overwrite(self.world, worlds, robot_position=np.float32(_FAR_AWAY))

    @staticmethod
    def _overwrite(world: World, worlds: NDArray[np.bool_], **arrays: Any) -> None:
        """Overwrite arrays in the state of some worlds."""
        state = world.snapshot()
        for name, value in arrays.items():
            getattr(state, name)[worlds] = value
        world.restore(state, worlds)

    def enter(self, world: World, worlds: NDArray[np.bool_], radius: float) -> None:
        """Copy the people into `worlds` [E] and place its robots on their route around the crowd.

        Robots are placed at random on the circle of `radius`, counter-clockwise between start and
        goal, at full speed. Worlds in which two robots would be too close are left unchanged.
        """
        state, crowd, scenario = world.state, self.world.state, world.scenario
        start, goal = (
            np.arctan2(position[..., 1], position[..., 0])
            for position in (state.robot_start, state.robot_goal)
        )
        arc = (goal - start) % (2 * np.pi)
        share = torch.rand(start.shape).numpy()  # of the route that lies behind the robot
        bearing = start + share * arc
        position = radius * np.stack([np.cos(bearing), np.sin(bearing)], -1)
        gap = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
        gap[:, np.arange(scenario.robots), np.arange(scenario.robots)] = np.inf
        entered = worlds & (gap > _MIN_GAP).all((1, 2))
        heading = bearing + np.pi / 2
        direction = np.stack([np.cos(heading), np.sin(heading)], -1)
        steps = (share * arc).mean(1) * radius / (scenario.robot_speed * scenario.time_step)
        people = {
            name: getattr(crowd, name)[entered]
            for name in State._fields
            if name.startswith("human_")
        }
        self._overwrite(
            world,
            entered,
            robot_position=position[entered],
            robot_heading=((heading + np.pi) % (2 * np.pi) - np.pi)[entered],
            robot_velocity=scenario.robot_speed * direction[entered],
            clock=steps[entered],
            **people,
        )
