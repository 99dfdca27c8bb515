"""Map files: our YAML format, GeoJSON, and occupancy grids of ROS."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from mrsan.kernels.walls import MOST_SEGMENTS
from mrsan.maps.polygons import (
    MapError,
    Polygon,
    check_inside,
    closed_polygon,
    points_of,
    thin_walls,
)
from mrsan.maps.ros import RosMap, read_ros_map, trace_ros_map
from mrsan.maps.values import TextLoader, number_of, unique_keys

_KEYS = ("bounds", "obstacles", "walls", "scale")
_FORMATS = (
    "a map is YAML with bounds, obstacles and walls, GeoJSON (.json, .geojson), or the YAML file "
    "of a map of ROS (with image)"
)
_MOST_JSON, _MOST_YAML = 20_000_000, 500_000  # bytes; YAML takes much longer to read
_SIDE = (1.0, 10_000.0)  # range of the longer side of a map, m
_DEGREES = ("CRS84", "4326")  # coordinate systems of longitudes and latitudes
_LARGEST_DEGREES = (180.0, 90.0)
_DEGREES_REFUSED = (
    "coordinates in degrees (longitude and latitude); they must be metres: project them first, for "
    "example to UTM"
)
_GEOMETRIES = (
    "Polygon", "MultiPolygon", "LineString", "MultiLineString", "GeometryCollection",
    "Point", "MultiPoint",
)  # fmt: skip


class MapFile(NamedTuple):
    """What a map file says."""

    polygons: list[Polygon]  # the bounds first, in the coordinates of the file, m
    format: str
    notes: tuple[str, ...] = ()  # oddities that are not errors
    ros: RosMap | None = None  # the occupancy grid from which the polygons were traced


def load_map(path: str | Path) -> list[Polygon]:
    """Return the polygons of a map file, the bounds first; see `read_map`.

    Oddities of the file are reported as warnings.

    Raises:
        MapError: names the file, the polygon and what is wrong.
    """
    file = read_map(path)
    for note in file.notes:
        warnings.warn(f"{path}: {note}", stacklevel=2)
    return file.polygons


def read_map(path: str | Path) -> MapFile:
    """Return what a map file says.

    A YAML file has the keys `bounds` (the outline of the floor), `obstacles` (polygons), `walls`
    (polylines) and `scale` (metres per unit); each is optional. GeoJSON has polygons (obstacles),
    lines (walls), and at most one polygon with the property `kind: bounds`, whose holes are
    obstacles; its coordinates are metres, and heights are ignored. A YAML file with the key `image`
    is a map of ROS; its occupied and unknown cells are obstacles.

    Raises:
        MapError: names the file, the polygon and what is wrong.
    """
    path = Path(path)
    try:
        content = _content(path)
        if isinstance(content, dict) and "image" in content:
            ros = read_ros_map(content, path.parent)
            file = MapFile(trace_ros_map(ros), "map of ROS", ros.notes, ros)
            _check_extent(np.concatenate(file.polygons), True)
        elif _is_json(path):
            polygons = _of_parts(_geojson_parts(content))
            file = MapFile(polygons, "GeoJSON", _check_crs(content, polygons))
        else:
            file = MapFile(_of_parts(_yaml_parts(content)), "YAML")
        _check_number(file.polygons)
    except MapError as error:
        raise MapError(f"{path}: {error}") from None
    return file


def _is_json(path: Path) -> bool:
    return path.suffix.lower() in (".json", ".geojson")


def _content(path: Path) -> Any:
    try:
        most = _MOST_JSON if _is_json(path) else _MOST_YAML
        if path.stat().st_size > most:
            raise MapError(f"has more than {most:,} bytes; {_FORMATS}")
        text = path.read_text(encoding="utf-8-sig")
        if _is_json(path):
            return json.loads(text, object_pairs_hook=unique_keys)
        return yaml.load(text, TextLoader)
    except OSError as error:
        raise MapError(f"cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise MapError(f"is not text in UTF-8; {_FORMATS}") from None
    except (ValueError, yaml.YAMLError, RecursionError) as error:
        if isinstance(error, MapError):
            raise
        line = getattr(getattr(error, "problem_mark", None), "line", None)
        where = f" in line {line + 1}" if line is not None else ""
        reason = getattr(error, "problem", None) or getattr(error, "msg", None) or "not text"
        raise MapError(f"is not valid{where} ({reason}); {_FORMATS}") from None


Parts = dict[str, dict[str, Any]]  # kind -> name of the polygon -> its points


def _of_parts(parts: Parts) -> list[Polygon]:
    """Return the checked polygons of a map."""
    named = {name: points for polygons in parts.values() for name, points in polygons.items()}
    listed = [points_of(points, name, 0) for name, points in named.items()]
    _check_extent(np.concatenate([np.zeros((0, 2)), *listed]), False)
    outlines = [closed_polygon(points, name, True) for name, points in parts["bounds"].items()]
    inner = {
        name: [closed_polygon(points, name, False)] for name, points in parts["obstacles"].items()
    }
    inner |= {name: thin_walls(points, name) for name, points in parts["walls"].items()}
    for bounds in outlines:
        check_inside(inner, bounds)
    return [*outlines, *(piece for pieces in inner.values() for piece in pieces)]


def _yaml_parts(content: Any) -> Parts:
    if not isinstance(content, dict):
        raise MapError(f"is not a map; {_FORMATS}")
    for key in content:
        if key not in _KEYS:
            raise MapError(f"has the key {key!r:.60}; {_FORMATS}")
    scale = number_of(content.get("scale", 1.0), "scale", "a positive number")
    if not 0 < scale < 1e6:
        raise MapError(f"scale is {content['scale']!r}; it must be a positive number")

    def scaled(points: Any) -> Any:
        try:
            return np.asarray(points, np.float64) * scale
        except (TypeError, ValueError):
            return points  # the message about it comes with the check

    parts: Parts = {"bounds": {}, "obstacles": {}, "walls": {}}
    if content.get("bounds") is not None:
        parts["bounds"]["bounds"] = scaled(content["bounds"])
    for kind in ("obstacles", "walls"):
        listed = content.get(kind) or []
        if not isinstance(listed, list):
            raise MapError(f"{kind} is {listed!r:.60}; it must be a list of lists of points")
        parts[kind] = {f"{kind}[{k}]": scaled(points) for k, points in enumerate(listed)}
    return parts


def _geojson_parts(content: Any) -> Parts:
    parts: Parts = {"bounds": {}, "obstacles": {}, "walls": {}}
    if isinstance(content, dict) and content.get("type") == "FeatureCollection":
        features = content.get("features")
        if not isinstance(features, list):
            raise MapError(f"features is {features!r:.60}; it must be a list of features")
    elif isinstance(content, dict) and content.get("type") in ("Feature", *_GEOMETRIES):
        features = [content]
    else:
        raise MapError(f"is JSON, but not GeoJSON; {_FORMATS}")
    for number, feature in enumerate(features):
        name = f"features[{number}]"
        if not isinstance(feature, dict):
            raise MapError(f"{name} is {feature!r:.60}; it must be a feature")
        geometry = feature.get("geometry") if feature.get("type") == "Feature" else feature
        if geometry is None:  # a feature without a place (RFC 7946, 3.2)
            continue
        properties = feature.get("properties") or {}
        is_bounds = isinstance(properties, dict) and properties.get("kind") == "bounds"
        _add_geometry(parts, geometry, name, is_bounds)
    if len(parts["bounds"]) > 1:
        raise MapError(f"has {len(parts['bounds'])} bounds; it must have at most one")
    return parts


def _add_geometry(parts: Parts, geometry: Any, name: str, is_bounds: bool) -> None:
    """Add the polygons or lines of one feature."""
    if not isinstance(geometry, dict):
        raise MapError(f"{name} has no geometry")
    kind, coordinates = geometry.get("type"), _without_heights(geometry.get("coordinates"))
    if kind == "GeometryCollection" and isinstance(geometry.get("geometries"), list):
        for k, part in enumerate(geometry["geometries"]):
            _add_geometry(parts, part, f"{name}.{k}", is_bounds)
        return
    if not isinstance(coordinates, list):
        raise MapError(f"{name} has no coordinates")
    if kind in ("LineString", "MultiLineString"):
        lines = [coordinates] if kind == "LineString" else coordinates
        parts["walls"] |= {f"{name}.{k}": line for k, line in enumerate(lines)}
    elif kind in ("Polygon", "MultiPolygon"):
        for k, rings in enumerate([coordinates] if kind == "Polygon" else coordinates):
            if not isinstance(rings, list) or not rings:
                raise MapError(f"{name}.{k} has no ring")
            for ring in rings:
                _check_closed(ring, f"{name}.{k}")
            if is_bounds:
                parts["bounds"][f"{name}.{k}"] = rings[0]
                holes = {f"{name}.{k}.{hole}": ring for hole, ring in enumerate(rings) if hole}
                parts["obstacles"] |= holes
            elif len(rings) > 1:
                raise MapError(
                    f"{name}.{k} has a hole; an obstacle must have none (only the outline with the "
                    "property `kind: bounds` may)"
                )
            else:
                parts["obstacles"][f"{name}.{k}"] = rings[0]
    else:
        raise MapError(
            f"{name} is a {kind}; it must be a Polygon, a LineString or a Multi- of them"
        )


def _without_heights(coordinates: Any) -> Any:
    """Return nested lists of positions without what follows longitude and latitude."""
    if not isinstance(coordinates, list) or not coordinates:
        return coordinates
    if any(isinstance(part, list) for part in coordinates):
        return [_without_heights(part) for part in coordinates]
    return coordinates[:2]


def _check_closed(ring: Any, name: str) -> None:
    """Check that a ring of GeoJSON ends with its first point (RFC 7946, 3.1.6)."""
    if not isinstance(ring, list) or not ring or ring[0] != ring[-1]:
        raise MapError(f"{name} has the ring {ring!r:.60}; its last point must be its first")


def _check_crs(content: Any, polygons: list[Polygon]) -> tuple[str, ...]:
    """Check that the stated coordinate system is one of metres; return notes."""
    if not any(system in str(content.get("crs")) for system in _DEGREES):
        return ()
    crs = f"its crs is {content['crs']!r:.80}"
    if all((np.abs(polygon) <= _LARGEST_DEGREES).all() for polygon in polygons):
        raise MapError(f"{crs}: {_DEGREES_REFUSED} (delete the crs if they are)")
    return (f"{crs}, but its coordinates are too large for degrees and are read as metres",)


def _check_extent(points: Polygon, metres: bool) -> None:
    """Check that the extent of points [K, 2] is that of a map in metres.

    `metres`: the file states that the points are in metres.
    """
    side = float(np.ptp(points, axis=0).max()) if len(points) else math.nan
    least, most = _SIDE
    if not metres and 0 < side < least and (np.abs(points) <= _LARGEST_DEGREES).all():
        raise MapError(f"is {side:.3g} wide, so it has {_DEGREES_REFUSED}")
    if 0 < side < least or side > most:
        raise MapError(
            f"is {side:.3g} m wide; it must be at least {least:g} and at most {most:,.0f} m (is a "
            "point far from the others?)"
        )


def _check_number(polygons: list[Polygon]) -> None:
    if not polygons:
        raise MapError("has no polygon; it must have bounds, obstacles or walls")
    segments = sum(len(polygon) for polygon in polygons)  # a thin wall has a front and a back
    if segments > MOST_SEGMENTS:
        raise MapError(f"has {segments} wall segments; it must have at most {MOST_SEGMENTS}")
