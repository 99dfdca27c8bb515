"""Convert between ROS messages and the runtime; any objects with the same fields will do."""

from __future__ import annotations

import math
from typing import Any

from mrsan.se2 import rotate
from samarl.runtime import Command, Detection, OwnState


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

    `name` becomes the id unless it is empty. Velocities are in m/s in the frame of the message.
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
        if person.reliability >= reliability
    ]


def velocity(command: Command) -> tuple[float, float]:
    """Return the forward speed (m/s) and turn rate (rad/s) for a `geometry_msgs/Twist`."""
    return command.speed, command.turn_rate


def arrived(own: OwnState, radius: float) -> bool:
    """Whether the robot is at its goal, by the definition of the simulator."""
    return math.hypot(own.goal_x - own.x, own.goal_y - own.y) < radius
