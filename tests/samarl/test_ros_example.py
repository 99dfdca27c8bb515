"""What the ROS 2 example does with messages; a message is anything with its fields."""

import math
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from samarl.runtime import Command, Detection, OwnState

FOLDER = Path(__file__).parents[2] / "examples/ros2"


@pytest.fixture
def conversion(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(FOLDER))
    return import_module("conversion")


def message(fields: Any) -> Any:
    """Nested dictionaries as an object."""
    if isinstance(fields, dict):
        return SimpleNamespace(**{name: message(value) for name, value in fields.items()})
    return [message(one) for one in fields] if isinstance(fields, list) else fields


def test_odometry_and_goal(conversion: ModuleType) -> None:
    # It heads along y, 90 degrees to the left, and drives ahead at 0.5 m/s, to the left at 0.1.
    half = math.sqrt(0.5)
    odometry = message(
        {
            "pose": {
                "pose": {
                    "position": {"x": 1.0, "y": 2.0, "z": 0.0},
                    "orientation": {"x": 0.0, "y": 0.0, "z": half, "w": half},
                }
            },
            "twist": {"twist": {"linear": {"x": 0.5, "y": 0.1, "z": 0.0}}},
        }
    )
    goal = message({"pose": {"position": {"x": 1.0, "y": 2.2, "z": 0.0}}})
    own = conversion.own_state(odometry, goal)
    assert own == pytest.approx(OwnState(1.0, 2.0, math.pi / 2, -0.1, 0.5, 1.0, 2.2))
    assert conversion.arrived(own, 0.3)
    assert not conversion.arrived(own, 0.1)


def test_people(conversion: ModuleType) -> None:
    def person(name: str, reliability: float) -> dict[str, Any]:
        place, moves = {"x": 3.0, "y": 4.0, "z": 1.7}, {"x": -1.0, "y": 0.5, "z": 0.0}
        return {"name": name, "reliability": reliability, "position": place, "velocity": moves}

    seen = message({"people": [person("7", 0.9), person("", 0.9), person("8", 0.2)]})
    there = Detection(3.0, 4.0, -1.0, 0.5)
    assert conversion.detections(seen) == [there._replace(id="7"), there]


def test_time_and_velocity(conversion: ModuleType) -> None:
    assert conversion.seconds(message({"sec": 12, "nanosec": 250_000_000})) == 12.25
    command = Command(np.zeros(3, np.float32), 1.0, 0.0, 0.1, 0.7, 0.4, False)
    assert conversion.velocity(command) == (0.7, 0.4)


def test_an_occupancy_grid_gives_walls_and_a_route(conversion: ModuleType) -> None:
    cells = np.zeros((160, 240), int)  # 12 x 8 m, the bottom row first
    cells[:120, 119:121] = 100  # a partition with a way round at the top
    cells[0, 0] = -1  # unknown
    grid = message(
        {
            "info": {
                "height": 160,
                "width": 240,
                "resolution": 0.05,
                "origin": {
                    "position": {"x": -6.0, "y": -4.0},
                    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            }
        }
    )
    grid.data = cells.ravel().tolist()
    known = conversion.known_map(grid, 0.4)
    own = known.with_route(OwnState(-3.0, 0.0, 0.0, 0.0, 0.0, 3.0, 0.0))
    assert own.next_x == pytest.approx(-0.45, abs=0.1)
    assert own.next_y == pytest.approx(2.4, abs=0.2)


def test_a_scan_gives_walls_and_the_rays_of_a_policy(conversion: ModuleType) -> None:
    """Between two walls along x, 1 m to the left and 2 m to the right; it heads along x."""
    angles = np.radians(np.arange(-180, 180))
    with np.errstate(divide="ignore"):
        ranges = np.where(angles > 0, 1.0, -2.0) / np.sin(angles)
    scan = message({"angle_min": -math.pi, "angle_increment": math.radians(1), "range_max": 8.0})
    scan.ranges = np.where((ranges > 0) & (ranges < 8.0), ranges, np.inf).tolist()
    own = OwnState(5.0, 5.0, 0.0, 0.0, 0.0, 9.0, 5.0)
    walls = conversion.scan_walls(scan, own)
    heights = np.unique(walls[:, [1, 3]].round(3))
    assert heights.tolist() == [3.0, 6.0]
    rays = conversion.lidar_ranges(scan, 4, 360.0, 6.0)  # behind, right, ahead, left
    assert rays.tolist() == pytest.approx([6.0, 2.0, 6.0, 1.0], abs=1e-5)
    ahead = conversion.lidar_ranges(scan, 3, 90.0, 6.0)  # 45 degrees to the right, ahead, left
    assert ahead.tolist() == pytest.approx([2 * math.sqrt(2), 6.0, math.sqrt(2)], abs=1e-5)


def test_ros_is_asked_for_by_the_node_alone() -> None:
    ros = ("rclpy", "_msgs")
    importing = {
        path.name
        for path in FOLDER.parent.rglob("*.py")
        for line in path.read_text().splitlines()
        if line.startswith(("import ", "from ")) and any(word in line for word in ros)
    }
    assert importing == {"driver_node.py"}
