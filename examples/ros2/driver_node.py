"""A ROS 2 node that drives with an exported policy: `python driver_node.py policy.onnx`."""

from __future__ import annotations

import sys

import rclpy
from conversion import (
    arrived,
    detections,
    known_map,
    lidar_ranges,
    own_state,
    scan_walls,
    seconds,
    velocity,
)
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from people_msgs.msg import People
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan

from mrsan.maps import MapError
from samarl.runtime import Driver, InputError, KnownMap

ODOMETRY_TIMEOUT = 0.5  # the robot stops after this time without odometry, s


class DriverNode(Node):
    """Receives odometry, people, a goal, a map and scans, and publishes velocities."""

    def __init__(self, path: str) -> None:
        """Load the policy, then subscribe to the topics."""
        super().__init__("samarl_driver")
        self._driver = Driver.load(path)
        self._odometry: Odometry | None = None
        self._people: People | None = None  # since the last step
        self._goal: PoseStamped | None = None
        self._map: KnownMap | None = None
        self._scan: LaserScan | None = None
        self._out = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(Odometry, "odom", self._on_odometry, 1)
        self.create_subscription(People, "people", self._on_people, 1)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 1)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(OccupancyGrid, "map", self._on_map, latched)
        self.create_subscription(LaserScan, "scan", self._on_scan, 1)
        self.create_timer(self._driver.scenario.time_step, self._step)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry = message

    def _on_people(self, message: People) -> None:
        self._people = message

    def _on_goal(self, message: PoseStamped) -> None:
        self._goal = message
        self._driver.reset()  # a new goal is a new episode

    def _on_map(self, message: OccupancyGrid) -> None:
        try:
            self._map = known_map(message, self._driver.scenario.robot_radius + 0.1)
        except MapError as error:
            self.get_logger().error(f"the map cannot be used: it {error}")

    def _on_scan(self, message: LaserScan) -> None:
        self._scan = message

    def _step(self) -> None:
        twist = Twist()  # zero: stop
        try:
            twist.linear.x, twist.angular.z = self._decision()
        except InputError as error:
            self.get_logger().error(f"stopped: {error}")
        self._out.publish(twist)

    def _decision(self) -> tuple[float, float]:
        if self._goal is None or self._odometry is None:
            return 0.0, 0.0
        now = self.get_clock().now().nanoseconds * 1e-9
        if now - seconds(self._odometry.header.stamp) > ODOMETRY_TIMEOUT:
            raise InputError(f"no odometry was received for {ODOMETRY_TIMEOUT} s")
        people, self._people = self._people, None  # use each detection once
        frame = self._odometry.header.frame_id
        for name, message in (("goal_pose", self._goal), ("people", people)):
            if message is not None and message.header.frame_id != frame:
                raise InputError(
                    f"{name} is in frame {message.header.frame_id!r}; it must be in {frame!r}, the "
                    "frame of the odometry"
                )
        own = own_state(self._odometry, self._goal)
        if arrived(own, self._driver.scenario.robot_radius):
            return 0.0, 0.0
        walls, sensors = (), None
        if self._map is not None:
            own, walls = self._map.with_route(own), self._map
        elif self._scan is not None:
            walls = scan_walls(self._scan, own)
        if "lidar" in self._driver.sensor_inputs:
            if self._scan is None:
                raise InputError("no scan was received; this policy needs one")
            s = self._driver.scenario
            ranges = lidar_ranges(self._scan, s.lidar_rays, s.lidar_fov_degrees, s.lidar_range)
            sensors = {"lidar": ranges}
        seen = detections(people) if people else []
        return velocity(self._driver.step(own, seen, now, sensors, walls))


def main() -> None:
    """Drive until interrupted."""
    rclpy.init(args=sys.argv)
    rclpy.spin(DriverNode(sys.argv[1]))


if __name__ == "__main__":
    main()
