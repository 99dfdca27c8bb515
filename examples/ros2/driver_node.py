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

from samarl.runtime import Driver, InputError, KnownMap

# The robot stops after this time without a message of a kind that it has received before, s.
TIMEOUTS = {"odom": 0.5, "scan": 0.5, "people": 2.0}


class DriverNode(Node):
    """Receives odometry, people, a goal, a map and scans, and publishes velocities."""

    def __init__(self, path: str) -> None:
        """Load the policy, then subscribe to the topics."""
        super().__init__("samarl_driver")
        self._driver = Driver.load(path)
        self._odometry: Odometry | None = None
        self._people: People | None = None  # since the last step
        self._received: dict[str, float] = {}  # when the last message of a kind was measured, s
        self._goal: PoseStamped | None = None
        self._map: KnownMap | None = None
        self._map_frame = ""
        self._map_error = ""  # why the last map cannot be used
        self._scan: LaserScan | None = None
        self._scan_odometry: Odometry | None = None  # where it was taken
        self._out = self.create_publisher(Twist, "cmd_vel", 1)
        self.create_subscription(Odometry, "odom", self._on_odometry, 1)
        self.create_subscription(People, "people", self._on_people, 1)
        self.create_subscription(PoseStamped, "goal_pose", self._on_goal, 1)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(OccupancyGrid, "map", self._on_map, latched)
        self.create_subscription(LaserScan, "scan", self._on_scan, 1)
        self.create_timer(self._driver.scenario.time_step, self._step)

    def _on_odometry(self, message: Odometry) -> None:
        self._odometry, self._received["odom"] = message, seconds(message.header.stamp)

    def _on_people(self, message: People) -> None:
        self._people, self._received["people"] = message, seconds(message.header.stamp)

    def _on_goal(self, message: PoseStamped) -> None:
        self._goal = message
        self._driver.reset()  # a new goal is a new episode

    def _on_map(self, message: OccupancyGrid) -> None:
        self._map_frame, self._map_error = message.header.frame_id, ""
        try:
            self._map = known_map(message, self._driver.scenario.robot_radius + 0.1)
        except ValueError as error:  # MapError, whose module needs further packages
            self._map_error = str(error)

    def _on_scan(self, message: LaserScan) -> None:
        self._scan, self._scan_odometry = message, self._odometry
        self._received["scan"] = seconds(message.header.stamp)

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
        for name, time in self._received.items():
            if now - time > TIMEOUTS[name]:
                raise InputError(
                    f"{name} is {now - time:.1f} s old; it must be below {TIMEOUTS[name]}"
                )
        if self._map_error:
            raise InputError(f"the map cannot be used: it {self._map_error}")
        people, self._people = self._people, None  # use each detection once
        frame = self._odometry.header.frame_id
        frames = {"goal_pose": self._goal.header.frame_id}
        if people is not None:
            frames["people"] = people.header.frame_id
        if self._map is not None:
            frames["map"] = self._map_frame
        for name, other in frames.items():
            if other != frame:
                raise InputError(
                    f"{name} is in frame {other!r}; it must be in {frame!r}, that of the odometry"
                )
        own = own_state(self._odometry, self._goal)
        if arrived(own, self._driver.scenario.robot_radius):
            return 0.0, 0.0
        seen, sensors = (), None
        if self._scan is not None:
            if self._scan_odometry is None:
                raise InputError("scan is older than any odometry; it must follow one")
            seen = scan_walls(self._scan, own_state(self._scan_odometry, self._goal))
        walls, obstacles = seen, ()
        if self._map is not None:
            own, walls, obstacles = self._map.with_route(own), self._map, seen
        if "lidar" in self._driver.sensor_inputs:
            if self._scan is None:
                raise InputError("no scan was received; this policy needs one")
            s = self._driver.scenario
            ranges = lidar_ranges(self._scan, s.lidar_rays, s.lidar_fov_degrees, s.lidar_range)
            sensors = {"lidar": ranges}
        visible = detections(people) if people else []
        command = self._driver.step(own, visible, now, sensors, walls, obstacles)
        if command.reason is not None:
            self.get_logger().debug(f"the shield kept clear of: {command.reason}")
        return velocity(command)


def main() -> None:
    """Drive until interrupted."""
    rclpy.init(args=sys.argv)
    rclpy.spin(DriverNode(sys.argv[1]))


if __name__ == "__main__":
    main()
