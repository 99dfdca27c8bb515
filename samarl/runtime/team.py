"""What robots of a team tell each other, and where the others are between two messages."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from samarl.runtime.inputs import FASTEST, Detection, InputError, shown, validated_number
from samarl.runtime.slots import GATE

_AHEAD = 1.0  # of the own clock: messages from farther in the future are not from a shared one, s


class Message(NamedTuple):
    """What a robot tells its team-mates after each step, in the frame of `OwnState`.

    Every field is a number, a string or a boolean, so JSON can carry it.
    """

    robot: str  # name of the sender; those of a team differ
    time: float  # of the sender's measurements, on a clock that the team shares, s
    x: float  # m
    y: float
    velocity_x: float  # m/s
    velocity_y: float
    priority: float  # in [0, 1): the higher goes first
    through: bool  # the way to its goal is clear, or it has arrived
    macro_action: int  # what it does, and the mouth where it enters its passage
    passages: int  # checksum of the passages that it knows


def validated_messages(
    messages: Iterable[Message], robot: str, time: float, passages: int
) -> list[Message]:
    """Return the messages of other robots, with built-in types.

    Args:
        messages: any iterable; those that `robot` itself has sent are left out.
        robot: the name of the receiver.
        time: of the step, s.
        passages: checksum of the passages that the receiver knows.

    Raises:
        InputError: one has the wrong type, is not finite, comes from the future, or is about
            another map.
    """
    try:
        iterator = iter(messages)
    except TypeError:
        raise InputError(
            f"messages is {shown(messages)}; it must be an iterable of Message"
        ) from None
    checked = [_message(f"messages[{k}]", value) for k, value in enumerate(iterator)]
    for k, message in enumerate(checked):
        if message.time > time + _AHEAD:
            raise InputError(
                f"messages[{k}].time is {message.time}, in the future; it must be at most "
                f"{time + _AHEAD}: the clocks of robots must agree"
            )
        if message.passages != passages:
            raise InputError(
                f"messages[{k}].passages is {message.passages}; it must be {passages}: all robots "
                "need the same map, clearance and radius"
            )
    return [message for message in checked if message.robot != robot]


def _message(path: str, value: Any) -> Message:
    """Return one element of `messages` with built-in types."""
    if not isinstance(value, Message):
        raise InputError(f"{path} is {shown(value)}; it must be a Message")
    numbers: dict[str, Any] = {
        name: validated_number(f"{path}.{name}", getattr(value, name))
        for name in ("time", "x", "y", "velocity_x", "velocity_y", "priority")
    }
    if not isinstance(value.robot, str):
        raise InputError(f"{path}.robot is {shown(value.robot)}; it must be a string")
    if not isinstance(value.through, bool):
        raise InputError(f"{path}.through is {shown(value.through)}; it must be true or false")
    for name in ("macro_action", "passages"):
        number = getattr(value, name)
        if type(number) is not int or not 0 <= number < 2**32:
            raise InputError(f"{path}.{name} is {shown(number)}; it must be an integer from 0 on")
    speed = math.hypot(numbers["velocity_x"], numbers["velocity_y"])
    if speed > FASTEST:
        raise InputError(f"{path} moves at {speed:g} m/s; it must be at most {FASTEST:g} m/s")
    if not 0.0 <= numbers["priority"] < 1.0:
        raise InputError(f"{path}.priority is {numbers['priority']}; it must lie in [0, 1)")
    return value._replace(**numbers)


@dataclass
class Mate:
    """A team-mate: its last message, and where it was last told or seen to be."""

    message: Message
    time: float  # s
    x: float  # m
    y: float
    velocity_x: float  # m/s
    velocity_y: float

    def position(self, time: float) -> tuple[float, float]:
        """Return where it is expected to be, m."""
        elapsed = max(time - self.time, 0.0)
        return self.x + elapsed * self.velocity_x, self.y + elapsed * self.velocity_y


class Team:
    """The team-mates from which a robot has heard lately."""

    def __init__(self, forget_after: float) -> None:
        """Start alone; those who are silent for `forget_after` seconds are forgotten."""
        self._forget_after = forget_after
        self.mates: dict[str, Mate] = {}

    def update(
        self, messages: Sequence[Message], detections: Sequence[Detection], time: float
    ) -> list[Detection]:
        """Add what is heard and seen; return the detections that are of nobody who has spoken.

        A detected robot is the team-mate whose name its id is, or the nearest within `GATE`.
        """
        for message in messages:
            mate = self.mates.get(message.robot)
            if mate is None:
                self.mates[message.robot] = Mate(message, *message[1:6])
                continue
            if message.time > mate.message.time:
                mate.message = message
            if message.time > mate.time:
                mate.time, mate.x, mate.y, mate.velocity_x, mate.velocity_y = message[1:6]
        self.mates = {
            name: mate
            for name, mate in self.mates.items()
            if time - mate.message.time <= self._forget_after
        }
        others, unnamed = [], []
        seen: dict[str, Detection] = {}
        for detection in detections:
            if detection.robot and detection.id in self.mates:
                seen[str(detection.id)] = detection
            elif detection.robot:
                unnamed.append(detection)
            else:
                others.append(detection)
        pairs = []
        for name in self.mates.keys() - seen.keys():
            x, y = self.mates[name].position(time)
            distances = [math.hypot(d.x - x, d.y - y) for d in unnamed]
            pairs += [(distance, k, name) for k, distance in enumerate(distances)]
        matched = set()
        for distance, k, name in sorted(pairs):
            if distance <= GATE and k not in matched and name not in seen:
                matched.add(k)
                seen[name] = unnamed[k]
        for name, d in seen.items():
            mate = self.mates[name]
            mate.time, mate.x, mate.y = time, d.x, d.y
            mate.velocity_x, mate.velocity_y = d.velocity_x, d.velocity_y
        return others + [d for k, d in enumerate(unnamed) if k not in matched]
