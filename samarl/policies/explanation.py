"""What an agent can tell of its reasons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Explanation(NamedTuple):
    """What an agent had in mind when it last acted; None: it has no such thing."""

    # [E, N, 2] where each robot is driving to, world frame, m
    waypoint: NDArray[np.float32] | None = None
    humans: NDArray[np.float32] | None = None  # [E, N, M] shares of its attention
    robots: NDArray[np.float32] | None = None  # [E, N, N - 1]
    shielded: NDArray[np.bool_] | None = None  # [E, N] the safety shield replaced its action
