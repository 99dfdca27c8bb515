"""Maps from files: every format, and every way in which a file can be wrong."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image

from mrsan.maps import MapError, load_map, trace_free_area

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]
BOUNDS = [[-5, -5], [5, -5], [5, 5], [-5, 5]]
U_SHAPE = [[-5, -5], [5, -5], [5, 5], [2, 5], [2, -2], [-2, -2], [-2, 5], [-5, 5]]


def written(tmp_path: Path, content: Any, name: str = "map.yaml") -> Path:
    path = tmp_path / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def is_ccw(polygon: np.ndarray) -> bool:
    return shapely.LinearRing(polygon).is_ccw


@pytest.mark.parametrize("turn", [1, -1])
def test_orientation_does_not_matter_in_yaml(tmp_path: Path, turn: int) -> None:
    content = {
        "bounds": BOUNDS[::turn],
        "obstacles": [SQUARE[::turn]],
        "walls": [[[2, 0], [2, 3], [4, 3]]],
        "scale": 0.5,
    }
    bounds, square, first, second = load_map(written(tmp_path, content))
    assert not is_ccw(bounds)
    assert is_ccw(square)
    assert shapely.Polygon(bounds).area == pytest.approx(25.0)
    assert shapely.Polygon(square).equals(shapely.Polygon(np.array(SQUARE) * 0.5))
    np.testing.assert_allclose(first, [[1, 0], [1, 1.5]])
    np.testing.assert_allclose(second, [[1, 1.5], [2, 1.5]])


def test_geojson(tmp_path: Path) -> None:
    outline = {"type": "Polygon", "coordinates": [[*BOUNDS, BOUNDS[0]], [*SQUARE, SQUARE[0]]]}
    line = {"type": "LineString", "coordinates": [[2, 0], [2, 3]]}
    features = [
        {"type": "Feature", "properties": {"kind": "bounds"}, "geometry": outline},
        {"type": "Feature", "properties": None, "geometry": line},
    ]
    content = {"type": "FeatureCollection", "features": features}
    bounds, square, wall = load_map(written(tmp_path, content, "map.geojson"))
    assert not is_ccw(bounds)
    assert is_ccw(square)
    assert len(square) == 4
    np.testing.assert_allclose(wall, [[2, 0], [2, 3]])


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("{", "line"),
        ({"wall": []}, "'wall'"),
        ({"obstacles": [SQUARE, [[0, 0], [1, "x"], [1, 1]]]}, "obstacles[1]"),
        ({"obstacles": [[[0, 0], [1, 1], [1, 0], [0, 1]]]}, "intersects itself"),
        ({"bounds": BOUNDS, "walls": [[[0, 0], [6, 0]]]}, "[6.0, 0.0]"),
        ({"bounds": U_SHAPE, "walls": [[[-3, 0], [3, 0]]]}, "[-3.0, 0.0] to [3.0, 0.0]"),
        ({"walls": [[[k, 0], [k, 1]] for k in range(129)]}, "258"),
        ({"image": "none.png", "origin": [0, 0, 0]}, "resolution is None"),
        ({"image": "none.png", "resolution": 0.1, "origin": [0, 0, 0]}, "none.png"),
    ],
)
def test_mistakes_are_named(tmp_path: Path, content: Any, named: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(MapError) as error:
        load_map(path)
    assert str(error.value).startswith(str(path))
    assert named in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_a_map_of_ros(tmp_path: Path, negate: int, yaw: float) -> None:
    """A room of 8 x 6 m with a pillar of 1 m: the grid has cells of 0.1 m, unknown outside."""
    grid = np.full((80, 100), 205, np.uint8)
    grid[10:70, 10:90] = 254
    grid[30:40, 50:60] = 0
    Image.fromarray(255 - grid if negate else grid).save(tmp_path / "map.png")
    content = {"image": "map.png", "resolution": 0.1, "origin": [-5, -4, yaw], "negate": negate}
    content |= {"occupied_thresh": 0.65, "free_thresh": 0.19 if negate else 0.196}
    path = tmp_path / "map.yaml"
    path.write_text(yaml.safe_dump(content))
    bounds, pillar = load_map(path)
    assert not is_ccw(bounds)
    assert is_ccw(pillar)

    def placed(left: float, bottom: float, right: float, top: float) -> shapely.Polygon:
        box = shapely.box(left + 5, bottom + 4, right + 5, top + 4)
        turned = shapely.affinity.rotate(box, yaw, origin=(0, 0), use_radians=True)
        return shapely.affinity.translate(turned, -5, -4)

    for polygon, expected in ((bounds, placed(-4, -3, 4, 3)), (pillar, placed(0, 0, 1, 1))):
        ring = shapely.LinearRing(polygon)
        assert shapely.hausdorff_distance(ring, expected.exterior) < 0.08  # less than a cell


def test_no_obstacle_of_a_grid_is_too_small() -> None:
    """Where they are smaller than its outline is exact, they are thin walls."""
    free = np.ones((200, 400), bool)
    cells = [(20 * row, 40 * column) for row in range(1, 9) for column in range(1, 9)]
    for size in ((1, 1), (1, 4), (2, 2), (3, 3)):
        marked = free.copy()
        for row, column in cells:
            marked[row : row + size[0], column : column + size[1]] = False
        _, *obstacles = trace_free_area(marked, 0.05, (0.0, 0.0, 0.0))
        places = shapely.MultiPoint([(0.05 * c, 0.05 * (200 - r)) for r, c in cells])
        outlines = shapely.MultiLineString([polygon.tolist() for polygon in obstacles])
        assert len(obstacles) == len(cells)
        assert places.hausdorff_distance(outlines) < 0.25
    single = ~free
    single[5, 5] = True
    with pytest.raises(MapError, match=r"free area"):
        trace_free_area(single, 0.05, (0.0, 0.0, 0.0))
