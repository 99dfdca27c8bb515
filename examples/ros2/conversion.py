"""Between ROS messages and the runtime, without ROS: any object with the same fields will do."""

from __future__ import annotations

import math
from typing import Any

from mrsan.se2 import rotate
from samarl.runtime import Command, Detection, OwnState


def seconds(stamp: Any) -> float:
    """Of a `builtin_interfaces/Time`, s."""
    return stamp.sec + 1e-9 * stamp.nanosec


def yaw(orientation: Any) -> float:
    """The heading of a `geometry_msgs/Quaternion`, rad."""
    q = orientation
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))


def own_state(odometry: Any, goal: Any) -> OwnState:
    """Of a `nav_msgs/Odometry` and a `geometry_msgs/PoseStamped` in the same frame.

    The twist of an odometry is in the frame of the robot.
    """
    place, heading = odometry.pose.pose.position, yaw(odometry.pose.pose.orientation)
    ahead, left = odometry.twist.twist.linear.x, odometry.twist.twist.linear.y
    velocity = rotate(math.cos(heading), math.sin(heading), ahead, left)
    return OwnState(
        place.x, place.y, heading, *velocity, goal.pose.position.x, goal.pose.position.y
    )


def detections(people: Any, reliability: float = 0.5) -> list[Detection]:
    """Of a `people_msgs/People`: those that are sure enough; `name` is the id, if there is one.

    Its velocities are per second in the frame of the message.
    """
    return [
        Detection(
            person.position.x, person.position.y, person.velocity.x, person.velocity.y,
            id=person.name or None,
        )
        for person in people.people
        if person.reliability >= reliability
    ]  # fmt: skip


def velocity(command: Command) -> tuple[float, float]:
    """Forward speed (m/s) and turn rate (rad/s) of a `geometry_msgs/Twist`."""
    return command.speed, command.turn_rate


def arrived(own: OwnState, radius: float) -> bool:
    """Whether the robot is at its goal, as the simulator judges."""
    return math.hypot(own.goal_x - own.x, own.goal_y - own.y) < radius
