"""Where no obstacle can stand unseen: what lies between two rays is not known to be free."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mrsan import Scenario
from mrsan.se2 import unit_vectors
from samarl.runtime.inputs import OwnState
from samarl.runtime.scan import SCAN_MARGIN, Scan

_SECTORS = 64  # of the area, each with a radius of its own
_EDGE_OF_VIEW = 1.5  # times the usual angle between neighbouring rays: a wider one is no gap
_DISPLACEMENT = 0.3  # of the robot while it looks round, share of an obstacle's radius
_SHARE_OF_TURN = 0.8  # of the widest gap that may remain: turns are not exact
_SAME_RAY = 1e-3  # rays from the same place closer to each other than this are one, rad
_LOOK_AHEAD = 1.0  # way that the robot can drive after it has looked round, m
_STANDING = 0.05  # a slower robot stands, m/s
_DIRECTIONS = unit_vectors(2.0 * math.pi * (np.arange(_SECTORS) + 0.5) / _SECTORS)


class ClearArea:
    """A star-shaped area in which everything has been seen, and which the robot must not leave.

    Neighbouring rays with an angle of g between them hit every pole of radius r that is nearer than
    r / sin(g / 2), so that nothing is overlooked there, except behind what was hit. The robot must
    be able to stop within that distance. If that is too near to drive at all, it looks round: it
    turns on the spot until its scans together have gaps that are small enough for another metre.
    """

    def __init__(self, scenario: Scenario) -> None:
        """Start with nothing seen."""
        self._scenario = scenario
        self._least = 1.003 * scenario.robot_radius + 0.005  # it may stand anyway, m
        self.margin = 0.0  # that the robot keeps from the edges, m
        self._is_needed = False
        # Where the area was seen from, how far, and its radii, m.
        self._centre: NDArray[np.float64] = np.zeros(2)
        self._sight = -math.inf
        self._radii: NDArray[np.float64] = np.zeros(_SECTORS)
        # The rays of all scans from one place.
        self._place: NDArray[np.float64] = np.full(2, math.inf)
        self._angle: NDArray[np.float64] = np.zeros(0)
        self._distance: NDArray[np.float64] = np.zeros(0)
        self._turn, self._is_looking, self._has_looked = 0.0, False, False

    def update(self, scans: Sequence[Scan], own: OwnState) -> NDArray[np.float64]:
        """Add scans; return the edges [K, 4] of the area, none if they are out of reach, m."""
        for scan in scans:
            if len(scan.angle):
                self._add(scan, own)
        if not self._is_needed:
            return np.zeros((0, 4))
        corners = self._centre + _DIRECTIONS * self._radii[:, None]
        return np.hstack([corners, np.roll(corners, -1, 0)])

    def turn_to_see(self, own: OwnState) -> float:
        """Return by how much a robot at an edge turns to see more, rad.

        It is 0 while the robot brakes, and once it has looked round: then something stands there,
        and the robot will look again, because that may leave.
        """
        if self._has_looked:
            self._place = np.full(2, math.inf)
        is_standing = math.hypot(own.velocity_x, own.velocity_y) < _STANDING
        self._is_looking = is_standing and not self._has_looked
        return self._turn if self._is_looking else 0.0

    def _add(self, scan: Scan, own: OwnState) -> None:
        """Add one scan."""
        radius, gap = scan.smallest_obstacle / 2.0, scan.gap
        self.margin = SCAN_MARGIN + radius
        nearest, smaller = self._least + self.margin, radius * (1.0 - _DISPLACEMENT)
        angle, distance, here = scan.angle, scan.distance, np.array([scan.x, scan.y])
        self._is_needed = _sight(radius, gap) < nearest + self._stopping_distance(own)
        if self._is_needed:
            if math.dist(here, self._place) <= _DISPLACEMENT * radius:
                radius = smaller
                angle, distance = np.append(angle, self._angle), np.append(distance, self._distance)
                _, first = np.unique(np.round(angle / _SAME_RAY), return_index=True)
                angle, distance = angle[first], distance[first]
                steps = np.diff(angle, append=angle[0] + 2.0 * math.pi)
                gap = float(steps[steps <= _EDGE_OF_VIEW * gap].max(initial=0.0)) or gap
            else:
                self._place, self._is_looking = here, False
            self._angle, self._distance = angle, distance
            enough = 2.0 * math.asin(min(smaller / (nearest + _LOOK_AHEAD), 1.0))
            self._turn = _SHARE_OF_TURN * enough
            self._has_looked = gap <= enough
            if self._is_looking and not self._has_looked:
                return
        sight = max(_sight(radius, gap), self._least)
        if sight >= self._sight - math.dist(here, self._centre):
            self._centre, self._sight = here, sight
            self._radii = np.full(_SECTORS, sight)
            sector = (angle / (2.0 * math.pi) * _SECTORS).astype(np.int64) % _SECTORS
            np.minimum.at(self._radii, sector, np.maximum(distance, self._least))

    def _stopping_distance(self, own: OwnState) -> float:
        """Return the way from one scan until the robot could stand after the next one, m."""
        s = self._scenario
        speed = max(s.robot_speed, math.hypot(own.velocity_x, own.velocity_y))
        return 1.5 * speed * s.time_step + speed**2 / (2.0 * s.max_acceleration)


def _sight(radius: float, gap: float) -> float:
    """Return the distance below which rays with this gap hit every pole of this radius, m."""
    return radius / math.sin(gap / 2.0) if gap > 0.0 else math.inf
