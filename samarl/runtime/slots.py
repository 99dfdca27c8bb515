"""Who is who: the place of everybody in the memory of a policy, from step to step."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

from samarl.runtime.inputs import Detection

GATE = 0.8  # m; in 0.4 s somebody at 2 m/s who turns round is so far from where one expects them


class Slots:
    """A number of places; who was seen in one of them keeps it until somebody else needs it.

    Those with an id are known by it again, however late. Those without are matched with whom
    constant velocity leads nearest to them, the nearest pairs first, within `GATE`.
    """

    def __init__(self, number: int, keep: float) -> None:
        """Nobody is known; `keep` is for how long those without an id are looked for, s."""
        self.number, self.keep = number, keep
        self._last: dict[int, tuple[float, Detection]] = {}  # when and how each was last seen

    def assign(
        self, seen: Sequence[Detection], x: float, y: float, time: float
    ) -> tuple[list[tuple[int, Detection]], list[int]]:
        """The place of everybody who is seen; of too many the nearest to the robot at (x, y).

        Returns:
            Places and who is there, and which of these places were somebody else's before.
        """
        if len(seen) > self.number:
            seen = sorted(seen, key=lambda d: math.hypot(d.x - x, d.y - y))[: self.number]
        places = self._recognised(seen, time)
        taken, new = set(places.values()), []
        for k in range(len(seen)):
            if k not in places:
                places[k] = self._free(taken)
                taken.add(places[k])
                new.append(places[k])
        found = [(places[k], somebody) for k, somebody in enumerate(seen)]
        self._last.update((slot, (time, somebody)) for slot, somebody in found)
        return found, new

    def _recognised(self, seen: Sequence[Detection], time: float) -> dict[int, int]:
        """The places of those who were seen before, by their number in `seen`."""
        named: dict[Hashable, int] = {}
        expected = []  # of those without an id
        for slot, (when, last) in self._last.items():
            if last.id is not None:
                named[last.id] = slot
            elif (gone := time - when) <= self.keep:
                there = last.x + gone * last.velocity_x, last.y + gone * last.velocity_y
                expected.append((slot, *there))
        places: dict[int, int] = {}
        pairs = []
        for k, somebody in enumerate(seen):
            if somebody.id is None:
                pairs += [
                    (math.hypot(somebody.x - x, somebody.y - y), k, slot) for slot, x, y in expected
                ]
            elif somebody.id in named:
                places[k] = named[somebody.id]
        taken = set()
        for distance, k, slot in sorted(pairs):
            if distance <= GATE and k not in places and slot not in taken:
                places[k] = slot
                taken.add(slot)
        return places

    def _free(self, taken: set[int]) -> int:
        """A place that is nobody's, or that of who was not seen for the longest time."""
        rest = [slot for slot in range(self.number) if slot not in taken]
        return min(rest, key=lambda slot: self._last[slot][0] if slot in self._last else -math.inf)
