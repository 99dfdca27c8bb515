"""The geometry of walls against shapely, on random maps: contacts, sight and lidar agree."""

import numpy as np
import pytest
import shapely
from numba import njit

from mrsan.kernels.walls import (
    START_X,
    START_Y,
    WALL_ROWS,
    close_polygon,
    is_clear,
    sees,
    wall_distance,
    winding_number,
)

BORDER = 1e-4  # m; nearer decisions are left to rounding


@njit
def walls_of(vertices, lengths):
    walls = np.zeros((WALL_ROWS, len(vertices)), np.float32)
    walls[START_X], walls[START_Y] = vertices[:, 0], vertices[:, 1]
    first = 0
    for length in lengths:
        close_polygon(walls, first, first + length)
        first += length
    return walls


@njit
def decide(walls, ways, radius):
    n = len(ways)
    clear, seen, distance = np.empty(n, np.bool_), np.empty(n, np.bool_), np.empty(n, np.float32)
    winding = np.empty(n, np.int64)
    for k in range(n):
        x, y, dx, dy = ways[k]
        clear[k] = is_clear(walls, walls.shape[1], x, y, dx, dy, radius[k])
        seen[k] = sees(walls, walls.shape[1], x, y, dx, dy)
        distance[k] = wall_distance(walls, walls.shape[1], x, y)
        winding[k] = winding_number(walls, walls.shape[1], x, y)
    return clear, seen, distance, winding


def random_map(rng: np.random.Generator) -> list[np.ndarray]:
    """A clockwise outline, some counter-clockwise convex polygons and some thin walls."""
    polygons = [np.array([(-6, -6), (-6, 6), (6, 6), (6, -6)], np.float32)]
    for _ in range(5):
        angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 7))))
        if np.diff(angles, append=angles[0] + 2 * np.pi).max() > np.pi - 0.3:
            continue
        circle = rng.uniform(0.3, 1.5) * np.stack([np.cos(angles), np.sin(angles)], -1)
        polygons.append((rng.uniform(-4, 4, 2) + circle).astype(np.float32))
    for _ in range(3):
        polygons.append(rng.uniform(-5, 5, (2, 2)).astype(np.float32))
    return polygons


def lines_of(polygons: list[np.ndarray]) -> shapely.Geometry:
    return shapely.union_all(
        [shapely.LineString(p if len(p) == 2 else [*p, p[0]]) for p in polygons]
    )


@pytest.mark.parametrize("seed", range(20))
def test_they_decide_as_shapely_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygons = random_map(rng)
    walls = walls_of(np.concatenate(polygons), np.array([len(p) for p in polygons]))
    ways = rng.uniform(-5.5, 5.5, (2000, 4)).astype(np.float32)
    ways[::2, 2:] *= 0.05  # half of them short
    radius = rng.uniform(0.1, 1.0, len(ways)).astype(np.float32)
    clear, seen, distance, winding = decide(walls, ways, radius)

    lines = lines_of(polygons)
    starts, ends = ways[:, :2].astype(float), (ways[:, :2] + ways[:, 2:]).astype(float)
    gap = shapely.distance(shapely.linestrings(np.stack([starts, ends], 1)), lines)
    certain = abs(gap - radius) > BORDER
    np.testing.assert_array_equal(clear[certain], (gap > radius)[certain])
    certain = (gap > BORDER) | (gap == 0)
    assert (seen != (gap > 0))[certain].mean() < 1e-3  # ways that just touch an end of a wall
    points = shapely.points(starts)
    np.testing.assert_allclose(distance, shapely.distance(points, lines), atol=BORDER)
    solid = [shapely.Polygon(p) for p in polygons[1:] if len(p) > 2]
    expected = -shapely.contains(shapely.Polygon(polygons[0]), points).astype(int)
    for polygon in solid:
        expected += shapely.contains(polygon, points)
    certain = shapely.distance(points, lines) > BORDER
    np.testing.assert_array_equal(winding[certain], expected[certain])
