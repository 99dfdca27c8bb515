"""What the ROS 2 example does with messages; a message is anything with its fields."""

import math
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from mrsan.maps import MapError
from samarl.runtime import Detection, Driver, InputError, KnownMap, OwnState

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

    # Many detectors leave the reliability at zero: they did not say that nobody is there.
    unknown = [person("9", 0.0), person("10", math.nan)]
    seen = message({"people": [person("7", 0.9), person("", 0.9), person("8", 0.2)]})
    seen.people += [message(one) for one in unknown]
    ids = [detection.id for detection in conversion.detections(seen)]
    assert ids == ["7", None, "9", "10"]
    assert conversion.detections(seen)[1] == Detection(3.0, 4.0, -1.0, 0.5)


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
    grid.data = grid.data[1:]
    with pytest.raises(MapError, match=r"38399.*160 x 240"):
        conversion.known_map(grid, 0.4)


def test_a_scan_gives_walls_and_the_rays_of_a_policy(conversion: ModuleType) -> None:
    """Between two walls along x, 1 m to the left and 2 m to the right; it heads along x."""
    angles = np.radians(np.arange(-180, 180))
    with np.errstate(divide="ignore"):
        ranges = np.where(angles > 0, 1.0, -2.0) / np.sin(angles)
    scan = message({"angle_min": -math.pi, "angle_increment": math.radians(1), "range_max": 8.0})
    scan.range_min = 0.1
    scan.ranges = np.where((ranges > 0) & (ranges < 8.0), ranges, np.inf).tolist()
    own = OwnState(5.0, 5.0, 0.0, 0.0, 0.0, 9.0, 5.0)
    walls = conversion.scan_walls(scan, own)
    heights = np.unique(walls[:, [1, 3]].round(3))
    assert heights.tolist() == [3.0, 6.0]
    rays = conversion.lidar_ranges(scan, 4, 360.0, 6.0)  # behind, right, ahead, left
    assert rays.tolist() == pytest.approx([6.0, 2.0, 6.0, 1.0], abs=1e-5)
    ahead = conversion.lidar_ranges(scan, 3, 90.0, 6.0)  # 45 degrees to the right, ahead, left
    assert ahead.tolist() == pytest.approx([2 * math.sqrt(2), 6.0, math.sqrt(2)], abs=1e-5)
    # Zero and NaN are no return; minus infinity and 5 cm are nearer than the lidar can measure.
    for value, expected in ((0.0, 6.0), (math.nan, 6.0), (-math.inf, 0.0), (0.05, 0.0)):
        scan.ranges = [value] * 360
        assert conversion.lidar_ranges(scan, 4, 360.0, 6.0).tolist() == [expected] * 4
    scan.ranges = []
    with pytest.raises(InputError, match="scan has no ranges"):
        conversion.lidar_ranges(scan, 4, 360.0, 6.0)


@pytest.fixture
def node(conversion: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The node with a clock at 100 s, on a driver that notes its inputs and drives at 1 m/s."""
    ros = {
        "rclpy": [],
        "rclpy.node": [],
        "rclpy.qos": ["DurabilityPolicy", "QoSProfile"],
        "geometry_msgs.msg": ["PoseStamped", "Twist"],
        "nav_msgs.msg": ["OccupancyGrid", "Odometry"],
        "people_msgs.msg": ["People"],
        "sensor_msgs.msg": ["LaserScan"],
    }
    for name, classes in ros.items():
        module = ModuleType(name)
        vars(module).update((one, MagicMock()) for one in classes)
        monkeypatch.setitem(sys.modules, name, module)
    clock = MagicMock()
    clock.return_value.now.return_value.nanoseconds = 100 * 10**9
    methods = ("create_publisher", "create_subscription", "create_timer", "get_logger")
    fake = {name: MagicMock() for name in methods} | {"__init__": lambda *_: None}
    sys.modules["rclpy.node"].Node = type("Node", (), fake | {"get_clock": clock})  # type: ignore[attr-defined]
    monkeypatch.setattr(Driver, "load", MagicMock())
    monkeypatch.delitem(sys.modules, "driver_node", raising=False)
    node = import_module("driver_node").DriverNode("policy.onnx")
    monkeypatch.delitem(sys.modules, "driver_node")
    node._driver.scenario.robot_radius = 0.3
    node._driver.step.return_value.speed = node._driver.step.return_value.turn_rate = 1.0
    return node


def stamped(time: float, frame: str = "odom") -> dict[str, Any]:
    stamp = {"sec": int(time), "nanosec": round(1e9 * (time - int(time)))}
    return {"header": {"stamp": stamp, "frame_id": frame}}


def test_the_node_stops_on_old_messages_and_avoids_what_is_not_on_its_map(node: Any) -> None:
    pose = {
        "position": {"x": 1e7, "y": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    twist = {"linear": {"x": 0.0, "y": 0.0}}
    still = {"pose": {"pose": pose}, "twist": {"twist": twist}}
    goal = message(stamped(90.0) | {"pose": {"position": {"x": 1e7 + 5.0, "y": 0.0}}})
    scan = message(stamped(99.9) | {"angle_min": 0.0, "angle_increment": 0.1, "ranges": []})
    scan.ranges, scan.range_min, scan.range_max = [2.0, math.inf], 0.1, 8.0
    node._on_goal(goal)
    assert node._decision() == (0.0, 0.0)  # no odometry
    node._on_odometry(message(stamped(99.9) | still))
    node._on_scan(scan)
    assert node._decision() == (1.0, 1.0)
    assert node._driver.step.call_args[0][4].tolist() == [[1e7 + 2.0, 0.0] * 2]
    cells = {"height": 40, "width": 40, "resolution": 0.5}
    info = cells | {"origin": pose | {"position": {"x": 1e7 - 10.0, "y": -10.0}}}
    grid = message(stamped(1.0) | {"info": info})
    grid.data = [0] * 1600
    node._on_map(grid)
    assert node._decision() == (1.0, 1.0)
    walls, obstacles = node._driver.step.call_args[0][4:]
    assert isinstance(walls, KnownMap)
    assert obstacles.tolist() == [[1e7 + 2.0, 0.0] * 2]
    node._on_people(message(stamped(97.0) | {"people": []}))
    with pytest.raises(InputError, match=r"people is 3\.0 s old"):
        node._decision()
    node._on_people(message(stamped(99.0) | {"people": []}))
    scan.header = message(stamped(99.0)["header"])
    node._on_scan(scan)
    with pytest.raises(InputError, match=r"scan is 1\.0 s old"):
        node._decision()
    scan.header = message(stamped(99.9)["header"])
    node._on_scan(scan)
    node._on_map(message(stamped(1.0) | {"info": info, "data": []}))
    with pytest.raises(InputError, match=r"the map cannot be used: .*0 cells.*40 x 40"):
        node._decision()
    grid.header.frame_id = "map"
    node._on_map(grid)
    with pytest.raises(InputError, match=r"map is in frame 'map'.*'odom'"):
        node._decision()
