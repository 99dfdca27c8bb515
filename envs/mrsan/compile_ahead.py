"""Compile the kernels of a scenario side by side, in this process and in others.

Numba compiles one function at a time in each process, and a first episode needs several kernels.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from typing import Protocol

from mrsan.compile_progress import compile_progress
from mrsan.kernels import Version, replace_runs
from mrsan.scenario import Scenario


class CompiledWorld(Protocol):
    """What is needed of a `World`: its scenario, and a call of each of its kernels."""

    scenario: Scenario

    def call_kernels(self) -> None:
        """Call the kernels of an episode."""


@contextlib.contextmanager
def compile_ahead(world: CompiledWorld) -> Iterator[bool]:
    """Compile the kernels of worlds in other processes while the body runs, unless they are cached.

    A line on stderr every few seconds tells how many are compiled. If a process fails, for example
    because it does not know a plugin's crowd model, its kernels are compiled when they are used, as
    without this function.

    Yields:
        Whether anything is compiled.
    """
    missing = _missing_versions(world)
    if not missing:
        yield False
        return
    with _progress(missing), _processes(world.scenario, _shares(missing)):
        yield True


def compile_missing(world: CompiledWorld) -> None:
    """Compile the kernels of worlds, unless they are cached; likewise, and also in this process."""
    missing = _missing_versions(world)
    if not missing:
        return
    own, *others = _shares(missing)
    with _progress(missing), _processes(world.scenario, others):
        for version in own:
            version.load()


def _missing_versions(world: CompiledWorld) -> list[Version]:
    """Return the versions of kernels that worlds use and that were never compiled."""
    missing: list[Version] = []

    def note(version: Version) -> None:
        if not version.is_cached():
            missing.append(version)

    with replace_runs(note):
        world.call_kernels()
    return missing


def _shares(missing: list[Version]) -> list[list[Version]]:
    """Distribute kernels over processes, one for each core."""
    has_affinity = hasattr(os, "sched_getaffinity")  # not on macOS
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    if getattr(sys, "frozen", False):  # `sys.executable` is the user's program
        cores = 1
    return [missing[k::cores] for k in range(min(cores, len(missing)))]


def _progress(missing: list[Version]) -> contextlib.AbstractContextManager[None]:
    def status() -> str:
        done = sum(version.is_cached() for version in missing)
        return f", {done} of {len(missing)} kernels"

    return compile_progress(status)


@contextlib.contextmanager
def _processes(scenario: Scenario, shares: list[list[Version]]) -> Iterator[None]:
    """Compile each share in a process while the body runs, and wait for them."""
    processes = [_start(scenario, [version.name for version in share]) for share in shares]
    try:
        yield
    except BaseException:
        for process in processes:
            process.kill()
        raise
    finally:
        for process in processes:
            process.wait()


def _start(scenario: Scenario, names: list[str]) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(
        [sys.executable, "-m", "mrsan.compile_worker", *names],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError), process.stdin as pipe:
        pickle.dump(scenario, pipe)
    return process
