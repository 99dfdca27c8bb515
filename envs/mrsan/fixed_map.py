"""The walls of a map file in the form that kernels take."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.fields import ConfigurationError
from mrsan.kernels import kernel
from mrsan.kernels.layout import MAP
from mrsan.kernels.routes import CORNER_ROWS, build_corners, find_route
from mrsan.kernels.walls import (
    CLEARANCE,
    CORNERS,
    CROSSING_SHARE,
    FAMILY,
    PLACE_COLUMNS,
    WALL_ROWS,
    WALLS,
    WINDING,
    ZONES,
    close_polygon,
    fill_up,
    with_room_for_lanes,
)
from mrsan.state import Floats

if TYPE_CHECKING:
    from mrsan.maps import Polygon


_DECIMALS = 6  # of local coordinates, m


class FixedMap(NamedTuple):
    """The same place for all cases; the arrays are those of `State`, of one world."""

    place: Floats  # [9]; empty without a map file
    walls: Floats  # [12, W]
    zone: Floats  # [4] left, bottom, right, top
    corners: Floats  # [6, V]
    corner_distance: Floats  # [V, V]


_NONE = FixedMap(
    np.zeros(0, np.float32),
    np.zeros((WALL_ROWS, 0), np.float32),
    np.zeros(4, np.float32),
    np.zeros((CORNER_ROWS, 0), np.float32),
    np.zeros((0, 0), np.float32),
)


def fixed_map(map_file: str | None, clearance: float) -> FixedMap:
    """Return the walls of the map file of a scenario about its centre; empty arrays without one.

    Args:
        map_file: `Scenario.map`.
        clearance: that routes keep from walls, m.

    Raises:
        ConfigurationError: the file cannot be used.
    """
    return _NONE if map_file is None else _walls(*_version_of(map_file), clearance)


def map_centre(map_file: str | None) -> tuple[float, float]:
    """Return the point of the file's coordinates that is the origin of the world, m.

    It is the middle of the map: coordinates far from their own origin, such as those of surveyed
    sites, would lose centimetres in float32.

    Raises:
        ConfigurationError: the file cannot be used.
    """
    if map_file is None:
        return 0.0, 0.0
    x, y = centre_of(_polygons(*_version_of(map_file))).tolist()
    return x, y


def centre_of(polygons: Sequence[Polygon]) -> NDArray[np.float64]:
    """Return the middle of polygons [2], m."""
    points = np.concatenate(polygons)
    return (points.min(0) + points.max(0)) / 2


def _version_of(map_file: str) -> tuple[str, int]:
    """Return the absolute path of a file and when it was changed."""
    path = Path(map_file)
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise ConfigurationError(f"scenario.map is {map_file!r}; {error.strerror}") from None
    return str(path.absolute()), changed


@lru_cache(maxsize=16)
def _polygons(path: str, changed: int) -> list[Polygon]:
    """Return the polygons of a version of a file, in its coordinates."""
    from mrsan.maps import MapError, load_map  # here because only maps from files need it

    try:
        return load_map(path)
    except MapError as error:
        raise ConfigurationError(f"scenario.map: {error}") from None


@lru_cache(maxsize=16)
def _walls(path: str, changed: int, clearance: float) -> FixedMap:
    """Return the walls of a version of a file about its centre."""
    polygons = _polygons(path, changed)
    centre = centre_of(polygons)
    # Rounded, so that a world is the same to the last bit wherever its map's origin is.
    return map_of_polygons([(p - centre).round(_DECIMALS) for p in polygons], clearance)


def map_of_polygons(polygons: Sequence[Polygon], clearance: float) -> FixedMap:
    """Return the walls and the route graph of polygons.

    Args:
        polygons: the bounds first, clockwise; solid ones counter-clockwise; two points: thin walls.
        clearance: that routes keep from walls, m.
    """
    vertices = np.concatenate(polygons).astype(np.float32)
    ends = np.cumsum([len(polygon) for polygon in polygons])
    room = 2 * len(vertices)
    loaded = FixedMap(
        np.zeros(PLACE_COLUMNS, np.float32),
        np.zeros((WALL_ROWS, with_room_for_lanes(len(vertices))), np.float32),
        np.concatenate([vertices.min(0), vertices.max(0)]),
        np.zeros((CORNER_ROWS, room), np.float32),
        np.zeros((room, room), np.float32),
    )
    loaded.walls[:2, : len(vertices)] = vertices.T
    loaded.place[WALLS], loaded.place[ZONES] = len(vertices), 1
    loaded.place[WINDING] = -1 if any(_is_clockwise(polygon) for polygon in polygons) else 0
    loaded.place[FAMILY], loaded.place[CROSSING_SHARE] = MAP, 1.0
    loaded.place[CLEARANCE] = clearance
    _complete(1, loaded, ends, np.empty(room, np.float32))
    corners = int(loaded.place[CORNERS])
    return loaded._replace(
        corners=np.ascontiguousarray(loaded.corners[:, :corners]),
        corner_distance=np.ascontiguousarray(loaded.corner_distance[:corners, :corners]),
    )


def next_corner(
    place: FixedMap, start: tuple[float, float], goal: tuple[float, float]
) -> tuple[float, float]:
    """Return the next corner of the shortest route from a start, or the goal, m."""
    ends = np.array([start, goal], np.float32)
    found, cost = np.empty(1, np.int32), np.empty(place.corners.shape[1], np.float32)
    _find_first_corner(1, place, ends, cost, found)
    corner = int(found[0])
    if corner < 0:
        return goal
    return float(place.corners[0, corner]), float(place.corners[1, corner])


@kernel
def _find_first_corner(first, last, place, ends, cost, corner):  # type: ignore[no-untyped-def]
    corner[0], _ = find_route(
        place.walls,
        place.place,
        place.corners,
        place.corner_distance,
        ends[0, 0],
        ends[0, 1],
        ends[1, 0],
        ends[1, 1],
        cost,
    )


def _is_clockwise(polygon: Polygon) -> bool:
    from mrsan.maps.polygons import signed_area

    return len(polygon) > 2 and signed_area(polygon) < 0.0


@kernel
def _complete(first, last, loaded, ends, row):  # type: ignore[no-untyped-def]
    start = 0
    for end in ends:
        close_polygon(loaded.walls, start, end)
        start = end
    fill_up(loaded.walls, loaded.place)
    build_corners(loaded.walls, loaded.place, loaded.corners, loaded.corner_distance, row)
