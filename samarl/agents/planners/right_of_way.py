"""Planner among walls that knows who goes first through doors and corridors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.features import GOAL, HEADING, ORIGIN
from mrsan.fields import required
from mrsan.kernels.routes import CORNER_ROWS
from mrsan.kernels.walls import PLACE_COLUMNS, WALL_ROWS
from mrsan.observation import KnownMap
from mrsan.parameters import kernel_parameters
from mrsan.passages import Passages, find_passages
from mrsan.se2 import rotate_vectors
from mrsan.sensors.team import MESSAGE_FEATURES
from samarl.agents.agent import Agent
from samarl.planning.passage_driving import act
from samarl.planning.right_of_way import Memory, Mouths, Settings
from samarl.policies.explanation import Explanation
from samarl.registry import needed


@dataclass
class RightOfWay(Agent):
    """Follows routes by rollouts, passes doors in one direction at a time, and queues beside them.

    The rule is that of `samarl.planning.right_of_way`. Robots know the map
    (`Scenario.map_known`) and what team-mates tell (`Scenario.team_messages`).
    """

    central: bool = needed(
        help="privileged: robots know goals and plans of all team-mates, wherever they are"
    )
    widest: float = required(
        0.0, 10.0, unit="m", help="width from which a passage counts as open floor"
    )
    people_weight: float = required(0.0, 1e3, help="cost per metre too close to a person")
    people_weight_inside: float = required(
        0.0, 1e3, help="the same on the way through a passage, and of robots that are stuck"
    )
    robots_weight: float = required(0.0, 1e3, help="cost per metre too close to a team-mate")
    gap: float = required(
        0.0, 2.0, unit="m", help="surface distance to people that the next step keeps if possible"
    )
    stuck_gap: float = required(0.0, 2.0, unit="m", help="the same of robots that are stuck")

    def __post_init__(self) -> None:
        """Start without memory.

        Raises:
            ConfigurationError: a number is out of range.
        """
        super().__post_init__()
        self._passages: list[Passages | None] = []  # of each world
        self._is_init = np.zeros(0, np.bool_)

    def scope_warning(self) -> str | None:
        """Return whether robots do not hear of each other."""
        if self.central or self.scenario.team_messages or self.scenario.robots == 1:
            return None
        return "it is made for scenario.team_messages=true; here robots do not tell who goes first"

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Clear the memory of the worlds [E] in which an episode begins."""
        if len(self._is_init) != len(worlds):
            self._is_init = np.ones(len(worlds), np.bool_)
            self._passages = [None] * len(worlds)
            self._memory = _empty_memory(len(worlds), self.scenario.robots)
        self._is_init |= worlds

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the first actions of the cheapest rollouts."""
        e, n = observation.ego.shape[:2]
        if len(self._is_init) != e:
            self.reset(np.ones(e, np.bool_))
        known_map = observation.map or _open_floor(e)
        if self._is_init.any():
            self._begin(known_map)
        if "messages" in observation.entities:
            messages, received = observation.entities["messages"]
            priority = observation.sensors["priority"]
        else:
            messages = np.zeros((e, n, n - 1, len(MESSAGE_FEATURES)), np.float32)
            received, priority = np.zeros((e, n, n - 1), np.bool_), np.zeros((e, n, 1), np.float32)
        ego = observation.ego
        self._goal = rotate_vectors(ego[..., GOAL] - ego[..., ORIGIN], ego[..., HEADING])
        action = np.zeros((e, n, self.scenario.action_size), np.float32)
        settings = Settings(
            self.central,
            self.people_weight,
            self.people_weight_inside,
            self.robots_weight,
            self.gap,
            self.stuck_gap,
        )
        act(
            e,
            *observation.agents,
            messages,
            received,
            priority,
            *known_map,
            self._mouths,
            self._memory,
            settings,
            kernel_parameters(self.scenario),
            action,
        )
        return action

    def macro_actions(self) -> NDArray[np.int32]:
        """Return what robots tell: what they do, and at which mouth they enter their passage."""
        numbers: NDArray[np.int32] = self._memory.macro_action
        return numbers

    def explain(self) -> Explanation:
        """Return what each robot does, and the queue place or goal that it drives to."""
        memory = self._memory
        waypoint = np.where(memory.queued[..., None] >= 0, memory.place, self._goal)
        return Explanation(waypoint=waypoint, activity=memory.mode.astype(np.int8))

    def _begin(self, known_map: KnownMap) -> None:
        """Find the passages of the worlds in which an episode begins."""
        for e in np.flatnonzero(self._is_init):
            walls, place = known_map.walls[e], known_map.place[e]
            self._passages[e] = find_passages(walls, place, self.widest)
            memory = self._memory
            memory.is_new[e], memory.queued[e], memory.stuck[e] = True, -1, 0
            memory.known[e], memory.macro_action[e] = False, 0
        self._is_init[:] = False
        self._mouths = _mouths_of([passages for passages in self._passages if passages is not None])


def _empty_memory(e: int, n: int) -> Memory:
    """Return the memory of E worlds of N robots before their episodes begin."""
    integers, booleans = np.zeros((e, n), np.int64), np.zeros((e, n), np.bool_)
    return Memory(
        is_new=booleans | True,
        mode=integers.copy(),
        entry=integers - 1,
        exit=integers - 1,
        inside=booleans.copy(),
        ahead=integers.copy(),
        queued=integers - 1,
        place=np.zeros((e, n, 2)),
        stuck=integers.copy(),
        macro_action=np.zeros((e, n), np.int32),
        known=np.zeros((e, n, n), np.bool_),
        belief=np.zeros((e, n, n, len(MESSAGE_FEATURES))),
    )


def _mouths_of(worlds: list[Passages]) -> Mouths:
    """Return the mouths of all worlds."""
    places = [points for passages in worlds for points in passages.places]
    return Mouths(
        first=np.cumsum([0, *(len(passages.mouth) for passages in worlds)]),
        position=np.concatenate([passages.mouth for passages in worlds]),
        outward=np.concatenate([passages.outward for passages in worlds]),
        width=np.concatenate([passages.width for passages in worlds]),
        passage=np.concatenate([passages.passage for passages in worlds]),
        length=np.concatenate([passages.length[passages.passage] for passages in worlds]),
        first_place=np.cumsum([0, *map(len, places)]),
        places=np.concatenate([np.zeros((0, 2)), *places]),
    )


def _open_floor(e: int) -> KnownMap:
    """Return the map of worlds without walls."""
    return KnownMap(
        np.zeros((e, PLACE_COLUMNS), np.float32),
        np.zeros((e, WALL_ROWS, 0), np.float32),
        np.zeros((e, CORNER_ROWS, 0), np.float32),
        np.zeros((e, 0, 0), np.float32),
    )
