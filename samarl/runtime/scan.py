"""Walls from the scan of a lidar: no return between its least and its largest range is lost."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.se2 import unit_vectors
from samarl.runtime.inputs import InputError, OwnState, number_above, validated_own

# Kept from what a scan shows, for its noise, besides what may bulge between two rays. Walls within
# the margin must only not come closer. m
SCAN_MARGIN = 0.05
SMALLEST_OBSTACLE = 0.02  # diameter of the thinnest pole that is kept clear of, m
_ROUNDING = 1e-6  # share of a range: messages hold it in single precision
_OTHER_UNIT = 10.0  # ranges that many times the largest range are no measurements in metres,
_MOST_FAR = 3  # except for these few numbers, by which drivers mark rays without a return
_LARGEST_ANGLE = 4.0 * math.pi  # larger ones are degrees, rad
_SAME_ANGLE = 1e-5  # rays closer to each other than this are one, rad
_LARGEST_GAP = 0.5  # between neighbouring returns of the same wall, m
_DEVIATION = 0.05  # of returns from the segment that replaces them, m
_WIDEST = math.pi / 4  # angle that the segment between two rays may cover, rad
_WIDEST_RAY = math.pi / 8  # angle that one ray stands for at most, rad
_LARGEST_TURN = 3.0  # between the ends of a segment, seen from the lidar, rad


class Scan(NamedTuple):
    """The rays of a scan in the frame of `OwnState`."""

    x: float  # of the lidar, m
    y: float
    angle: NDArray[np.float64]  # [L] to the x axis, rising, in [0, 2 pi), rad
    distance: NDArray[np.float64]  # [L] inf for no return, 0 for something too close, m
    largest_range: float  # m
    smallest_obstacle: float  # diameter of the thinnest pole that must be kept clear of, m

    @property
    def gap(self) -> float:
        """Return the usual angle between neighbouring rays, rad."""
        steps = np.diff(self.angle)
        steps = steps[steps > _SAME_ANGLE]
        return float(np.median(steps)) if len(steps) else math.pi

    @property
    def ray_width(self) -> float:
        """Return the angle that a ray stands for: that between neighbours, up to a limit, rad."""
        return min(self.gap, _WIDEST_RAY)

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """Return which rays hit something at a known distance, [L]."""
        return np.isfinite(self.distance) & (self.distance > 0.0)

    @property
    def returns(self) -> NDArray[np.float64]:
        """Return the places [R, 2] that they hit, m."""
        points = unit_vectors(self.angle[self.is_hit]) * self.distance[self.is_hit, None]
        return points + np.array([self.x, self.y])


class ScanWalls(np.ndarray[Any, np.dtype[np.float64]]):
    """Wall segments [K, 4] of a scan, with the scan, which tells where nothing stands.

    Parts of it and results of arithmetic are plain segments; pickles and deep copies have the scan.
    """

    scan: Scan

    def __reduce__(self) -> tuple[Any, ...]:
        """Keep the scan in a pickle."""
        return _with_scan, (np.asarray(self), getattr(self, "scan", None))

    def __deepcopy__(self, memo: Any) -> ScanWalls:
        """Keep the scan in a deep copy."""
        return _with_scan(np.array(self), getattr(self, "scan", None))


def _with_scan(segments: NDArray[np.float64], scan: Scan | None) -> ScanWalls:
    walls = segments.view(ScanWalls)
    if scan is not None:
        walls.scan = scan
    return walls


def measured_ranges(
    ranges: Any, angles: Any, largest_range: float, least_range: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what the rays of a scan measured, by the conventions of drivers (ROS, REP 117).

    Args:
        ranges: [L], m. NaN, zero, negative numbers, infinity and whatever reaches `largest_range`,
            which many drivers return instead, are no return. Minus infinity and positive numbers
            below `least_range` are something too close to be measured.
        angles: [L] of the rays, rad.
        largest_range: of the lidar, m.
        least_range: of the lidar, m.

    Returns:
        Ranges [L], inf for no return and 0 for something too close, m; and the angles [L], rad.

    Raises:
        InputError: names the argument that cannot be used.
    """
    least = number_above("least_range", least_range, 0.0, included=True)
    largest = number_above("largest_range", largest_range, least)
    distance, angle = _vector(ranges), _vector(angles)
    if distance is None or angle is None or len(distance) != len(angle):
        raise InputError(
            f"ranges is {_described(ranges)} and angles is {_described(angles)}; both must be "
            "sequences of numbers, without masks and of the same length"
        )
    is_angle = np.abs(angle) <= _LARGEST_ANGLE
    if not is_angle.all():
        k = int(is_angle.argmin())
        raise InputError(f"angles[{k}] is {angle[k]}; it must be in radians, within +-4 pi")
    far = distance[np.isfinite(distance) & (distance > _OTHER_UNIT * largest)]
    if (values := len(set(far.tolist()))) > _MOST_FAR:
        raise InputError(
            f"ranges has {values} different values up to {far.max():g}; they must be in metres, "
            f"like largest_range ({largest:g})"
        )
    is_return = (distance > 0.0) & (distance < largest * (1.0 - _ROUNDING))
    is_close = is_return & (distance < least * (1.0 - _ROUNDING)) | (distance == -np.inf)
    return np.where(is_close, 0.0, np.where(is_return, distance, np.inf)), angle


