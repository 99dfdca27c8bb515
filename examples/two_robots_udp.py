"""Two robots pass a door in opposite directions and agree on who goes first over UDP.

    python examples/two_robots_udp.py [--loss 0.2] [--delay 0.5] [--macro-level macro_level.onnx]

Each robot is a process of its own with a simulated base and a `RightOfWayDriver`. It knows the map
of the office, and has no sensor: it learns of the other robot from messages alone, JSON in UDP
datagrams on this machine. It takes about twenty seconds, in real time.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import random
import socket
import sys
import time
from dataclasses import dataclass
from multiprocessing.synchronize import Barrier, Event
from pathlib import Path

import numpy as np

from mrsan import Scenario
from samarl.runtime import Command, KnownMap, Message, OwnState, RightOfWayDriver

OFFICE = Path(__file__).parent / "maps" / "office.yaml"
WAYS = {  # through the door at (-5.5, 1.1): start and goal, m
    "ada": ((-4.0, 4.2), (-6.5, -1.5)),
    "bob": ((-4.0, -2.0), (-4.2, 3.6)),
}
TICK = 0.05  # of the bases and of the network, s
WATCHDOG = 0.6  # time after which a base stops that receives no command, s
TIME_LIMIT = 90.0  # s
RADIUS = Scenario().robot_radius


@dataclass
class Base:
    """A simulated differential drive: it executes speeds and turn rates."""

    x: float
    y: float
    heading: float
    time: float = 0.0
    speed: float = 0.0
    turn_rate: float = 0.0
    command_time: float = 0.0

    def move(self, time: float) -> None:
        """Drive until `time`; without commands the base stops."""
        elapsed, self.time = time - self.time, time
        if time - self.command_time > WATCHDOG:
            self.speed = self.turn_rate = 0.0
        self.heading += elapsed * self.turn_rate
        self.x += elapsed * self.speed * math.cos(self.heading)
        self.y += elapsed * self.speed * math.sin(self.heading)

    def execute(self, command: Command) -> None:
        """Take a new command."""
        self.speed, self.turn_rate = command.speed, command.turn_rate
        self.command_time = self.time

    def state(self, goal: tuple[float, float]) -> OwnState:
        """Return what the driver needs to know."""
        velocity = self.speed * math.cos(self.heading), self.speed * math.sin(self.heading)
        return OwnState(self.x, self.y, self.heading, *velocity, *goal)


class Link:
    """Messages as datagrams, some of which are lost and all of which are delayed."""

    def __init__(
        self, own: socket.socket, other: tuple[str, int], loss: float, delay: float
    ) -> None:
        """Receive from a socket and send to an address."""
        self._socket, self._other, self._loss, self._delay = own, other, loss, delay
        self._waiting: list[tuple[float, bytes]] = []  # time to send, and content
        own.setblocking(False)

    def send(self, message: Message) -> None:
        """Send a message, unless it is lost, after the delay."""
        if random.random() >= self._loss:
            data = json.dumps(message._asdict()).encode()
            self._waiting.append((message.time + self._delay, data))

    def flush(self, time: float) -> None:
        """Send what is due."""
        while self._waiting and self._waiting[0][0] <= time:
            self._socket.sendto(self._waiting.pop(0)[1], self._other)

    def receive(self) -> list[Message]:
        """Return the messages that have arrived."""
        messages = []
        while True:
            try:
                messages.append(Message(**json.loads(self._socket.recv(4096))))
            except BlockingIOError:
                return messages


def drive(
    name: str,
    link: Link,
    macro_level: str | None,
    began: float,
    ready: Barrier,
    arrived: dict[str, Event],
    tracks: multiprocessing.Queue[tuple[str, list[tuple[float, float, float]]]],
) -> None:
    """Drive one robot until all have arrived; put its track (time, x, y) into the queue."""
    start, goal = WAYS[name]
    driver = RightOfWayDriver(KnownMap.load(OFFICE), name, macro_level=macro_level)
    base = Base(*start, heading=math.atan2(goal[1] - start[1], goal[0] - start[0]))
    ready.wait()  # until the other one has compiled its kernels, too
    start_time = base.time = base.command_time = time.monotonic() - began
    next_step, track = start_time, []
    while base.time < start_time + TIME_LIMIT and not all(e.is_set() for e in arrived.values()):
        base.move(time.monotonic() - began)
        track.append((base.time, base.x, base.y))
        if base.time >= next_step:
            own = base.state(goal)
            command, message = driver.step(own, (), base.time, link.receive())
            base.execute(command)
            link.send(message)
            next_step = max(next_step + driver.scenario.time_step, base.time)
            if math.hypot(own.x - goal[0], own.y - goal[1]) < RADIUS and command.speed == 0.0:
                arrived[name].set()
        link.flush(base.time)
        time.sleep(TICK)
    tracks.put((name, track))


def main() -> int:
    """Run both robots; return 0 if they arrive and do not touch."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--loss", type=float, default=0.0, help="share of lost messages (0)")
    parser.add_argument("--delay", type=float, default=0.0, help="of every message, s (0)")
    parser.add_argument("--macro-level", help="exported macro level (default: the rule)")
    options = parser.parse_args()
    context = multiprocessing.get_context("spawn")
    sockets = {name: socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for name in WAYS}
    for one in sockets.values():
        one.bind(("127.0.0.1", 0))
    ready, arrived = context.Barrier(len(WAYS)), {name: context.Event() for name in WAYS}
    tracks, began = context.Queue(), time.monotonic()  # a clock that all processes share
    for name, other in zip(WAYS, reversed(WAYS), strict=True):
        link = Link(sockets[name], sockets[other].getsockname(), options.loss, options.delay)
        arguments = name, link, options.macro_level, began, ready, arrived, tracks
        context.Process(target=drive, args=arguments, daemon=True).start()
    gap = least_gap(dict(tracks.get() for _ in WAYS))
    success = gap > 0.0 and all(event.is_set() for event in arrived.values())
    print(f"arrived: {', '.join(n for n in WAYS if arrived[n].is_set()) or 'nobody'}")
    print(f"least distance between the surfaces of the robots: {gap:.2f} m")
    return 0 if success else 1


def least_gap(tracks: dict[str, list[tuple[float, float, float]]]) -> float:
    """Return the least distance between the surfaces of two robots at the same time, m."""
    (t, x, y), (other_t, other_x, other_y) = (np.array(track).T for track in tracks.values())
    here = np.stack([np.interp(t, other_t, other_x) - x, np.interp(t, other_t, other_y) - y])
    return float(np.hypot(*here).min()) - 2.0 * RADIUS


if __name__ == "__main__":
    sys.exit(main())
