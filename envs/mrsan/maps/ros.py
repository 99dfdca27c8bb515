"""Occupancy grids of ROS (`map.yaml` with its image), traced into polygons."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mrsan.kernels.walls import MOST_SEGMENTS
from mrsan.maps.polygons import MapError, Polygon, signed_area

_COARSEST = 0.2  # m, largest deviation of the simplified outline


def load_ros_map(content: dict[str, Any], folder: Path, most: int) -> list[Polygon]:
    """Return the outline of the largest free area of a grid, clockwise, and of its obstacles.

    Occupied and unknown cells are obstacles.

    Args:
        content: of the YAML file, with the keys of ROS's map server.
        folder: where the image is.
        most: largest number of segments.

    Raises:
        MapError: a key is missing or wrong, or the map has too many details.
    """
    resolution, origin = _geometry(content)
    return trace_free_area(_free_cells(content, folder), resolution, origin, most)


def trace_free_area(
    free: NDArray[np.bool_],
    resolution: float,
    origin: tuple[float, float, float],
    most: int = MOST_SEGMENTS,
) -> list[Polygon]:
    """Return the outline of the largest free area of a grid, clockwise, and of its obstacles.

    Outlines are simplified by at least half a cell, and by more until there are at most `most`
    segments.

    Args:
        free: which cells are free, [rows, columns], the top row first.
        resolution: size of a cell, m.
        origin: pose of the lower left corner of the grid: x and y, m, and yaw, rad.
        most: largest number of segments.

    Raises:
        MapError: no cell is free, or the map has too many details.
    """
    try:
        from skimage.measure import approximate_polygon, find_contours, label
    except ModuleNotFoundError:
        raise MapError("needs scikit-image: pip install 'samarl[maps]'") from None
    areas = label(free, connectivity=1)
    if not areas.any():
        raise MapError("has no free cell; some cells must be free")
    largest = np.bincount(areas.ravel())[1:].argmax() + 1
    padded = np.pad((areas == largest).astype(float), 1)
    contours = find_contours(padded, 0.5, fully_connected="low")
    tolerance = 0.5
    while tolerance * resolution <= max(_COARSEST, 0.5 * resolution):
        outlines = [approximate_polygon(contour, tolerance)[:-1] for contour in contours]
        outlines = [outline for outline in outlines if len(outline) >= 3]
        if sum(map(len, outlines)) <= most:
            return _in_metres(outlines, len(free), resolution, origin)
        tolerance *= 2
    raise MapError(
        f"has {sum(map(len, outlines))} wall segments when simplified by {_COARSEST} m; it must "
        f"have at most {most}"
    )


def _geometry(content: dict[str, Any]) -> tuple[float, tuple[float, float, float]]:
    """Return the size of a cell and the pose of the lower left corner."""
    resolution = content.get("resolution")
    if isinstance(resolution, bool) or not isinstance(resolution, int | float) or resolution <= 0:
        raise MapError(f"resolution is {resolution!r}; it must be a positive number of metres")
    origin = content.get("origin")
    try:
        x, y, yaw = (float(value) for value in origin)  # type: ignore[union-attr]
    except (TypeError, ValueError):
        raise MapError(f"origin is {origin!r}; it must be [x, y, yaw]") from None
    if not all(map(math.isfinite, (x, y, yaw))):
        raise MapError(f"origin is {origin!r}; it must be finite")
    return float(resolution), (x, y, yaw)


def _free_cells(content: dict[str, Any], folder: Path) -> NDArray[np.bool_]:
    """Return which cells are free, the top row first."""
    path = folder / str(content["image"])
    try:
        with Image.open(path) as image:
            grey = np.asarray(image.convert("L"), np.float64) / 255.0
    except (OSError, UnidentifiedImageError) as error:
        reason = getattr(error, "strerror", None) or "not an image"
        raise MapError(f"image {path} cannot be read ({reason})") from None
    threshold = content.get("free_thresh", 0.196)
    if isinstance(threshold, bool) or not isinstance(threshold, int | float):
        raise MapError(f"free_thresh is {threshold!r}; it must be a number")
    occupancy = grey if content.get("negate") else 1.0 - grey
    return np.asarray(occupancy < threshold)


def _in_metres(
    outlines: list[NDArray[np.float64]],
    rows: int,
    resolution: float,
    origin: tuple[float, float, float],
) -> list[Polygon]:
    """Return outlines of rows and columns as polygons, the outer one first and clockwise."""
    x, y, yaw = origin
    polygons = []
    for outline in outlines:
        row, column = outline.T - 1.0  # the cells were padded
        along, up = (column + 0.5) * resolution, (rows - row - 0.5) * resolution
        polygons.append(
            np.stack(
                [
                    x + math.cos(yaw) * along - math.sin(yaw) * up,
                    y + math.sin(yaw) * along + math.cos(yaw) * up,
                ],
                -1,
            )
        )
    polygons.sort(key=lambda polygon: -abs(signed_area(polygon)))
    return [
        polygon if (signed_area(polygon) < 0) == (number == 0) else polygon[::-1].copy()
        for number, polygon in enumerate(polygons)
    ]
