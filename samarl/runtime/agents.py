"""People and team-mates around a robot: from detections to tracks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrsan import OTHER_FEATURES, Entities, Observation
from mrsan.se2 import unrotate
from samarl.observations.tracker import Tracker, TrackMemory
from samarl.runtime.inputs import Detection, OwnState
from samarl.runtime.slots import Slots


class AgentTracks:
    """Tracks of a number of people and team-mates, the nearest ones, each in a slot of its own."""

    def __init__(self, humans: int, robots: int, track_time: float, time_step: float) -> None:
        """Start without tracks.

        Args:
            humans: largest number of people.
            robots: largest number of team-mates.
            track_time: time after the last detection for which a track is kept, s.
            time_step: of the policy, s.
        """
        self._tracker = Tracker(track_time, time_step)
        self._memory = TrackMemory(
            *(array[:, :1].copy() for array in self._tracker.initial(1, robots + 1, humans))
        )
        self._slots = {"humans": Slots(humans, track_time), "robots": Slots(robots, track_time)}
        self._is_new = True

    def observe(
        self, own: OwnState, detections: Sequence[Detection], time: float
    ) -> tuple[dict[str, Entities], dict[str, list[int]]]:
        """Return the agents in their slots, [1, 1, ...], and which slots held others before."""
        cos, sin = math.cos(own.heading), math.sin(own.heading)
        entities, reassigned = {}, {}
        for kind, slots in self._slots.items():
            features = np.zeros((1, 1, slots.number, len(OTHER_FEATURES)), np.float32)
            visible: NDArray[np.bool_] = np.zeros((1, 1, slots.number), np.bool_)
            of_kind = [d for d in detections if d.robot == (kind == "robots")]
            assigned, reassigned[kind] = slots.assign(of_kind, own.x, own.y, time)
            for slot, d in assigned:
                features[0, 0, slot] = (
                    *unrotate(cos, sin, d.x - own.x, d.y - own.y),
                    *unrotate(
                        cos, sin, d.velocity_x - own.velocity_x, d.velocity_y - own.velocity_y
                    ),
                    d.radius,
                )
                visible[0, 0, slot] = True
            entities[kind] = Entities(features, visible)
        return entities, reassigned

    def update(self, observation: Observation, elapsed: float) -> Observation:
        """Return what is known after an observation, `elapsed` seconds after the one before."""
        is_init, self._is_new = np.array([self._is_new]), False
        return self._tracker.update(observation, self._memory, is_init, elapsed)