def walls_of_scan(
    ranges: Any,
    angles: Any,
    own: OwnState,
    largest_range: float,
    least_range: float = 0.0,
    smallest_obstacle: float = SMALLEST_OBSTACLE,
) -> ScanWalls:
    """Return wall segments [K, 4] for `Driver.step` from the ranges of a lidar.

    Neighbouring returns closer than half a metre belong to the same wall, which is replaced by few
    segments (the Douglas-Peucker algorithm): its returns lie at most 10 cm behind them, and none in
    front. A return without such a neighbour becomes a segment without length. What is nearer than
    the least range becomes one at the lidar itself, so that the shield stops the robot.

    Args:
        ranges: [L], m, see `measured_ranges`.
        angles: [L] of the rays to the heading of the robot, in any order, rad.
        own: the robot, whose position is that of the lidar.
        largest_range: of the lidar, m.
        least_range: of the lidar, m.
        smallest_obstacle: diameter of the thinnest pole that the robot must not touch, m. What lies
            between two rays may be one. Fewer rays or thinner poles therefore make the robot
            slower, until it stops and looks round (`samarl.runtime.clear_area`). Thinner poles are
            kept clear of only once a ray has hit them; infinity switches the limit off.

    Raises:
        InputError: names the argument that cannot be used.
    """
    own = validated_own(own)
    distance, angle = measured_ranges(ranges, angles, largest_range, least_range)
    angle = (angle + own.heading) % (2.0 * math.pi)
    order = np.argsort(angle, kind="stable")
    distance, angle = distance[order], angle[order]
    smallest = number_above("smallest_obstacle", smallest_obstacle, 0.0)
    scan = Scan(own.x, own.y, angle, distance, float(largest_range), smallest)
    return _with_scan(_segments(scan) + np.array([own.x, own.y, own.x, own.y]), scan)


def _segments(scan: Scan) -> NDArray[np.float64]:
    """Return the wall segments [K, 4] of a scan, seen from the lidar."""
    distance, angle = scan.distance, scan.angle
    if not np.isfinite(distance).any():
        return np.zeros((0, 4))
    directions, is_hit = unit_vectors(angle), np.isfinite(distance)
    points = directions * np.where(is_hit, distance, 0.0)[:, None]
    is_wall = is_hit & (distance > 0.0)
    step = np.diff(angle, append=angle[0] + 2.0 * math.pi)
    gap = np.linalg.norm(np.roll(points, -1, 0) - points, axis=-1)
    is_linked = is_wall & np.roll(is_wall, -1) & (gap <= _LARGEST_GAP) & (step <= _WIDEST)
    # Groups begin behind rays that are not linked to the next one. Without any, they are a ring.
    ring = np.roll(np.arange(len(angle)), -1 - int(is_linked.argmin()))
    if is_linked.all():
        ring = np.append(ring, ring[0])
    segments = []
    for group in np.split(ring, np.flatnonzero(~is_linked[ring[:-1]]) + 1):
        if len(group) > 1:
            corners = _corners(points[group], np.unwrap(angle[group]))
            segments += [_in_front(points[group[a : b + 1]]) for a, b in pairwise(corners)]
        elif is_hit[group[0]]:
            segments.append(np.tile(points[group[0]], 2))
    return np.array(segments)


def _corners(points: NDArray[np.float64], angle: NDArray[np.float64]) -> list[int]:
    """Return the indices of the fewest points whose polyline keeps near all of them.

    Args:
        points: [P, 2] seen from the lidar, counter-clockwise, m.
        angle: [P] rising, rad.
    """
    corners, pieces = {0, len(points) - 1}, [(0, len(points) - 1)]
    while pieces:
        first, last = pieces.pop()
        if last - first < 2:
            continue
        away = np.abs(_across(points[first : last + 1]))
        if away.max() > _DEVIATION or angle[last] - angle[first] > _LARGEST_TURN:
            middle = first + int(np.clip(away.argmax(), 1, last - first - 1))
            corners.add(middle)
            pieces += [(first, middle), (middle, last)]
    return sorted(corners)


def _in_front(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the segment [4] between the ends of points [P, 2], moved in front of all of them."""
    along = points[-1] - points[0]
    length = math.hypot(*along)
    normal = np.array([-along[1], along[0]]) / max(length, 1e-9)  # to the lidar
    return np.concatenate([points[0], points[-1]]) + np.tile(normal * _across(points).max(), 2)


def _across(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far points [P, 2] are from the segment between the first and the last, [P], m.

    It is positive on the side of the lidar, which is the left one.
    """
    along, inner = points[-1] - points[0], points - points[0]
    share = np.clip(inner @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    side = along[0] * inner[:, 1] - along[1] * inner[:, 0]
    return np.asarray(np.copysign(np.linalg.norm(inner - share[:, None] * along, axis=-1), side))


def _vector(values: Any) -> NDArray[np.float64] | None:
    """Return values as a vector; None if they are not one of numbers."""
    if isinstance(values, np.ma.MaskedArray):
        return None
    try:
        array = np.asarray(values)
    except Exception:  # whatever a foreign class raises
        return None
    return array.astype(np.float64) if array.ndim == 1 and array.dtype.kind in "fiu" else None


def _described(values: Any) -> str:
    """Return type and length of any value."""
    if values is None:
        return "None (of length 0)"
    try:
        return f"a {type(values).__name__} of length {len(values)}"
    except Exception:  # whatever a foreign class raises
        return f"a single {type(values).__name__}"
