"""The inputs of `Driver.step`, validated: no invalid number may reach the wheels."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FASTEST = 100.0  # agent; faster ones are in other units and would be predicted far away, m/s
LARGEST = 1e10  # squares of larger numbers overflow single precision; Unix time is below it


class InputError(ValueError):
    """An input that cannot be used; the message names the field, its value and what is allowed."""


class OwnState(NamedTuple):
    """The robot and its goal in a fixed frame, such as the map's or the odometry's.

    The origin of the frame may be anywhere.
    """

    x: float  # m
    y: float
    heading: float  # rad, counter-clockwise from the x axis
    velocity_x: float  # along the axes of the frame, m/s
    velocity_y: float
    goal_x: float  # m
    goal_y: float
    next_x: float | None = None  # next corner of the path round walls to the goal, m; None: none
    next_y: float | None = None


class Detection(NamedTuple):
    """A person or team-mate that is currently visible, in the same frame as `OwnState`."""

    x: float  # m
    y: float
    velocity_x: float  # m/s
    velocity_y: float
    radius: float = 0.3  # m; the radius of people in training
    robot: bool = False  # true: a team-mate; false: a person
    id: Hashable | None = None  # constant over time; None: matched by position


def validated(
    own: OwnState, detections: Iterable[Detection], time: float
) -> tuple[OwnState, list[Detection], float]:
    """Check the inputs of one step and convert them to built-in types.

    Args:
        own: the robot's state.
        detections: any iterable; it is consumed exactly once.
        time: of the measurement, s.

    Returns:
        The same values with every number a `float`, every flag a `bool`, and detections in a list.

    Raises:
        InputError: an input has the wrong type, is not finite, is too large, or an id occurs twice.
    """
    own = validated_own(own)
    try:
        iterator = iter(detections)
    except TypeError:
        raise InputError(
            f"detections is {shown(detections)}; it must be an iterable of Detection"
        ) from None
    time = validated_number("time", time)
    people = [_detection(f"detections[{k}]", value) for k, value in enumerate(iterator)]
    first_with_id: dict[tuple[bool, Hashable], int] = {}
    for k, detection in enumerate(people):
        if detection.id is None:
            continue
        first = first_with_id.setdefault((detection.robot, detection.id), k)
        if first != k:
            raise InputError(
                f"detections[{k}].id is {detection.id!r}, as is detections[{first}].id; ids must "
                "differ"
            )
    return own, people, time


def validated_own(own: OwnState) -> OwnState:
    """Return the robot's state with every number a `float`; the next point is always present.

    Raises:
        InputError: it is something else, or a number is not finite.
    """
    if not isinstance(own, OwnState):
        raise InputError(f"own is {shown(own)}; it must be an OwnState")
    if own.next_x is None and own.next_y is None:
        own = own._replace(next_x=own.goal_x, next_y=own.goal_y)
    numbers = zip(own._fields, own, strict=True)
    return OwnState(*(validated_number(f"own.{name}", value) for name, value in numbers))


def validated_centre(centre: Any) -> tuple[float, float]:
    """Return a place as two floats.

    Raises:
        InputError: it is something else.
    """
    try:
        x, y = centre
    except (TypeError, ValueError):
        raise InputError(f"centre is {shown(centre)}; it must be a pair (x, y)") from None
    return validated_number("centre[0]", x), validated_number("centre[1]", y)


def validated_walls(name: str, walls: Any) -> NDArray[np.float64]:
    """Return wall segments as an array [K, 4].

    The walls of a scan remain what they are.

    Raises:
        InputError: they are something else, masked, or not finite.
    """
    try:
        array = np.asanyarray(walls, np.float64)
    except (TypeError, ValueError):
        array = np.full((1, 1), np.nan)
    if array.shape == (0,):
        return np.zeros((0, 4))
    is_matrix = array.ndim == 2 and array.shape[1] == 4 and not isinstance(array, np.ma.MaskedArray)
    if not is_matrix or not (np.abs(array) <= LARGEST).all():
        raise InputError(
            f"{name} is {shown(walls)}; it must be a KnownMap, or rows [start_x, start_y, end_x, "
            f"end_y] of numbers within +-{LARGEST:g}"
        )
    return array if hasattr(array, "scan") else np.asarray(array)


def validated_sensors(
    sensors: Mapping[str, Any], expected: Mapping[str, tuple[tuple[int, ...], type]]
) -> dict[str, NDArray[Any]]:
    """Check the arrays of further sensors and add the axes of worlds and robots, [1, 1, ...].

    Raises:
        InputError: one is missing, unknown, of another shape or type, or not finite.
    """
    if not isinstance(sensors, Mapping):
        raise InputError(f"sensors is {shown(sensors)}; it must map names to arrays")
    for name in sensors:
        if name not in expected:
            names = f"one of {', '.join(expected)}" if expected else "omitted"
            raise InputError(f"sensors has {shown(name)}; it must be {names}")
    arrays = {}
    for name, (shape, dtype) in expected.items():
        if name not in sensors:
            raise InputError(f"sensors has no {name}; it must be an array {list(shape)}")
        try:
            array: NDArray[Any] = np.asarray(sensors[name], dtype)
        except (TypeError, ValueError):
            array = np.empty(0)
        is_masked = isinstance(sensors[name], np.ma.MaskedArray)
        if array.shape != shape or is_masked or not np.isfinite(array).all():
            raise InputError(
                f"sensors[{name!r}] is {shown(sensors[name])}; it must be an array {list(shape)} "
                "of finite numbers"
            )
        arrays[name] = array[None, None].copy()
    return arrays


def _detection(path: str, value: Any) -> Detection:
    """Return one element of `detections` with built-in types."""
    if not isinstance(value, Detection):
        raise InputError(f"{path} is {shown(value)}; it must be a Detection")
    x, y, velocity_x, velocity_y, radius = (
        validated_number(f"{path}.{name}", number)
        for name, number in zip(Detection._fields[:5], value[:5], strict=True)
    )
    if math.hypot(velocity_x, velocity_y) > FASTEST:
        speed = math.hypot(velocity_x, velocity_y)
        raise InputError(f"{path} moves at {speed:g} m/s; it must be at most {FASTEST:g} m/s")
    if radius <= 0.0:
        raise InputError(f"{path}.radius is {radius}; it must be above 0")
    if not isinstance(value.robot, bool | np.bool_):
        raise InputError(f"{path}.robot is {shown(value.robot)}; it must be true or false")
    try:
        hash(value.id)
        usable = bool(value.id == value.id)  # NaN would never be recognised
    except Exception:  # whatever a foreign class raises
        usable = False
    if not usable:
        raise InputError(f"{path}.id is {shown(value.id)}; it must be hashable and equal to itself")
    return Detection(x, y, velocity_x, velocity_y, radius, bool(value.robot), value.id)


def validated_number(name: str, value: Any) -> float:
    """Return a finite number as a float; booleans, arrays and strings are not numbers.

    Raises:
        InputError: it is something else.
    """
    if type(value) is float and abs(value) <= LARGEST:  # the usual case, quickly
        return value
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:  # an integer or fraction beyond any float
            number = math.inf
        if abs(number) <= LARGEST:
            return number
    raise InputError(f"{name} is {shown(value)}; it must be a number within +-{LARGEST:g}")


def number_above(name: str, value: Any, limit: float, included: bool = False) -> float:
    """Return a number above a limit, or equal to it if that is `included`; it may be infinite.

    Raises:
        InputError: it is something else.
    """
    is_infinite = isinstance(value, Real) and value == math.inf
    number = math.inf if is_infinite else validated_number(name, value)
    if number > limit or (included and number == limit):
        return number
    raise InputError(
        f"{name} is {number:g}; it must be {'at least' if included else 'above'} {limit:g}"
    )


def shown(value: Any) -> str:
    """Return a short form of any value, on one line."""
    return " ".join(repr(value).split())[:100]
