"""Case numbers of disjoint splits for training, model selection and reporting.

A case number determines everything random in an episode. Every seed below 2^40 is a training
case, so an environment seeded with 0 or 42 never plays a test case.
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
        """Return the number of the `index`-th case of this split."""
        if not 0 <= index < CASES_PER_SPLIT:
            raise ValueError(f"case index is {index}; it must lie in [0, 2^40)")
        return self.value * CASES_PER_SPLIT + index

    def number(self, case: int) -> int:
        """Return the number of a case.

        Numbers from 2^40 on are those of cases of any split and are returned as they are.
        """
        return case if CASES_PER_SPLIT <= case < len(Split) * CASES_PER_SPLIT else self.case(case)

    @classmethod
    def of(cls, number: int) -> tuple[Split, int]:
        """Return the split of a case number and its index there; the inverse of `case`."""
        value, index = divmod(number, CASES_PER_SPLIT)
        return cls(value), index
