"""Doors and corridors: where a place is too narrow for two robots abreast.

A gap is a line between two walls that no other wall comes nearer to: the disc that has it as its
diameter is clear of walls. Narrow gaps with a narrow way between them are one passage; those with
nothing but open floor on a side are its mouths there. A door in a thin wall is a single gap, with a
mouth on each side.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels.walls import (
    CLEARANCE,
    END_X,
    END_Y,
    START_CONVEX,
    START_X,
    START_Y,
    WALLS,
    WINDING,
)
from mrsan.state import Floats, Ints

Points = NDArray[np.float64]  # [..., 2]

_ROUNDING = 2e-3  # m
_ABREAST = 0.6  # m, room that two robots abreast need besides their diameters
_TOUCH = 1e-6  # m; a way that ends at a corner of walls ends there
_BEND = 1.5  # a way along which a passage turns is at most this much wider
_SAMPLE = 0.1  # m, between the points at which a way is examined
_FUNNEL_LENGTH, _FUNNEL = 2.5, 1.3  # m: before a mouth, and how far from it robots queue
_FARTHEST = 5.0  # m, of a queue place from its mouth
_SPACING = 0.4  # m, between queue places
APART = 0.7  # m, between robots that queue
BLOCKED_LENGTH, BLOCKED_MARGIN = 1.5, 0.65  # m, before and beside a mouth


class Passages(NamedTuple):
    """The mouths of all passages of a place; the K mouths of a passage are neighbours."""

    mouth: Points  # [K, 2] middle, m
    outward: Points  # [K, 2] unit vector out of the passage
    width: NDArray[np.float64]  # [K] m
    passage: Ints  # [K] number of the passage
    length: NDArray[np.float64]  # [P] of the longest way between two mouths of a passage, m
    places: list[Points]  # [K] of [Q, 2] where robots can wait beside a mouth, nearest first, m
    way: Points  # [S, 2, 2] ends of the straight ways through the passages, m; a door has a point
    way_passage: Ints  # [S] number of the passage

    def is_blocked(self, mouth: int, points: Points) -> NDArray[np.bool_]:
        """Return at which points [..., 2] a parked robot would block a mouth."""
        ahead, aside = self.relative(mouth, points)
        beside = self.width[mouth] / 2 + BLOCKED_MARGIN
        return (ahead >= -0.1) & (ahead < BLOCKED_LENGTH) & (aside < beside)

    def spread_places(self, mouth: int, number: int) -> Points:
        """Return up to `number` queue places [Q, 2] of a mouth that robots can fill together."""
        spread: list[Points] = []
        for place in self.places[mouth]:
            if len(spread) < number and all(np.linalg.norm(place - s) > APART for s in spread):
                spread.append(place)
        return np.array(spread).reshape(-1, 2)

    def relative(
        self, mouth: int, points: Points
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how far points [..., 2] are before a mouth and beside its axis, m."""
        offset = points - self.mouth[mouth]
        x, y = self.outward[mouth]
        return offset @ (x, y), np.abs(offset @ (-y, x))


def open_width(robot_radius: float) -> float:
    """Return the width from which two robots abreast have room, m."""
    return 4.0 * robot_radius + _ABREAST


def find_passages(walls: Floats, place: Floats, widest: float) -> Passages:
    """Return the passages of a place.

    Args:
        walls: [12, W], as in `State.walls`.
        place: [9], as in `State.place`.
        widest: the width from which a passage counts as open floor, m.
    """
    if not len(place) or not place[WALLS]:
        return _passages([], [], [], [], [], [], [], [])
    columns = np.ascontiguousarray(walls[:, : int(place[WALLS])])
    winding, clearance = int(place[WINDING]), float(place[CLEARANCE])
    return _find(columns.tobytes(), columns.shape[1], winding, clearance, widest)


