"""Polygons of maps: checks, and the orientation that the simulator expects."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

# [K, 2] vertices, m. Counter-clockwise: solid. Clockwise: bounds the floor. Two: a thin wall.
Polygon = NDArray[np.float64]

_SMALLEST_AREA = 1e-6  # m^2
_FARTHEST = 1e9  # m, largest coordinate; beyond it float64 is coarser than a micrometre
_ROUNDING = 1e-6  # tolerance for rounding errors, m or as a share of a side


class MapError(ValueError):
    """A map that cannot be used; the message names the polygon and what is wrong with it."""


def points_of(values: Any, name: str, least: int) -> Polygon:
    """Return points [K, 2] without consecutive repetitions.

    Raises:
        MapError: they are not points, or too few.
    """
    try:
        points = np.asarray(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        points = np.zeros(0)
    if points.ndim != 2 or points.shape[1] != 2 or not (np.abs(points) <= _FARTHEST).all():
        text = " ".join(str(values).split())
        raise MapError(
            f"{name} is {text:.60}; it must be a list of points [x, y] of finite numbers, at most "
            f"{_FARTHEST:.0e} m"
        )
    differs = np.ones(len(points), np.bool_)
    differs[1:] = (points[1:] != points[:-1]).any(-1)
    points = points[differs]
    if len(points) < least:
        raise MapError(f"{name} has {len(points)} different points; it must have at least {least}")
    return points


def closed_polygon(values: Any, name: str, clockwise: bool) -> Polygon:
    """Return the vertices of a simple polygon in one orientation.

    Raises:
        MapError: it is not a simple polygon.
    """
    points = points_of(values, name, 3)
    if (points[0] == points[-1]).all():
        points = points[:-1]
    if len(points) < 3:
        raise MapError(f"{name} has {len(points)} different points; it must have at least 3")
    crossing = _first_crossing(points)
    if crossing is not None:
        first, second = (points[k].tolist() for k in crossing)
        raise MapError(
            f"{name} intersects itself: the sides from {first} and from {second} meet; the sides "
            "of a polygon must not"
        )
    area = signed_area(points)
    if abs(area) < _SMALLEST_AREA:
        raise MapError(f"{name} has no area; it must be a polygon (thin walls belong to `walls`)")
    return points[::-1].copy() if (area < 0) != clockwise else points


def thin_walls(values: Any, name: str) -> list[Polygon]:
    """Return the pieces of an open polyline, each a wall of two vertices.

    Raises:
        MapError: it is not a list of at least two points.
    """
    points = points_of(values, name, 2)
    return [np.stack(piece) for piece in pairwise(points)]


def check_inside(polygons: dict[str, list[Polygon]], bounds: Polygon) -> None:
    """Check that named polygons lie within the bounds, which they may touch.

    Raises:
        MapError: a vertex lies outside, or a side leaves bounds that are not convex.
    """
    for name, piece in ((name, piece) for name, pieces in polygons.items() for piece in pieces):
        for point in piece:
            if not _contains(bounds, point):
                raise MapError(f"{name} has the point {point.tolist()}; it must be within bounds")
        for start, end in zip(piece, np.roll(piece, -1, 0), strict=True):
            if _leaves(bounds, start, end):
                side = f"the side from {start.tolist()} to {end.tolist()}"
                raise MapError(f"{name} has {side}; it must be within bounds")


def signed_area(points: Polygon) -> float:
    """Return the area of a polygon, m^2; negative if it is clockwise."""
    x, y = (points - points[0]).T  # far from the origin the products would lose digits
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def covered_area(polygons: list[Polygon]) -> float:
    """Return the area of the union of counter-clockwise polygons, m^2.

    Between the heights of successive vertices and crossings, the covered length is linear in the
    height, so its value in the middle counts. Covered are the points whose winding number is
    positive.
    """
    if not polygons:
        return 0.0
    start = np.concatenate(polygons)
    start, offset = start - start[0], start[0]
    end = np.concatenate([np.roll(polygon, -1, 0) for polygon in polygons]) - offset
    along = end - start
    between = start[None] - start[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = _cross(between, along[None]) / _cross(along[:, None], along[None])
        crossings = start[:, None, 1] + share * along[:, None, 1]
    heights = crossings[(share >= 0) & (share <= 1)]
    heights = np.unique(np.concatenate([start[:, 1], heights]).round(9))
    area = 0.0
    for low, high in pairwise(heights.tolist()):
        y = (low + high) / 2
        met = (start[:, 1] > y) != (end[:, 1] > y)
        x = start[met, 0] + (y - start[met, 1]) / along[met, 1] * along[met, 0]
        order = x.argsort()
        windings = np.where(along[met, 1] < 0, 1, -1)[order].cumsum()
        area += float((high - low) * np.diff(x[order])[windings[:-1] > 0].sum())
    return area


def _cross(a: Polygon, b: Polygon) -> Polygon:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _first_crossing(points: Polygon) -> tuple[int, int] | None:
    """Return two sides of a polygon that meet although they are not neighbours."""
    n = len(points)
    ends = np.roll(points, -1, 0)
    for i in range(n - 1):
        others = np.arange(i + 2, n if i > 0 else n - 1)
        if len(others) == 0:
            continue
        meet = _segments_meet(points[i], ends[i], points[others], ends[others])
        if meet.any():
            return i, int(others[meet.argmax()])
    return None


def _segments_meet(a: Polygon, b: Polygon, c: Polygon, d: Polygon) -> NDArray[np.bool_]:
    """Return whether the segment from a to b meets each of those from c to d [K, 2]."""

    def side(p: Polygon, q: Polygon, r: Polygon) -> Any:
        (px, py), (qx, qy), (rx, ry) = p.T, q.T, r.T
        return (qx - px) * (ry - py) - (qy - py) * (rx - px)

    crossing = (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)
    low, high = np.minimum(a, b), np.maximum(a, b)
    overlap = (np.minimum(c, d) <= high).all(-1) & (np.maximum(c, d) >= low).all(-1)
    return np.asarray(crossing & overlap)


def _leaves(polygon: Polygon, start: Polygon, end: Polygon) -> bool:
    """Return whether a segment between two points of a polygon is partly outside it.

    The sides of the polygon divide the segment into pieces, each inside or outside as a whole.
    """
    way, sides, offset = end - start, np.roll(polygon, -1, 0) - polygon, polygon - start
    parallel = way[0] * sides[:, 1] - way[1] * sides[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        on_way = (offset[:, 0] * sides[:, 1] - offset[:, 1] * sides[:, 0]) / parallel
        on_side = (offset[:, 0] * way[1] - offset[:, 1] * way[0]) / parallel
    crossed = (on_way > 0) & (on_way < 1) & (on_side > -_ROUNDING) & (on_side < 1 + _ROUNDING)
    shares = np.sort([0.0, *on_way[crossed], 1.0])
    middles = start + ((shares[1:] + shares[:-1]) / 2)[:, None] * way
    return not all(_contains(polygon, middle) for middle in middles)


def _contains(polygon: Polygon, point: Polygon) -> bool:
    """Return whether a point lies in a polygon or on its border."""
    ends = np.roll(polygon, -1, 0)
    along = ends - polygon
    t = ((point - polygon) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    nearest = polygon + np.clip(t, 0, 1)[:, None] * along
    if (np.linalg.norm(nearest - point, axis=-1) < _ROUNDING).any():
        return True
    (x, y), (ax, ay), (bx, by) = point, polygon.T, ends.T
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return bool(crossed.sum() % 2)
