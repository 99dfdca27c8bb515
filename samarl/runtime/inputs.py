"""What a robot tells the runtime, checked: a wrong number must not reach the wheels."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple

LARGEST = 1e10  # squares of more are nothing that single precision has; time counts from 1970


class InputError(ValueError):
    """A number that cannot be used; the message says which, and what would be right."""


class OwnState(NamedTuple):
    """The robot and its goal in a frame that stands still, such as the map's or the odometry's.

    To policies that know the middle of the place (`samarl`, `samarl_flat`, `cadrl`) that is the
    frame's origin.
    """

    x: float  # m
    y: float
    heading: float  # rad, counter-clockwise from the x axis
    velocity_x: float  # along the axes of the frame, m/s
    velocity_y: float
    goal_x: float  # m
    goal_y: float


class Detection(NamedTuple):
    """Somebody who is seen now, in the same frame."""

    x: float  # m
    y: float
    velocity_x: float  # m/s
    velocity_y: float
    radius: float = 0.3  # m, as the people in training have
    robot: bool = False  # a team-mate, or a person
    id: Hashable | None = None  # the same from step to step; None: who is near is who was there


def check(own: OwnState, detections: Sequence[Detection], time: float) -> None:
    """Refuse what is no finite number or absurdly large, and names that are given twice.

    Raises:
        InputError: names the field and its value.
    """
    _number("time", time)
    for name, value in zip(OwnState._fields, own, strict=True):
        _number(f"own.{name}", value)
    named: dict[tuple[bool, Hashable], int] = {}
    for k, seen in enumerate(detections):
        for name, value in zip(Detection._fields[:5], seen[:5], strict=True):
            _number(f"detections[{k}].{name}", value)
        if seen.radius <= 0.0:
            raise InputError(f"detections[{k}].radius is {seen.radius}; it must be above 0")
        if seen.id is not None:
            first = named.setdefault((seen.robot, seen.id), k)
            if first != k:
                raise InputError(
                    f"detections[{k}].id is {seen.id!r}, as is detections[{first}].id; ids must "
                    "differ"
                )


def _number(name: str, value: float) -> None:
    try:
        good = abs(value) <= LARGEST  # nan is not
    except TypeError:
        good = False
    if not good:
        raise InputError(f"{name} is {value!r}; it must be a number within +-{LARGEST:g}")