@lru_cache(maxsize=4096)
def _find(content: bytes, count: int, winding: int, clearance: float, widest: float) -> Passages:
    walls = np.frombuffer(content, np.float32).reshape(-1, count).astype(float)
    posts = _gaps(walls, winding, 2.0 * clearance, widest)
    middle = posts.mean(1)
    links = _links(walls, middle, _BEND * widest)
    mouth, outward, width, passage, way = [], [], [], [], []
    length: list[float] = []
    way_passage: list[int] = []
    reachable = np.isfinite(links)
    for group in np.unique([np.flatnonzero(row)[0] for row in reachable]).astype(int):
        members = np.flatnonzero(reachable[group])
        for gap in members:
            along = posts[gap, 1] - posts[gap, 0]
            normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
            ahead = (middle[members] - middle[gap]) @ normal
            for side in (-1.0, 1.0):
                if (side * ahead <= _ROUNDING).all():
                    mouth.append(middle[gap])
                    outward.append(side * normal)
                    width.append(float(np.linalg.norm(along)))
                    passage.append(len(length))
        ways = _straight_ways(middle[members], links[np.ix_(members, members)])
        way += ways
        way_passage += [len(length)] * len(ways)
        length.append(float(links[np.ix_(members, members)].max()))
    ends = zip(mouth, outward, strict=True)
    places = [_queue_places(walls, clearance, *end) for end in ends]
    return _passages(mouth, outward, width, passage, length, places, way, way_passage)


def _passages(
    mouth: list[Points],
    outward: list[Points],
    width: list[float],
    passage: list[int],
    length: list[float],
    places: list[Points],
    way: list[Points],
    way_passage: list[int],
) -> Passages:
    return Passages(
        np.array(mouth).reshape(-1, 2),
        np.array(outward).reshape(-1, 2),
        np.array(width, float),
        np.array(passage, int),
        np.array(length, float),
        places,
        np.array(way, float).reshape(-1, 2, 2),
        np.array(way_passage, int),
    )


def _gaps(walls: Points, winding: int, narrowest: float, widest: float) -> Points:
    """Return the posts of all narrow gaps [G, 2, 2]: the points between which each is."""
    starts = walls[[START_X, START_Y]].T
    corners = np.unique(starts[walls[START_CONVEX] > 0.5], axis=0)
    nearest = _nearest_points(walls, corners)
    width = np.linalg.norm(nearest - corners[:, None], axis=-1)
    corner, wall = np.nonzero((width >= narrowest - _ROUNDING) & (width < widest))
    posts = np.stack([corners[corner], nearest[corner, wall]], 1)
    posts = posts[np.lexsort((posts[:, 0, 1], posts[:, 0, 0]))]
    middle, radius = posts.mean(1), np.linalg.norm(posts[:, 1] - posts[:, 0], axis=-1) / 2
    is_clear = wall_distance(walls, middle) >= radius - _ROUNDING
    is_floor = _winding_number(walls, middle) == winding
    posts = posts[is_clear & is_floor]
    _, first = np.unique(posts.mean(1).round(2), axis=0, return_index=True)
    return posts[np.sort(first)]


def _links(walls: Points, middle: Points, widest: float) -> NDArray[np.float64]:
    """Return the lengths of the narrow ways between gaps, [G, G] m; inf without one."""
    links = np.where(np.eye(len(middle), dtype=bool), 0.0, np.inf)
    for i, a in enumerate(middle):
        for j, b in enumerate(middle[:i]):
            length = float(np.linalg.norm(b - a))
            across = np.array([a[1] - b[1], b[0] - a[0]]) / length
            if _free_length(walls, a[None], (b - a)[None] / length)[0] < length:
                continue
            points = np.linspace(a, b, 3 + int(length / _SAMPLE))[1:-1]
            width = _free_length(walls, points, across[None])
            width += _free_length(walls, points, -across[None])
            if (width < widest).all():
                links[i, j] = links[j, i] = length
    for k in range(len(middle)):  # shortest ways by way of others (Floyd-Warshall)
        links = np.minimum(links, links[:, k, None] + links[None, k])
    return links


