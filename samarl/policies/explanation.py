"""What an agent can tell of its reasons."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Explanation(NamedTuple):
    """What an agent had in mind when it last acted; None: it has no such thing."""

    waypoint: NDArray[np.float32] | None  # [E, N, 2] where each robot is driving to, world frame, m
    humans: NDArray[np.float32] | None  # [E, N, M] shares of its attention
    robots: NDArray[np.float32] | None  # [E, N, N - 1]
