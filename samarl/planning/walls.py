"""The walls that a robot sees, in the form that planners take."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.kernels import function
from mrsan.kernels.walls import START_X, START_Y, close_polygon


def seen_walls(tracks: Observation) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the walls in view, [E, N, K, 4] and [E, N, K]; K is 0 without walls."""
    if "walls" in tracks.entities:
        features, mask = tracks.entities["walls"]
        return features, mask
    shape = (*tracks.ego.shape[:2], 0)
    return np.zeros((*shape, 4), np.float32), np.zeros(shape, np.bool_)


@function
def gather_walls(segments, mask, walls):
    """Write the segments in view as walls, see `mrsan.kernels.walls`; return their number.

    What lies behind a segment is not seen, so each is a thin wall of its own. Only its front is
    written.
    """
    count = 0
    for k in range(mask.shape[0]):
        if mask[k]:
            walls[START_X, count], walls[START_Y, count] = segments[k, 0], segments[k, 1]
            walls[START_X, count + 1], walls[START_Y, count + 1] = segments[k, 2], segments[k, 3]
            close_polygon(walls, count, count + 2)
            count += 1  # the back is overwritten
    return count