def _straight_ways(middle: Points, length: NDArray[np.float64]) -> list[Points]:
    """Return the ends [2, 2] of the straight ways between gaps [G, 2]; one gap is one point.

    `length` [G, G] is that of the shortest ways between them, m.
    """
    if len(middle) == 1:
        return [middle[[0, 0]]]
    pairs = [(i, j) for j in range(len(middle)) for i in range(j)]
    straight = [np.linalg.norm(middle[i] - middle[j]) >= length[i, j] - 1e-9 for i, j in pairs]
    return [middle[list(pair)] for pair, is_way in zip(pairs, straight, strict=True) if is_way]


def _queue_places(walls: Points, clearance: float, mouth: Points, outward: Points) -> Points:
    """Return where robots can wait beside a mouth [Q, 2], nearest first; maybe nowhere.

    The places have clearance and a straight way to the mouth, and are off the funnel before it.
    """
    from_mouth = np.linalg.norm(_nearest_points(walls, mouth) - mouth, axis=-1)
    solid = walls[:, from_mouth < _FARTHEST + 1.0]
    clearance -= _ROUNDING
    x, y = outward
    steps = np.arange(-_FARTHEST, _FARTHEST + 1e-6, _SPACING)
    ahead, aside = np.meshgrid(steps[steps > 0.0], steps, indexing="ij")
    outside = np.stack([ahead * x - aside * y, ahead * y + aside * x], -1).reshape(-1, 2)
    axis = np.clip(ahead.ravel(), 0.0, _FUNNEL_LENGTH)
    off_funnel = np.hypot(ahead.ravel() - axis, aside.ravel()) >= _FUNNEL
    distance = np.linalg.norm(outside, axis=-1)
    outside = outside[off_funnel & (distance <= _FARTHEST)]
    outside = outside[np.argsort(np.linalg.norm(outside, axis=-1), kind="stable")]
    points = mouth + outside
    points = points[wall_distance(solid, points) >= clearance]
    entry = mouth + 2.0 * clearance * outward
    shares = np.linspace(0.0, 1.0, int(_FARTHEST / _SPACING))[:, None]
    ways = entry + shares * (points[:, None] - entry)
    return points[(wall_distance(solid, ways) >= 0.75 * clearance).all(-1)]


def _nearest_points(walls: Points, points: Points) -> Points:
    """Return the nearest points of all walls to points [..., 2], as [..., W, 2]."""
    start, end = walls[[START_X, START_Y]].T, walls[[END_X, END_Y]].T
    along = end - start
    share = ((points[..., None, :] - start) * along).sum(-1) / (along**2).sum(-1)
    return start + np.clip(share, 0.0, 1.0)[..., None] * along


def wall_distance(walls: Points, points: Points) -> NDArray[np.float64]:
    """Return the distances of points [..., 2] to the nearest wall, m."""
    offset = _nearest_points(walls, points) - points[..., None, :]
    return np.sqrt((offset**2).sum(-1).min(-1))


def _free_length(walls: Points, points: Points, along: Points) -> NDArray[np.float64]:
    """Return the distances [B] from points [B, 2] to the first wall along unit vectors, m."""
    start = walls[[START_X, START_Y]].T - points[:, None]
    end = walls[[END_X, END_Y]].T - points[:, None]
    along = along[:, None]
    left, right = _cross(along, start), _cross(along, end)
    crosses = (np.minimum(left, right) < _TOUCH) & (np.maximum(left, right) > -_TOUCH)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _cross(start, end) / _cross(along, end - start)
    return np.where(crosses & (distance > _ROUNDING), distance, np.inf).min(-1)


def _cross(a: Points, b: Points) -> NDArray[np.float64]:
    product: NDArray[np.float64] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _winding_number(walls: Points, points: Points) -> Ints:
    """Return how often the walls go round points [B, 2] counter-clockwise, less clockwise."""
    a = walls[[START_X, START_Y]].T - points[:, None]
    b = walls[[END_X, END_Y]].T - points[:, None]
    side = _cross(a, b)
    upwards = (a[..., 1] <= 0.0) & (b[..., 1] > 0.0) & (side > 0.0)
    downwards = (a[..., 1] > 0.0) & (b[..., 1] <= 0.0) & (side < 0.0)
    number: Ints = upwards.sum(-1) - downwards.sum(-1)
    return number
