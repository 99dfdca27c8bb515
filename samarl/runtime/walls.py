"""Walls for `Driver.step`: from a map that the robot knows, or from the scan of a lidar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrsan.fixed_map import map_of_polygons, next_corner
from mrsan.se2 import unit_vectors
from samarl.runtime.inputs import OwnState

if TYPE_CHECKING:
    from mrsan.maps import Polygon

_LARGEST_GAP = 0.5  # between neighbouring points of a scan on the same wall, m
_DEVIATION = 0.05  # of points from the segment that replaces them, m


class KnownMap:
    """The walls of a map, and the shortest routes round them."""

    def __init__(self, polygons: Sequence[Polygon], clearance: float = 0.4) -> None:
        """Build the route graph.

        Args:
            polygons: the bounds first, as `mrsan.maps.load_map` returns them.
            clearance: that routes keep from walls, m; not less than the radius of the robot.
        """
        self._map = map_of_polygons(polygons, clearance)
        pieces = [np.hstack([p, np.roll(p, -1, 0)]) for p in polygons]
        self.walls: NDArray[np.float64] = np.concatenate(pieces)  # [K, 4], floor to their right

    @classmethod
    def load(cls, path: str | Path, clearance: float = 0.4) -> KnownMap:
        """Load a map file, see `mrsan.maps.load_map`.

        Raises:
            MapError: the file cannot be used.
        """
        from mrsan.maps import load_map  # here because only maps from files need its packages

        return cls(load_map(path), clearance)

    @classmethod
    def of_grid(
        cls,
        free: NDArray[np.bool_],
        resolution: float,
        origin: tuple[float, float, float],
        clearance: float = 0.4,
    ) -> KnownMap:
        """Trace an occupancy grid, see `mrsan.maps.trace_free_area`.

        Raises:
            MapError: no cell is free, or the grid has too many details.
        """
        from mrsan.maps import trace_free_area

        return cls(trace_free_area(free, resolution, origin), clearance)

    def facing(self, own: OwnState) -> NDArray[np.float64]:
        """Return the wall segments [K, 4] whose floor side the robot faces, as in the simulator."""
        return self.walls[faces(self.walls, own)]

    def with_route(self, own: OwnState) -> OwnState:
        """Return the state with the next corner of the shortest route to its goal."""
        x, y = next_corner(self._map, (own.x, own.y), (own.goal_x, own.goal_y))
        return own._replace(next_x=x, next_y=y)


def faces(walls: NDArray[np.float64], own: OwnState) -> NDArray[np.bool_]:
    """Return whether the robot is to the right of each of the segments [K, 4], seen from start."""
    along, start = walls[:, 2:] - walls[:, :2], walls[:, :2] - (own.x, own.y)
    return np.asarray(along[:, 0] * start[:, 1] - along[:, 1] * start[:, 0] > 0.0)


def walls_of_scan(
    ranges: ArrayLike, angles: ArrayLike, own: OwnState, greatest_range: float
) -> NDArray[np.float64]:
    """Return wall segments [K, 4] for `Driver.step` from the ranges of a lidar.

    Neighbouring points closer than half a metre belong to the same wall. Each wall is replaced by
    the fewest segments that keep within 5 cm of its points (the Douglas-Peucker algorithm).

    Args:
        ranges: [L], m; those that are not finite or reach `greatest_range` hit nothing.
        angles: [L] of the rays to the heading of the robot, rising, rad.
        own: the robot, whose position is that of the lidar.
        greatest_range: of the lidar, m.
    """
    distance, angle = np.asarray(ranges, np.float64), np.asarray(angles, np.float64) + own.heading
    hit = np.isfinite(distance) & (distance < greatest_range)
    points = unit_vectors(angle) * np.where(hit, distance, 0.0)[:, None]
    points += (own.x, own.y)
    segments: list[list[float]] = []
    group: list[NDArray[np.float64]] = []
    for k in range(len(points) + 1):
        ends = k == len(points) or not hit[k]
        if group and (ends or math.dist(points[k], group[-1]) > _LARGEST_GAP):
            corners = _simplify(np.array(group))
            segments += [[*a, *b] for a, b in pairwise(corners)]
            group = []
        if not ends:
            group.append(points[k])
    return np.array(segments).reshape(-1, 4)


def _simplify(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the fewest of the points whose polyline keeps near all of them."""
    start, end = points[0], points[-1]
    if len(points) < 3:
        return [start, end] if len(points) == 2 else [start]
    along = end - start
    length = max(math.hypot(*along), 1e-9)
    away = np.abs(along[0] * (points[:, 1] - start[1]) - along[1] * (points[:, 0] - start[0]))
    middle = int(away.argmax())
    if away[middle] / length <= _DEVIATION:
        return [start, end]
    return [*_simplify(points[: middle + 1])[:-1], *_simplify(points[middle:])]
