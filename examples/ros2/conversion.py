"""Convert between ROS messages and the runtime; any objects with the same fields will do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan.se2 import rotate
from mrsan.sensors.walls import ray_angles
from samarl.runtime import (
    Command,
    Detection,
    InputError,
    KnownMap,
    OwnState,
    measured_ranges,
    walls_of_scan,
)

_FREE_BELOW = 20  # occupancy in percent; unknown cells are -1


def seconds(stamp: Any) -> float:
    """Return a `builtin_interfaces/Time` in seconds."""
    return stamp.sec + 1e-9 * stamp.nanosec


def yaw(orientation: Any) -> float:
    """Return the heading of a `geometry_msgs/Quaternion`, rad."""
    q = orientation
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def own_state(odometry: Any, goal: Any) -> OwnState:
    """Return the robot's state from a `nav_msgs/Odometry` and a `geometry_msgs/PoseStamped`.

    Both must be in the same frame. The twist of the odometry is in the frame of the robot.
    """
    place, heading = odometry.pose.pose.position, yaw(odometry.pose.pose.orientation)
    ahead, left = odometry.twist.twist.linear.x, odometry.twist.twist.linear.y
    velocity = rotate(math.cos(heading), math.sin(heading), ahead, left)
    return OwnState(
        place.x, place.y, heading, *velocity, goal.pose.position.x, goal.pose.position.y
    )


def detections(people: Any, reliability: float = 0.5) -> list[Detection]:
    """Return the people of a `people_msgs/People` with at least this reliability.

    Those without one (0, as many detectors publish, or NaN) are people as well. `name` becomes the
    id unless it is empty. Velocities are in m/s in the frame of the message.
    """
    return [
        Detection(
            person.position.x,
            person.position.y,
            person.velocity.x,
            person.velocity.y,
            id=person.name or None,
        )
        for person in people.people
        if not 0.0 < person.reliability < reliability
    ]


def known_map(grid: Any, clearance: float) -> KnownMap:
    """Return the walls and routes of a `nav_msgs/OccupancyGrid`.

    Unknown cells count as occupied.

    Raises:
        MapError: the grid cannot be used.
    """
    from mrsan.maps import MapError  # here because only maps need its packages

    info = grid.info
    cells = np.asarray(grid.data, np.int16)
    if len(cells) != info.height * info.width:
        size = f"{info.height} x {info.width}"
        raise MapError(f"has {len(cells)} cells; it must have {size}")
    cells = cells.reshape(info.height, info.width)
    free = (cells >= 0) & (cells < _FREE_BELOW)
    position = info.origin.position
    origin = position.x, position.y, yaw(info.origin.orientation)
    return KnownMap.of_grid(free[::-1], info.resolution, origin, clearance)


def scan_angles(scan: Any) -> NDArray[np.float64]:
    """Return the angles of the rays of a `sensor_msgs/LaserScan` to the heading, rad."""
    angles: NDArray[np.float64] = scan.angle_min + scan.angle_increment * np.arange(
        len(scan.ranges)
    )
    return angles


def scan_walls(scan: Any, own: OwnState) -> NDArray[np.float64]:
    """Return the wall segments of a `sensor_msgs/LaserScan`.

    Args:
        scan: the message; the lidar is at the centre of the robot and looks ahead.
        own: the robot at the time of the scan.

    Raises:
        InputError: the message cannot be used.
    """
    return walls_of_scan(scan.ranges, scan_angles(scan), own, scan.range_max, scan.range_min)


def lidar_ranges(
    scan: Any, rays: int, fov_degrees: float, greatest_range: float
) -> NDArray[np.float32]:
    """Return the ranges of a `sensor_msgs/LaserScan` at the rays that a policy observes, m.

    Each ray takes the nearest ray of the scan; where there is none, and where nothing was hit, it
    has the greatest range. It is zero where something is too close to be measured.

    Raises:
        InputError: the message cannot be used.
    """
    ranges, angles = measured_ranges(scan.ranges, scan_angles(scan), scan.range_max, scan.range_min)
    if len(ranges) == 0:
        raise InputError("scan has no ranges; it must have one for each ray")
    observed = ray_angles(rays, fov_degrees)
    away = np.abs((observed[:, None] - angles + math.pi) % (2 * math.pi) - math.pi)
    nearest = away.argmin(1)
    is_covered = away.min(1) <= max(abs(scan.angle_increment), math.radians(fov_degrees) / rays)
    observed_ranges = np.where(is_covered, ranges[nearest], np.inf)
    return np.minimum(observed_ranges, greatest_range).astype(np.float32)


def velocity(command: Command) -> tuple[float, float]:
    """Return the forward speed (m/s) and turn rate (rad/s) for a `geometry_msgs/Twist`."""
    return command.speed, command.turn_rate


def arrived(own: OwnState, radius: float) -> bool:
    """Whether the robot is at its goal, by the definition of the simulator."""
    return math.hypot(own.goal_x - own.x, own.goal_y - own.y) < radius
