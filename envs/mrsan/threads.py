"""The threads that kernels run on: how they wait, how many there are, and who may use them."""

from __future__ import annotations

import os
import sys
import threading
from functools import cache
from pathlib import Path

import numba
from numba import config

_DECIDED_BY = ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")


def let_threads_sleep() -> None:
    """Let the threads of kernels sleep soon instead of spinning while they wait.

    On a machine that others use as well, spinning costs ten times the work itself. GNU's OpenMP
    reads how long threads spin when it is loaded. Where another library (torch) has loaded it
    before, kernels run on Numba's own threads: half as fast as OpenMP's on an idle machine, but
    20 times as fast beside one busy process. What the user sets stays: `GOMP_SPINCOUNT`,
    `OMP_WAIT_POLICY`, `NUMBA_THREADING_LAYER`.
    """
    if any(name in os.environ for name in _DECIDED_BY):
        return
    if not _openmp_is_loaded():
        os.environ["GOMP_SPINCOUNT"] = "1000"
    elif config.THREADING_LAYER == "default":
        config.THREADING_LAYER = "workqueue"


class _Team:
    """The one team of threads of a process, which serves one parallel kernel at a time."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.lost = False  # this process was forked from one whose threads had started

    def after_fork(self) -> None:
        """A child inherits no threads, and GNU's OpenMP ends a child that needs them."""
        self.lock = threading.Lock()  # another thread of the parent may have held it
        self.lost = self.lost or _threads_have_started()


_TEAM = _Team()
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_TEAM.after_fork)


def parallel_kernels() -> threading.Lock | None:
    """The lock to hold while a parallel kernel runs; None: only serial kernels can run here.

    Numba's threading layers end the process when two threads start parallel kernels at once
    (`workqueue`) or when a forked child does after its parent did (`omp`).
    """
    return None if _TEAM.lost else _TEAM.lock


def _threads_have_started() -> bool:
    try:
        numba.threading_layer()
    except ValueError:  # "Threading layer is not initialized."
        return False
    return True


def use_threads(number: int) -> None:
    """Run kernels on so many threads, as far as there are; and torch, where it is loaded."""
    numba.set_num_threads(min(number, config.NUMBA_NUM_THREADS))
    if torch := sys.modules.get("torch"):  # after Numba's, whose start sets torch's as well
        torch.set_num_threads(number)


def kernel_threads() -> int:
    """On how many threads kernels run; torch keeps the number that it had.

    When Numba starts its threads it sets OpenMP's number, which is torch's as well: a torch that
    was told to use one thread would use all, and have them spin for each other.
    """
    _start_threads()
    return int(numba.get_num_threads())


@cache
def _start_threads() -> None:
    torch = sys.modules.get("torch")
    wanted = torch.get_num_threads() if torch else 0
    numba.get_num_threads()  # starts them, the first time
    if torch:
        torch.set_num_threads(wanted)


def _openmp_is_loaded() -> bool:
    """Whether this process has loaded GNU's OpenMP (asked of Linux; elsewhere Numba has others)."""
    maps = Path("/proc/self/maps")
    return maps.exists() and "libgomp" in maps.read_text()
