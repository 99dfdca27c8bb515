"""Case numbers: what is trained on, selected on and reported on never overlaps.

A case number fixes everything random in an episode. Any seed below 2^40 is a training case, so
seeding an environment with 0 or 42 never plays a test case.
"""

from __future__ import annotations

from enum import Enum

CASES_PER_SPLIT = 2**40


class Split(Enum):
    """The disjoint ranges of case numbers."""

    training = 0
    validation = 1
    test = 2

    def case(self, index: int) -> int:
        """The number of the `index`-th case of this split."""
        if not 0 <= index < CASES_PER_SPLIT:
            raise ValueError(f"case index is {index}; it must lie in [0, 2^40)")
        return self.value * CASES_PER_SPLIT + index

    @classmethod
    def of(cls, number: int) -> tuple[Split, int]:
        """The split in which a case number lies, and its place there; the inverse of `case`."""
        value, index = divmod(number, CASES_PER_SPLIT)
        return cls(value), index
