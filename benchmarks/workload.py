"""What the benchmarks share: worlds driven by random actions, and arguments in range."""

from __future__ import annotations

import argparse
import contextlib
import math
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrsan import Scenario, Step, World
from samarl.files import code_version, machine
from samarl.launch import launcher

_WARM_UP = 50  # steps, after which the episodes of the worlds are in all phases
_BATCHES = 16  # of random actions, used in turn: drawing them must not be what is measured


class RandomDrive:
    """E worlds that begin anew by themselves, driven by random actions."""

    def __init__(self, worlds: int, humans: int = 10, robots: int = 3) -> None:
        """Make the worlds, compile what they need, and let their episodes drift apart."""
        scenario = Scenario(humans=humans, robots=robots)
        self.world = World(scenario, worlds, auto_reset=True)
        self.world.reset(np.arange(worlds))
        generator = np.random.default_rng(0)
        shape = (_BATCHES, worlds, robots, scenario.action_size)
        self._actions: NDArray[np.float32] = generator.uniform(-1.0, 1.0, shape).astype(np.float32)
        self.steps = -_WARM_UP  # of every world, since it has warmed up
        for _ in range(_WARM_UP):
            self.step()

    def step(self) -> Step:
        """One full step: move, begin episodes anew, observe."""
        self.steps += 1
        return self.world.step(self._actions[self.steps % _BATCHES])


def positive_number(text: str) -> float:
    """An argument that must be a finite number above 0."""
    return _positive(float, text, "a number")


def positive_whole_number(text: str) -> int:
    """An argument that must be a whole number above 0."""
    return int(_positive(int, text, "a whole number"))


def _positive(kind: Callable[[str], float], text: str, what: str) -> float:
    try:
        value = kind(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"is {text!r}; it must be {what} above 0")
    return value


def add_output(parser: argparse.ArgumentParser, name: str) -> None:
    """`--output`, the file of a benchmark's figures."""
    path = Path(f"outputs/{name}.json")
    parser.add_argument(
        "--output", type=Path, default=path, help=f"the JSON file to write (default: {path})"
    )


def made_by(program: str) -> dict[str, str]:
    """What stands beside the figures of a benchmark: machine, commit and command."""
    words = [*launcher(), "python", "-m", f"benchmarks.{program}", *sys.argv[1:]]
    return {"machine": machine(), "commit": code_version(), "command": shlex.join(words)}


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Ctrl-C ends in one line, not in a traceback."""
    try:
        yield
    except KeyboardInterrupt as interruption:
        print("; ".join(["interrupted", *map(str, interruption.args)]), file=sys.stderr)
        sys.exit(130)
