"""Walls for `Driver.step` from a map that the robot knows, and routes round them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.fixed_map import centre_of, map_of_polygons, next_corner
from mrsan.se2 import unrotate
from samarl.runtime.inputs import OwnState

if TYPE_CHECKING:
    from mrsan.maps import Polygon

_LONGEST_PART = 1000.0  # of a wall on each side of its nearest point, m


class KnownMap:
    """The walls of a map, and the shortest routes round them."""

    def __init__(self, polygons: Sequence[Polygon], clearance: float = 0.4) -> None:
        """Build the route graph.

        Args:
            polygons: the bounds first, as `mrsan.maps.load_map` returns them.
            clearance: that routes keep from walls, m; not less than the radius of the robot.
        """
        # The route graph is in single precision, which is coarse far away from the origin.
        self.centre = centre_of(polygons)
        self.local = map_of_polygons([p - self.centre for p in polygons], clearance)
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
        x, y = (float(number) for number in self.centre)
        goal = own.goal_x - x, own.goal_y - y
        corner = next_corner(self.local, (own.x - x, own.y - y), goal)
        if corner == goal:
            return own._replace(next_x=own.goal_x, next_y=own.goal_y)
        return own._replace(next_x=x + corner[0], next_y=y + corner[1])


class NearWalls(NamedTuple):
    """Walls as a robot sees them, the nearest first."""

    segments: NDArray[np.float64]  # [K, 4] in the body frame, floor to their right, m
    nearest: NDArray[np.float64]  # [K, 2] the point of each that is nearest to the robot, m
    distance: NDArray[np.float64]  # [K] to that point, m
    order: NDArray[np.int64]  # [K] the index of each among all walls


def seen_from(own: OwnState, walls: NDArray[np.float64], reach: float) -> NearWalls:
    """Return the walls [K, 4] within reach of a robot, m.

    The robot sees their floor side, which the simulator has on their right. The parts of very long
    walls that are far from the robot are left out: single precision would displace the others.
    """
    position = np.array([own.x, own.y])
    starts, ends = walls[:, :2] - position, walls[:, 2:] - position
    along = ends - starts
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-6)
    share = np.clip(-(starts * along).sum(-1) / length**2, 0.0, 1.0)
    nearest = starts + share[:, None] * along
    distance = np.linalg.norm(nearest, axis=-1)
    first = np.maximum(share - _LONGEST_PART / length, 0.0)[:, None]
    last = np.minimum(share + _LONGEST_PART / length, 1.0)[:, None]
    starts, ends = starts + first * along, ends - (1.0 - last) * along
    is_in_front = faces(walls, own)[:, None]
    starts, ends = np.where(is_in_front, starts, ends), np.where(is_in_front, ends, starts)
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= reach]
    cos, sin = math.cos(own.heading), math.sin(own.heading)
    starts, ends, nearest = (
        np.stack(unrotate(cos, sin, points[order, 0], points[order, 1]), -1)
        for points in (starts, ends, nearest)
    )
    return NearWalls(np.hstack([starts, ends]), nearest, distance[order], order)


def faces(walls: NDArray[np.float64], own: OwnState) -> NDArray[np.bool_]:
    """Return whether the robot is to the right of each of the segments [K, 4], seen from start."""
    along, start = walls[:, 2:] - walls[:, :2], walls[:, :2] - (own.x, own.y)
    return np.asarray(along[:, 0] * start[:, 1] - along[:, 1] * start[:, 0] > 0.0)
