"""The next doors and corridors on the routes of robots (`Scenario.next_passages`)."""

from __future__ import annotations

import numpy as np

from mrsan.kernels.passages import Mouths, observe_passages
from mrsan.kernels.structs import by_reference
from mrsan.observation import Observation
from mrsan.passages import Passages, find_passages, open_width
from mrsan.scenario import Scenario
from mrsan.sensors.team import MESSAGE_FEATURES
from mrsan.state import Bools, State

PASSAGE_FEATURES = (
    "mouth_x",  # in the body frame, where the route enters the passage, or leaves it, m
    "mouth_y",
    "axis_x",  # the direction in which the robot passes the mouth, in the body frame
    "axis_y",
    "distance",  # along the route to the mouth, m
    "length",  # of the passage, m; 0: a door
    "width",  # of the mouth, m
    "inside",  # 1: the robot is inside, and the mouth is where it leaves
    "occupants",  # people and robots inside, seen or told
    "flow",  # their mean speed in the robot's direction, m/s; negative: towards it
    "people",  # whom the robot sees inside or at most 2.5 m away from the passage
)


class NextPassages:
    """The next passages on the route of each robot, nearest first, and who is in them.

    Robots know the map. Whoever is inside counts if the robot perceives it or receives its message.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Create the sensor of a scenario."""
        self.slots, self.features = scenario.next_passages, len(PASSAGE_FEATURES)
        self._widest = open_width(scenario.robot_radius)
        self._keys = np.zeros(0, np.uint64)  # [E] of the episodes whose passages these are
        self._passages: list[Passages] = []  # of each world

    def observe(self, state: State, worlds: Bools, observation: Observation) -> None:
        """Write the passages ahead of the robots of some worlds [E], from what they perceive."""
        self._update(state, worlds)
        e, n = observation.ego.shape[:2]
        nothing = np.zeros((e, n, 0, len(MESSAGE_FEATURES)), np.float32), np.zeros((e, n, 0), bool)
        observe_passages(
            e,
            worlds,
            state,
            self._mouths,
            *observation.entities["humans"],
            *observation.entities["robots"],
            *observation.entities.get("messages", nothing),
            *observation.entities["passages"],
        )

    def _update(self, state: State, worlds: Bools) -> None:
        """Find the passages of the worlds in which another episode has begun."""
        if len(self._passages) != len(worlds):
            self._keys = np.zeros(len(worlds), np.uint64)
            nowhere = find_passages(np.zeros((0, 0), np.float32), np.zeros(0, np.float32), 0.0)
            self._passages = [nowhere] * len(worlds)
        elif (self._keys == state.key)[worlds].all():
            return
        for e in np.flatnonzero(worlds & (self._keys != state.key)):
            self._passages[e] = find_passages(state.walls[e], state.place[e], self._widest)
            self._keys[e] = state.key[e]
        self._mouths = by_reference(mouths_of(self._passages))


def mouths_of(worlds: list[Passages]) -> Mouths:
    """Return the passages of all worlds in the form that kernels take."""
    return Mouths(
        first=np.cumsum([0, *(len(world.mouth) for world in worlds)]),
        position=np.concatenate([world.mouth for world in worlds]),
        outward=np.concatenate([world.outward for world in worlds]),
        width=np.concatenate([world.width for world in worlds]),
        passage=np.concatenate([world.passage for world in worlds]),
        length=np.concatenate([world.length[world.passage] for world in worlds]),
        first_way=np.cumsum([0, *(len(world.way) for world in worlds)]),
        way=np.concatenate([world.way for world in worlds]),
        way_passage=np.concatenate([world.way_passage for world in worlds]),
    )
