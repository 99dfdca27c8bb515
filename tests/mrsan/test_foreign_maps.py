"""Map files as other programs write them: read as they are meant, or refused in one line."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
import yaml
from PIL import Image

from mrsan import Layout, Scenario, World
from mrsan.maps import MapError, load_map, read_map
from mrsan.maps.polygons import covered_area

MAPS = Path(__file__).parents[1] / "data" / "maps"
BOXES = [(0, 1, 3, 2), (1, 0, 2, 3), (9, 9, 10, 10)]
ROOM = {"bounds": [[0, 0], [12, 0], [12, 8], [0, 8]], "obstacles": [[[5, 3], [7, 3], [7, 4]]]}


def floor_area(path: Path) -> float:
    outline, *others = load_map(path)
    solid = [shapely.Polygon(polygon) for polygon in others if len(polygon) > 2]
    return float(shapely.Polygon(outline).difference(shapely.union_all(solid)).area)


def write_grid(folder: Path, **changes) -> Path:
    """A free room of 12 x 8 m with a box of 2 x 1 m; a wall; outside of it all is unknown."""
    grid = np.full((240, 320), 205, np.uint8)
    grid[38:202, 38:282] = 0
    grid[40:200, 40:280] = 254
    grid[120:140, 140:180] = 0
    image = changes.pop("picture", None) or Image.fromarray(grid)
    image.save(folder / "map.png")
    content = {"image": "map.png", "resolution": 0.05, "origin": [-8.0, -6.0, 0.0]}
    content |= {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196} | changes
    path = folder / "map.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_files_of_users() -> None:
    for name, area in {
        "plain.yaml": 94,
        "metres.geojson": 94,
        "z.geojson": 94,
        "bom.geojson": 94,
        "crs_upper.GEOJSON": 94,
        "null_geometry.geojson": 94,
        "negate_string.yaml": 94,
        "negate_false_string.yaml": 94,
        "resolution_5e-2.yaml": 94,
        "thresh_string.yaml": 94,
        "open_0.196.yaml": 96,  # the unexplored outdoors is no floor
        "open_0.25.yaml": 96,
        "open_alpha.yaml": 96,
        "umlaut_utf8.yaml": 96,
    }.items():
        assert floor_area(MAPS / name) == pytest.approx(area, abs=0.5), name


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("dup.yaml", ("'obstacles'", "once")),
        ("cut.yaml", ("cut.pgm", "cannot be read")),
        ("degrees.geojson", ("degrees", "metres")),
        ("irsim.yaml", ("'world'", "GeoJSON", "ROS")),
        ("arena.map", ("GeoJSON", "ROS")),
        ("plan.svg", ("GeoJSON", "ROS")),
    ],
)
def test_refused_files_of_users(name: str, words: tuple[str, ...]) -> None:
    with pytest.raises(MapError) as error:
        load_map(MAPS / name)
    message = str(error.value)
    assert message.startswith(str(MAPS / name))
    assert "\n" not in message
    assert all(word in message for word in words)


def test_every_key_of_a_ros_map_is_obeyed_or_refused(tmp_path: Path) -> None:
    assert floor_area(write_grid(tmp_path)) == pytest.approx(94, abs=0.5)
    for changes in (
        {"mode": "scale"},
        {"negate": "false", "resolution": "5e-2", "origin": ["-8", "-6.0", 0]},
        {"free_thresh": "0.25", "occupied_thresh": 0.65},
    ):
        assert floor_area(write_grid(tmp_path, **changes)) == pytest.approx(94, abs=0.5), changes
    for changes in (
        {"mode": "costmap"},
        {"negate": "perhaps"},
        {"free_thresh": 0.7},  # above occupied_thresh
        {"occupied_thresh": 65},
        {"resolution": 0},
        {"origin": [0, 0, None]},
        {"resolution": "0:05"},
        {"negate": 1, "mode": "raw"},
        {"image": "none.png"},
    ):
        with pytest.raises(MapError, match=next(iter(changes))):
            load_map(write_grid(tmp_path, **changes))


def test_shades_of_a_grid(tmp_path: Path) -> None:
    """The same room in the kinds of pictures that savers write, free cells of different shades."""
    with Image.open(write_grid(tmp_path).with_name("map.png")) as picture:
        grid = np.asarray(picture)
    free, wall, unknown = grid == 254, grid == 0, grid == 205
    for shade in (127, 128, 205):  # of unknown cells
        picture = Image.fromarray(np.where(unknown, shade, grid).astype(np.uint8))
        path = write_grid(tmp_path, picture=picture, free_thresh=0.6)
        assert floor_area(path) == pytest.approx(94, abs=0.5)
    opaque = np.stack([grid, grid, grid, np.where(unknown, 0, 255)], -1).astype(np.uint8)
    opaque[unknown, :3] = 254
    path = write_grid(tmp_path, picture=Image.fromarray(opaque), free_thresh=0.25)
    assert floor_area(path) == pytest.approx(94, abs=0.5)
    deep = Image.fromarray(np.where(free, 65000, 0).astype(np.uint16))
    assert floor_area(write_grid(tmp_path, picture=deep)) == pytest.approx(94, abs=0.5)
    palette = Image.fromarray(grid).convert("P")
    assert floor_area(write_grid(tmp_path, picture=palette)) == pytest.approx(94, abs=0.5)
    dark = Image.fromarray(255 - grid)
    path = write_grid(tmp_path, picture=dark, negate="True", free_thresh=0.25)
    assert floor_area(path) == pytest.approx(94, abs=0.5)
    for levels, white in ((grid, 255), (grid.astype(np.uint16) * 257, 65535)):
        path = write_grid(tmp_path, free_thresh=0.25)
        picture = Image.fromarray(np.where(unknown, white, levels).astype(levels.dtype))
        picture.save(tmp_path / "map.png", transparency=white)
        assert floor_area(path) == pytest.approx(94, abs=0.5)
    percent = np.select([free, wall], [0, 100], 255).astype(np.uint8)
    path = write_grid(tmp_path, picture=Image.fromarray(percent), mode="raw")
    assert floor_area(path) == pytest.approx(94, abs=0.5)


def test_the_crs_of_metres_may_be_wrong_but_not_that_of_degrees(tmp_path: Path) -> None:
    """Some programs state CRS84 whatever the coordinates are."""
    for dx, words in ((0.0, "degrees"), (691000.0, "read as metres")):
        ring = np.add([[0, 0], [12, 0], [12, 8], [0, 8], [0, 0]], (dx, 0.0)).tolist()
        content = {"type": "Polygon", "coordinates": [ring], "crs": {"name": "OGC:1.3:CRS84"}}
        path = tmp_path / "map.geojson"
        path.write_text(json.dumps(content))
        if dx:
            assert words in read_map(path).notes[0]
        else:
            with pytest.raises(MapError, match=words):
                read_map(path)


def test_the_area_of_overlapping_obstacles() -> None:
    cross = [np.array(shapely.box(*sides).exterior.coords)[:-1] for sides in BOXES]
    assert covered_area(cross) == pytest.approx(3 + 3 - 1 + 1)
    random = np.random.default_rng(0)
    for offset in (0.0, 1e6):
        triangles = random.uniform(-5, 5, (40, 3, 2)) + offset
        triangles = [t if shapely.LinearRing(t).is_ccw else t[::-1] for t in triangles]
        union = shapely.union_all([shapely.Polygon(triangle) for triangle in triangles])
        assert covered_area(triangles) == pytest.approx(union.area, abs=1e-6)


def test_maps_far_from_the_origin_give_the_same_world(tmp_path: Path) -> None:
    """Site coordinates, up to 10^7 m from their origin: the same world about the map's middle."""

    def written(dx: float, dy: float) -> list[Path]:
        folder = tmp_path / f"{dx:.0f}"
        folder.mkdir()
        moved = {kind: np.add(points, (dx, dy)).tolist() for kind, points in ROOM.items()}
        plain = folder / "plain.yaml"
        plain.write_text(yaml.safe_dump(moved))
        rings = {"bounds": moved["bounds"], "obstacle": moved["obstacles"][0]}
        features = [
            {
                "type": "Feature",
                "properties": {"kind": kind},
                "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
            }
            for kind, ring in rings.items()
        ]
        geojson = folder / "map.geojson"
        geojson.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
        return [plain, geojson, write_grid(folder, origin=[dx - 8.0, dy - 6.0, 0.0])]

    near = written(0.0, 0.0)
    for far in (written(691000.37, -5334000.81), written(1e7, 1e7 - 3)):
        for here, there in zip(near, far, strict=True):
            states = []
            for path in (here, there):
                scenario = Scenario(layout=Layout.map, map=str(path), robots=2, humans=2)
                world = World(scenario, 2)
                world.reset(np.arange(2))
                states.append(world.state)
                points = np.concatenate(read_map(path).polygons)
                middle = (points.min(0) + points.max(0)) / 2
                np.testing.assert_allclose(scenario.file_origin, middle, rtol=0, atol=1e-8)
            for name in ("walls", "corners", "robot_position", "robot_goal", "human_position"):
                np.testing.assert_array_equal(
                    *(getattr(state, name) for state in states), err_msg=name
                )
