"""Drives of robots: where their wheels are, and how fast they turn for a velocity of the base."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Kinematics, Scenario

_LARGEST_WHEEL = 0.1  # radius, m


@dataclass(frozen=True)
class Wheel:
    """A driven sphere that rolls on the floor.

    A wheel of a differential drive turns about its axle. A mecanum wheel pushes along the axes of
    its rollers and rolls freely across; a sphere on a ball joint, driven about one axis, does the
    same without the rollers.
    """

    x: float  # of its centre in the frame of the base, m
    y: float
    axis: tuple[float, float]  # unit vector about which the motor turns it, horizontal
    is_free: bool  # it rolls freely about all other axes
    gearing: float = 1.0  # torque about `axis` over the torque of the motor

    def speeds(self, radius: float) -> tuple[float, float, float]:
        """Return the spin for 1 m/s ahead, 1 m/s to the left and 1 rad/s of the base, rad/s."""
        push_x, push_y = self.axis[1], -self.axis[0]  # where it rolls to
        turn = self.x * push_y - self.y * push_x
        return push_x / radius, push_y / radius, turn / radius


@dataclass(frozen=True)
class Drive:
    """The wheels of a robot."""

    wheel_radius: float  # m
    wheels: tuple[Wheel, ...]
    casters: tuple[float, ...]  # positions of frictionless casters along the robot's axis, m

    @property
    def wheel_speeds(self) -> NDArray[np.float64]:
        """Return the matrix [W, 3] from velocities of the base (m/s, m/s, rad/s) to spins."""
        return np.array([wheel.speeds(self.wheel_radius) for wheel in self.wheels])


def drive_of(scenario: Scenario) -> Drive:
    """Return the drive that suits the kinematics of a scenario.

    Holonomic robots have four mecanum wheels. All others always move along their heading, also
    with SAMARL's lateral acceleration (Eq. 2 and 3), so a differential drive suffices.
    """
    radius = min(_LARGEST_WHEEL, scenario.robot_radius / 3)
    reach = scenario.robot_radius - radius  # wheels stay within the disc
    if scenario.kinematics is Kinematics.holonomic:
        return Drive(radius, _mecanum_wheels(reach / math.sqrt(2.0)), ())
    wheels = tuple(Wheel(0.0, side * reach, (0.0, 1.0), False) for side in (1.0, -1.0))
    return Drive(radius, wheels, (reach, -reach))


def _mecanum_wheels(offset: float) -> tuple[Wheel, ...]:
    """Return four wheels at (+-offset, +-offset) that push at right angles to their position.

    The rollers stand at 45 degrees to the wheel, so the wheel pushes with sqrt(2) times the force
    and 1 / sqrt(2) of the speed at its rim.
    """
    diagonal = math.sqrt(0.5)
    wheels = []
    for ahead in (1.0, -1.0):
        for left in (1.0, -1.0):
            axis = (ahead * left * diagonal, diagonal)  # pushes along (axis_y, -axis_x)
            wheels.append(Wheel(ahead * offset, left * offset, axis, True, math.sqrt(2.0)))
    return tuple(wheels)
