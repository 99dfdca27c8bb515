"""Explanations of an agent's decisions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

ACTIVITIES = ("drives", "waits", "goes", "holds off")  # what `Explanation.activity` numbers


class Explanation(NamedTuple):
    """Reasons for the last action of an agent; fields that it does not have are None."""

    # [E, N, 2] where each robot drives to: a waypoint, a queue place or its goal, world frame, m
    waypoint: NDArray[np.float32] | None = None
    humans: NDArray[np.float32] | None = None  # [E, N, M] attention weights of the people
    robots: NDArray[np.float32] | None = None  # [E, N, N - 1] and of the other robots
    shielded: NDArray[np.bool_] | None = None  # [E, N] the safety shield replaced the action
    # [E, N] index in ACTIVITIES of the macro action: it waits for its turn at a passage, passes it,
    # or holds off its goal
    activity: NDArray[np.int8] | None = None
    value: NDArray[np.float32] | None = None  # [E, N] discounted reward expected from here on
    proposed: NDArray[np.float32] | None = None  # [E, N, A] action that the shield checked
    tracks: NDArray[np.float32] | None = None  # [E, N, M, 6] people known, `TRACK_FEATURES`
