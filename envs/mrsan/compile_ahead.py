"""Compile the kernels of a scenario side by side, in processes of their own.

A first start spends nearly all of its time on two kernels: the one that begins episodes and the one
that steps the worlds. Numba compiles one kernel at a time in each process, so this module starts a
process for each, which leaves the result in the cache: `python -m mrsan.compile_ahead begin|step`
reads the pickled scenario from its standard input.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator

import numpy as np

from mrsan.compile_cache import print_compile_notice
from mrsan.scenario import Scenario
from mrsan.world import World

_WORLDS = 2  # one world may be simulated by another version of the kernels
_USUAL_SECONDS = 40  # of a first start on two cores
_PROGRESS_SECONDS = 10.0  # between two lines about the progress


@contextlib.contextmanager
def compile_ahead(scenario: Scenario) -> Iterator[bool]:
    """Compile the kernels of a scenario while the body runs, unless they are cached.

    A line on stderr every 10 s tells how long it has taken. If a process fails, for example because
    it does not know a plugin's crowd model, its kernel is compiled on first use, as without this
    function.

    Args:
        scenario: the scenario to be simulated, in any number of worlds above one.

    Yields:
        Whether anything is compiled.
    """
    world = World(scenario, _WORLDS)
    parts = [name for name, kernel in world.kernels.items() if not kernel.is_cached]
    if not parts:
        yield False
        return
    print_compile_notice()
    processes = [_start(part, scenario) for part in parts]
    with _progress_lines():
        try:
            yield True
        except BaseException:
            for process in processes:
                process.kill()
            raise
        finally:
            for process in processes:
                process.wait()


@contextlib.contextmanager
def _progress_lines() -> Iterator[None]:
    """Print the seconds since the start of the body, every `_PROGRESS_SECONDS` until its end."""
    end = threading.Event()

    def report() -> None:
        seconds = 0.0
        while not end.wait(_PROGRESS_SECONDS):
            seconds += _PROGRESS_SECONDS
            usual = f"about {_USUAL_SECONDS} s"
            rest = f"of {usual}" if seconds < _USUAL_SECONDS else f"({usual} on an idle machine)"
            print(f"compiling: {seconds:g} s {rest}", file=sys.stderr, flush=True)

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()


def _start(part: str, scenario: Scenario) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        [sys.executable, "-m", "mrsan.compile_ahead", part],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin as pipe:
        pickle.dump(scenario, pipe)
    return process


def _compile(part: str, scenario: Scenario) -> None:
    """Run one kernel on worlds whose arrays are empty, which compiles it."""
    world = World(scenario, _WORLDS)
    if part == "begin":
        world._begin(np.ones(_WORLDS, np.bool_))
    else:
        world._move(
            world._advance, np.zeros((_WORLDS, scenario.robots, scenario.action_size), np.float32)
        )


if __name__ == "__main__":
    _compile(sys.argv[1], pickle.load(sys.stdin.buffer))
