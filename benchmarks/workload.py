"""Worlds stepped with random actions, and the command-line options that benchmarks share."""

from __future__ import annotations

import argparse
import contextlib
import math
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Scenario, Step, World
from samarl.files import code_version, machine
from samarl.launch import launcher

_WARM_UP = 50  # steps; afterwards the worlds are in different phases of their episodes
_BATCHES = 16  # of random actions, used in turn, so that drawing them is not measured


class RandomStepper:
    """Steps E worlds, which reset automatically, with random actions."""

    def __init__(self, worlds: int, humans: int = 10, robots: int = 3, **fields: Any) -> None:
        """Create the worlds, compile their kernels and let their episodes drift apart.

        Args:
            worlds: their number E.
            humans: number of people.
            robots: number of robots.
            **fields: other fields of the scenario.
        """
        scenario = Scenario(humans=humans, robots=robots, **fields)
        self.world = World(scenario, worlds, auto_reset=True)
        self.world.reset(np.arange(worlds))
        generator = np.random.default_rng(0)
        shape = (_BATCHES, worlds, robots, scenario.action_size)
        self._actions: NDArray[np.float32] = generator.uniform(-1.0, 1.0, shape).astype(np.float32)
        self.steps = -_WARM_UP  # steps of every world since the end of the warm-up
        for _ in range(_WARM_UP):
            self.step()

    def step(self) -> Step:
        """Take one full step: move, reset ended episodes, observe."""
        self.steps += 1
        return self.world.step(self._actions[self.steps % _BATCHES])


def positive_number(text: str) -> float:
    """Parse a finite number greater than 0."""
    return _positive(float, text, "a number")


def positive_whole_number(text: str) -> int:
    """Parse a whole number greater than 0."""
    return int(_positive(int, text, "a whole number"))


def _positive(parse: Callable[[str], float], text: str, description: str) -> float:
    try:
        value = parse(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"is {text!r}; it must be {description} greater than 0")
    return value


def add_output(parser: argparse.ArgumentParser, name: str) -> None:
    """Add the option `--output`, the JSON file of a benchmark's results."""
    path = Path(f"outputs/{name}.json")
    parser.add_argument(
        "--output", type=Path, default=path, help=f"the JSON file to write (default: {path})"
    )


def provenance(program: str) -> dict[str, str]:
    """Return the machine, commit and command that produced the results of a benchmark."""
    words = [*launcher(), "python", "-m", f"benchmarks.{program}", *sys.argv[1:]]
    return {"machine": machine(), "commit": code_version(), "command": shlex.join(words)}


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """End with one line instead of a traceback on Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt as interruption:
        print("; ".join(["interrupted", *map(str, interruption.args)]), file=sys.stderr)
        sys.exit(130)
