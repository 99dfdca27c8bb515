"""Assign detections to the slots of a policy's memory, so that everybody keeps a slot."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

from samarl.runtime.inputs import Detection

# A person at 2 m/s who turns round is at most this far from the expected position after 0.4 s, m.
GATE = 0.8


class Slots:
    """A number of slots; whoever was seen in one keeps it until somebody else needs it.

    Agents with an id are recognised by it, however much later. Those without are matched with the
    agent whose position, extrapolated at constant velocity, is nearest, the nearest pairs first and
    within `GATE`.
    """

    def __init__(self, number: int, longest_absence: float) -> None:
        """Start with empty slots.

        Agents without an id are no longer matched after `longest_absence` seconds.
        """
        self.number, self.longest_absence = number, longest_absence
        self._last: dict[int, tuple[float, Detection]] = {}  # time and last detection of each slot

    def assign(
        self, detections: Sequence[Detection], x: float, y: float, time: float
    ) -> tuple[list[tuple[int, Detection]], list[int]]:
        """Assign a slot to every detection; of too many, to those nearest to the robot at (x, y).

        Distances are those of surfaces, since a large agent is nearer than its centre.

        Returns:
            Slots with their detections, and which of these slots held somebody else before.
        """
        if len(detections) > self.number:
            by_distance = sorted(detections, key=lambda d: math.hypot(d.x - x, d.y - y) - d.radius)
            detections = by_distance[: self.number]
        slot_of = self._recognise(detections, time)
        occupied, reassigned = set(slot_of.values()), []
        for k in range(len(detections)):
            if k not in slot_of:
                slot_of[k] = self._free_slot(occupied)
                occupied.add(slot_of[k])
                reassigned.append(slot_of[k])
        assigned = [(slot_of[k], detection) for k, detection in enumerate(detections)]
        self._last.update((slot, (time, detection)) for slot, detection in assigned)
        return assigned, reassigned

    def _recognise(self, detections: Sequence[Detection], time: float) -> dict[int, int]:
        """Return the slots of agents that were seen before, by their index in `detections`."""
        slot_by_id: dict[Hashable, int] = {}
        expected_positions = []  # of agents without an id
        for slot, (last_time, last) in self._last.items():
            if last.id is not None:
                slot_by_id[last.id] = slot
            elif (absence := time - last_time) <= self.longest_absence:
                expected_x = last.x + absence * last.velocity_x
                expected_y = last.y + absence * last.velocity_y
                expected_positions.append((slot, expected_x, expected_y))
        slot_of: dict[int, int] = {}
        pairs = []
        for k, detection in enumerate(detections):
            if detection.id is None:
                pairs += [
                    (math.hypot(detection.x - x, detection.y - y), k, slot)
                    for slot, x, y in expected_positions
                ]
            elif detection.id in slot_by_id:
                slot_of[k] = slot_by_id[detection.id]
        matched = set()
        for distance, k, slot in sorted(pairs):
            if distance <= GATE and k not in slot_of and slot not in matched:
                slot_of[k] = slot
                matched.add(slot)
        return slot_of

    def _free_slot(self, occupied: set[int]) -> int:
        """Return an empty slot, or the one whose agent was not seen for the longest time."""
        free = [slot for slot in range(self.number) if slot not in occupied]
        return min(free, key=lambda slot: self._last[slot][0] if slot in self._last else -math.inf)
