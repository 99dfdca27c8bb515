"""Occupancy grids of ROS (`map.yaml` with its image), traced into polygons."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mrsan.kernels.walls import MOST_SEGMENTS
from mrsan.maps.polygons import MapError, Polygon, signed_area
from mrsan.maps.values import number_of, switch_of

MOST_CELLS = 64_000_000  # 400 m x 400 m at 0.05 m
KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode")

_LARGEST_CELL = 100.0  # m
_COARSEST = 0.2  # m, largest deviation of the simplified outline
_FARTHEST = 1e9  # m, largest coordinate of the origin
_MODES = ("trinary", "scale", "raw")
_PICTURES = ("PPM", "PNG", "BMP", "TIFF")  # without formats that blur shades, such as JPEG
_NAMED = "PGM, PNG, BMP or TIFF"
# Shades of unknown cells in the images that map savers write (nav2 and SLAM Toolbox, Cartographer);
# with `negate`, their complements. With a high `free_thresh` they would count as free.
_UNKNOWN_SHADES = (205, 127, 128)


class Grid(NamedTuple):
    """Cells of a map [rows, columns], the top row first. The others are unknown."""

    free: NDArray[np.bool_]
    occupied: NDArray[np.bool_]


class RosMap(NamedTuple):
    """What the file of an occupancy grid says."""

    grid: Grid
    resolution: float  # size of a cell, m
    origin: tuple[float, float, float]  # pose of the lower left corner: x and y, m, and yaw, rad
    notes: tuple[str, ...]  # oddities that are not errors


def read_ros_map(content: dict[Any, Any], folder: Path) -> RosMap:
    """Return the cells and the geometry of an occupancy grid.

    The keys are those of the map servers of ROS and ROS 2 (`nav2_map_server`). Cells that are
    transparent, or have the shade that map savers give to unexplored ones, are unknown.

    Raises:
        MapError: a key is unknown, missing or wrong, or the image cannot be read.
    """
    for key in content:
        if key not in KEYS:
            raise MapError(f"has the key {key!r:.60}; a map of ROS has only {', '.join(KEYS)}")
    must = f"a positive number of metres, at most {_LARGEST_CELL:g}"
    resolution = number_of(content.get("resolution"), "resolution", must)
    if not 0 < resolution <= _LARGEST_CELL:
        raise MapError(f"resolution is {content['resolution']!r:.60}; it must be {must}")
    origin, notes = _origin(content.get("origin"))
    free_below = _threshold(content, "free_thresh", 0.196)
    occupied_above = _threshold(content, "occupied_thresh", 0.65)
    if free_below > occupied_above:
        raise MapError(
            f"free_thresh is {free_below:g}; it must not exceed occupied_thresh "
            f"({occupied_above:g})"
        )
    mode = str(content.get("mode", "trinary")).strip().lower()
    if mode not in _MODES:
        raise MapError(f"mode is {content['mode']!r:.60}; it must be one of {', '.join(_MODES)}")
    negate = switch_of(content.get("negate", 0), "negate")
    if negate and mode == "raw":
        raise MapError("negate is 1; it must be 0 with mode raw, whose shades are occupancies in %")
    level, most, known = _read_image(content["image"], folder)
    shade = np.arange(most + 1) / most
    if mode == "raw":
        occupancy = np.rint(shade * 255.0) / 100.0
        occupancy[occupancy > 1.0] = np.nan
    else:
        occupancy = shade if negate else 1.0 - shade
        occupancy[np.isin(np.rint(255.0 - occupancy * 255.0), _UNKNOWN_SHADES)] = np.nan
    grid = Grid(
        known & (occupancy < free_below)[level], known & (occupancy > occupied_above)[level]
    )
    return RosMap(grid, resolution, origin, notes)


def trace_ros_map(ros_map: RosMap, most: int = MOST_SEGMENTS) -> list[Polygon]:
    """Return the outline of the largest free area, clockwise, and of its obstacles.

    Occupied and unknown cells are obstacles.

    Raises:
        MapError: no cell is free, or the map has too many details.
    """
    return trace_free_area(ros_map.grid.free, ros_map.resolution, ros_map.origin, most)


def trace_free_area(
    free: NDArray[np.bool_],
    resolution: float,
    origin: tuple[float, float, float],
    most: int = MOST_SEGMENTS,
) -> list[Polygon]:
    """Return the outline of the largest free area of a grid, clockwise, and of its obstacles.

    Outlines are simplified by at least half a cell, and by more until there are at most `most`
    segments. Obstacles that are smaller than that become thin walls.

    Args:
        free: which cells are free, [rows, columns], the top row first.
        resolution: size of a cell, m.
        origin: pose of the lower left corner of the grid: x and y, m, and yaw, rad.
        most: largest number of segments.

    Raises:
        MapError: no cell is free, or the map has too many details.
    """
    try:
        from skimage.measure import find_contours, label
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
        outlines = [_simplified(contour, tolerance) for contour in contours]
        if max(map(len, outlines)) < 3:
            raise MapError(
                f"has no free area wider than {tolerance * resolution:g} m; it must have one"
            )
        if sum(map(len, outlines)) <= most:
            return _in_metres(outlines, len(free), resolution, origin)
        tolerance *= 2
    raise MapError(
        f"has {sum(map(len, outlines))} wall segments when simplified by {_COARSEST} m; it must "
        f"have at most {most}"
    )


def _simplified(contour: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Return fewer vertices of a closed contour, two for one that is smaller than the tolerance."""
    from skimage.measure import approximate_polygon

    outline: NDArray[np.float64] = approximate_polygon(contour, tolerance)[:-1]
    if len(outline) >= 3:
        return outline
    farthest = int(np.linalg.norm(contour - contour[0], axis=-1).argmax())
    return contour[[0, farthest]]


