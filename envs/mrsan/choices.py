"""The named choices of a scenario; except for `Crowd`, values are the numbers of the kernels."""

from __future__ import annotations

from enum import Enum, StrEnum

from mrsan.kernels import kinematics as kinematics_kernel
from mrsan.kernels import layout as layout_kernel
from mrsan.kernels import reactions as reactions_kernel
from mrsan.kernels import team as team_kernel


class Crowd(StrEnum):
    """The built-in crowd models; `mrsan.register_crowd` adds others."""

    orca = "orca"
    social_force = "social_force"
    still = "still"
    recorded = "recorded"  # people of a file; of more than `humans`, the nearest


class Layout(Enum):
    """Where agents start and go."""

    circle = layout_kernel.CIRCLE  # across a circle: SAMARL
    crossing = layout_kernel.CROSSING  # people in two streams at right angles
    opposite = layout_kernel.OPPOSITE  # people in two streams along one band
    square = layout_kernel.SQUARE  # people anywhere on a square floor
    mixed = layout_kernel.MIXED  # one of these four, drawn per episode
    doorway = layout_kernel.DOORWAY  # two rooms with an opening in the wall between them
    corridor = layout_kernel.CORRIDOR  # two rooms joined by a corridor
    intersection = layout_kernel.INTERSECTION  # four arms
    corner = layout_kernel.CORNER  # two arms with a blind corner
    rooms = layout_kernel.ROOMS  # a grid of rooms with doors
    pillars = layout_kernel.PILLARS  # a floor with boxes and round pillars
    places = layout_kernel.PLACES  # one of these six, drawn per episode
    map = layout_kernel.MAP  # anywhere on the floor of `Scenario.map`

    @property
    def has_walls(self) -> bool:
        """Return whether it is a place with walls."""
        return self.value > layout_kernel.MIXED


class CrowdReaction(Enum):
    """How people react to robots."""

    blind = 0  # they ignore robots: SAMARL
    reciprocal = 1  # everybody avoids robots as people
    mixed = 2  # a `Reaction` drawn per person, with the shares of `Scenario.reactions`


class Reaction(Enum):
    """How one person reacts to robots; all but `blind` are those of HuNavSim."""

    blind = reactions_kernel.BLIND  # ignores robots
    regular = reactions_kernel.REGULAR  # avoids robots as people
    impassive = reactions_kernel.IMPASSIVE  # avoids robots as if they stood still
    surprised = reactions_kernel.SURPRISED  # stops for a while
    curious = reactions_kernel.CURIOUS  # approaches the robot and looks at it for a while
    scared = reactions_kernel.SCARED  # slows down and keeps far away
    threatening = reactions_kernel.THREATENING  # blocks the robot's way for a while


class LidarTargets(Enum):
    """What stops the rays of a lidar."""

    walls = 0
    all = 1  # also people and robots


class TeamPerception(Enum):
    """What robots report to each other."""

    none = team_kernel.NONE  # nothing: SAMARL
    tracks = team_kernel.TRACKS  # the agents they see, and their own poses


class Kinematics(Enum):
    """What an action means to a robot."""

    acceleration_heading = kinematics_kernel.ACCELERATION_HEADING  # SAMARL, Eq. 1-3
    holonomic = kinematics_kernel.HOLONOMIC  # a velocity in the body frame
    unicycle = kinematics_kernel.UNICYCLE  # a forward speed and a heading change


ACTION_SIZE = {  # numbers per action
    Kinematics.acceleration_heading: 3,
    Kinematics.holonomic: 2,
    Kinematics.unicycle: 2,
}
