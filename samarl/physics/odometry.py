"""Where robots believe to be: their odometry drifts while they drive."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.features import GOAL, HEADING_COS, HEADING_SIN, ORIGIN
from mrsan.se2 import rotate, rotate_vectors, unrotate_vectors

_STREAM = 0x0D0  # distinguishes these random numbers from others of the same case


class Odometry:
    """The estimated poses of N robots.

    Each robot overestimates distances by a share, and its heading drifts by an angle per metre;
    both are drawn once per case from a normal distribution.
    """

    def __init__(self, drift: float, case: int, position: NDArray[np.float64]) -> None:
        """Start with the true poses.

        Args:
            drift: standard deviation of the share, and of the angle in rad per metre.
            case: number of the case, which determines the errors.
            position: [N, 2] of the robots, m.
        """
        random = np.random.default_rng([_STREAM, case])
        self._scale, self._turn_per_metre = drift * random.standard_normal((2, len(position)))
        self._position, self.position = position.copy(), position.copy()  # true, estimated
        self.heading_error = np.zeros(len(position))  # estimated minus true, rad

    def update(self, position: NDArray[np.float64]) -> None:
        """Move the estimates by what the robots have driven to reach `position` [N, 2]."""
        moved = position - self._position
        x, y = rotate(
            np.cos(self.heading_error), np.sin(self.heading_error), moved[:, 0], moved[:, 1]
        )
        self.position += (1.0 + self._scale[:, None]) * np.stack([x, y], axis=-1)
        self.heading_error += self._turn_per_metre * np.linalg.norm(moved, axis=1)
        self._position = position.copy()

    def disturb(self, observation: Observation) -> None:
        """Change what the robots of the only world know of their poses, in place.

        The goal and the next corner are places on the map, so their positions relative to the robot
        are those that follow from the estimated pose. What it perceives does not change.
        """
        ego = observation.ego[0]
        true = ego[:, HEADING_COS : HEADING_SIN + 1].astype(np.float64)
        error = np.stack([np.cos(self.heading_error), np.sin(self.heading_error)], axis=-1)
        estimate = rotate_vectors(true, error)
        offset = self.position - self._position
        places = [ego[:, GOAL], ego[:, ORIGIN]]
        if "route" in observation.sensors:
            places.append(observation.sensors["route"][0])
        for place in places:
            in_world = rotate_vectors(place.astype(np.float64), true)
            place[:] = unrotate_vectors(in_world - offset, estimate)
        ego[:, HEADING_COS : HEADING_SIN + 1] = estimate
