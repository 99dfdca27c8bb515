"""The walls of a map file in the form that kernels take."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from mrsan.fields import ConfigurationError
from mrsan.kernels.layout import MAP
from mrsan.kernels.routes import CORNER_ROWS, build_corners
from mrsan.kernels.walls import (
    CLEARANCE,
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
    from mrsan.scenario import Scenario


class FixedMap(NamedTuple):
    """The same place for all cases; the arrays are those of `State`, of one world."""

    place: Floats  # [8]; empty without a map file
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


def fixed_map(scenario: Scenario) -> FixedMap:
    """Return the walls of the scenario's map file; empty arrays without one.

    Raises:
        ConfigurationError: the file cannot be used.
    """
    if scenario.map is None:
        return _NONE
    path = Path(scenario.map)
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise ConfigurationError(f"scenario.map is {scenario.map!r}; {error.strerror}") from None
    return _load(str(path.absolute()), changed, scenario.route_clearance)


def map_size(scenario: Scenario) -> tuple[int, int]:
    """Return the numbers of wall segments and of corners of the scenario's map file."""
    loaded = fixed_map(scenario)
    return loaded.walls.shape[1], loaded.corners.shape[1]


@lru_cache(maxsize=16)
def _load(path: str, changed: int, clearance: float) -> FixedMap:
    from mrsan.maps import MapError, load_map  # here because only maps from files need it

    try:
        polygons = load_map(path)
    except MapError as error:
        raise ConfigurationError(f"scenario.map: {error}") from None
    vertices = np.concatenate(polygons).astype(np.float32)
    ends = np.cumsum([len(polygon) for polygon in polygons])
    loaded = FixedMap(
        np.zeros(PLACE_COLUMNS, np.float32),
        np.zeros((WALL_ROWS, with_room_for_lanes(len(vertices))), np.float32),
        np.concatenate([vertices.min(0), vertices.max(0)]),
        np.zeros((CORNER_ROWS, 2 * len(vertices)), np.float32),
        np.zeros((2 * len(vertices), 2 * len(vertices)), np.float32),
    )
    loaded.walls[:2, : len(vertices)] = vertices.T
    loaded.place[WALLS], loaded.place[ZONES] = len(vertices), 1
    loaded.place[WINDING] = -1 if any(_is_clockwise(polygon) for polygon in polygons) else 0
    loaded.place[FAMILY], loaded.place[CROSSING_SHARE] = MAP, 1.0
    loaded.place[CLEARANCE] = clearance
    _complete(loaded, ends, np.empty(2 * len(vertices), np.float32))
    corners = int(loaded.place[1])
    return loaded._replace(
        corners=np.ascontiguousarray(loaded.corners[:, :corners]),
        corner_distance=np.ascontiguousarray(loaded.corner_distance[:corners, :corners]),
    )


def _is_clockwise(polygon: Polygon) -> bool:
    x, y = polygon.T
    return len(polygon) > 2 and float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum()) < 0.0


@numba.njit(cache=True, error_model="numpy")
def _complete(loaded, ends, row):  # type: ignore[no-untyped-def]
    first = 0
    for last in ends:
        close_polygon(loaded.walls, first, last)
        first = last
    fill_up(loaded.walls, loaded.place)
    build_corners(loaded.walls, loaded.place, loaded.corners, loaded.corner_distance, row)
