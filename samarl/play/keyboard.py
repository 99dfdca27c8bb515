"""Driving a robot by keys."""

from __future__ import annotations

import math
from collections.abc import Collection

from mrsan import Kinematics, Scenario
from mrsan.se2 import unrotate

KEYS = ("up", "down", "left", "right")
_ACCELERATION, _BRAKING = 1.0, 2.0  # of the keys, m/s^2


def keyboard_action(
    keys: Collection[str], speed: float, heading: float, scenario: Scenario
) -> tuple[float, ...]:
    """Return the action [A] of pressed keys.

    Up and down change the speed, left and right turn. Holonomic robots drive in the direction on
    the screen instead.

    Args:
        keys: some of `KEYS`.
        speed: of the robot, m/s.
        heading: of the robot, rad.
        scenario: the kinematics and their limits.
    """
    ahead = ("up" in keys) - ("down" in keys)
    left = ("left" in keys) - ("right" in keys)
    if scenario.kinematics is Kinematics.holonomic:
        norm = max(math.hypot(ahead, left), 1.0)
        x, y = unrotate(math.cos(heading), math.sin(heading), -left / norm, ahead / norm)
        return _clipped(x), _clipped(y)
    acceleration = _ACCELERATION if ahead > 0 else ahead * _BRAKING
    if scenario.kinematics is Kinematics.unicycle:
        new_speed = speed + acceleration * scenario.time_step
        return _clipped(2.0 * new_speed / scenario.robot_speed - 1.0), float(left)
    return _clipped(acceleration / scenario.max_acceleration), 0.0, float(left)


def _clipped(value: float) -> float:
    return round(min(max(float(value), -1.0), 1.0), 4)