def _origin(value: Any) -> tuple[tuple[float, float, float], tuple[str, ...]]:
    """Return the pose of the lower left corner, and a note if its yaw looks like degrees."""
    must = "three numbers [x, y, yaw] in metres and radians"
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise MapError(f"origin is {value!r:.60}; it must be {must}")
    x, y, yaw = (number_of(part, "origin", must) for part in value)
    if max(abs(x), abs(y)) > _FARTHEST:
        raise MapError(f"origin is {value!r:.60}; it must be within {_FARTHEST:.0e} m")
    notes: tuple[str, ...] = ()
    if abs(yaw) > 2 * math.pi:
        notes = (f"the yaw of origin is {yaw:g} rad, more than a full turn; is it in degrees?",)
    return (x, y, yaw), notes


def _threshold(content: dict[Any, Any], name: str, usual: float) -> float:
    value = number_of(content.get(name, usual), name, "a number in [0, 1]")
    if not 0.0 <= value <= 1.0:
        raise MapError(f"{name} is {content[name]!r}; it must be a number in [0, 1]")
    return value


def _read_image(name: Any, folder: Path) -> tuple[NDArray[np.integer], int, NDArray[np.bool_]]:
    """Return the shades of the cells as whole numbers, the largest one, and which are opaque."""
    if not isinstance(name, str) or not name:
        raise MapError(f"image is {name!r:.60}; it must be the path of a picture")
    path = folder / name
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(path, formats=_PICTURES)
        with image:
            columns, rows = image.size
            if columns * rows > MOST_CELLS:
                raise MapError(
                    f"image {path} has {columns} x {rows} cells; it must have at most "
                    f"{MOST_CELLS:,}"
                )
            return _shades(image)
    except MapError:
        raise
    except FileNotFoundError as error:
        raise MapError(f"image {path} cannot be read ({error.strerror})") from None
    except UnidentifiedImageError:
        raise MapError(f"image {path} is not a picture in the format {_NAMED}") from None
    except Image.DecompressionBombError:
        raise MapError(
            f"image {path} has too many cells; it must have at most {MOST_CELLS:,}"
        ) from None
    except (OSError, ValueError, SyntaxError, EOFError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or "it is damaged or ends too early"
        raise MapError(
            f"image {path} cannot be read ({reason}); it must be a complete {_NAMED}"
        ) from None


def _shades(image: Image.Image) -> tuple[NDArray[np.integer], int, NDArray[np.bool_]]:
    if image.mode.startswith(("I", "F")):  # 16 bits per cell, or floating-point numbers
        level = np.asarray(image)
        if image.mode == "F" or level.min() < 0 or level.max() > 65535:
            raise MapError("image has negative or fractional shades; they must have 8 or 16 bits")
        transparent = image.info.get("transparency", -1)
        return level, 65535, level != transparent
    pixels = np.asarray(image.convert("RGBA"))
    return pixels[..., :3].sum(-1, dtype=np.uint16), 3 * 255, pixels[..., 3] == 255


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
