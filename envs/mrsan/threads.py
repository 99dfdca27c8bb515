"""The threads of the kernels: how they wait, how many there are, and which callers may use them."""

from __future__ import annotations

import os
import sys
import threading
from functools import cache
from pathlib import Path

import numba
from numba import config

_WAIT_SETTINGS = ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")


def let_threads_sleep() -> None:
    """Let the threads of kernels sleep soon instead of spinning while they wait.

    On a machine with other busy processes, spinning costs ten times the work itself. GNU's OpenMP
    reads the spin count when it is loaded. If another library (torch) has already loaded it,
    kernels run on Numba's own threads: half as fast as OpenMP's on an idle machine, but 20 times as
    fast beside one busy process. The user's own settings take precedence: `GOMP_SPINCOUNT`,
    `OMP_WAIT_POLICY`, `NUMBA_THREADING_LAYER`.
    """
    if any(name in os.environ for name in _WAIT_SETTINGS):
        return
    if not _openmp_is_loaded():
        os.environ["GOMP_SPINCOUNT"] = "1000"
    elif config.THREADING_LAYER == "default":
        config.THREADING_LAYER = "workqueue"


class _ThreadTeam:
    """The only team of threads of a process, which serves one parallel kernel at a time."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.is_unavailable = False  # True if the parent process had started its threads

    def after_fork(self) -> None:
        """Reset the lock, and mark the team unavailable in a child of a multi-threaded parent.

        A child inherits no threads, and GNU's OpenMP aborts a child that needs them.
        """
        self.lock = threading.Lock()  # another thread of the parent may have held it
        self.is_unavailable = self.is_unavailable or _threads_have_started()


_TEAM = _ThreadTeam()
if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_TEAM.after_fork)


def parallel_kernels() -> threading.Lock | None:
    """Return the lock to hold while a parallel kernel runs; None if only serial kernels can run.

    Numba's threading layers abort the process when two threads start parallel kernels at once
    (`workqueue`) or when a forked child starts one after its parent did (`omp`).
    """
    return None if _TEAM.is_unavailable else _TEAM.lock


def _threads_have_started() -> bool:
    try:
        numba.threading_layer()
    except ValueError:  # "Threading layer is not initialized."
        return False
    return True


def use_threads(number: int) -> None:
    """Set the number of threads of kernels, up to Numba's maximum, and of torch if it is loaded."""
    numba.set_num_threads(min(number, config.NUMBA_NUM_THREADS))
    if torch := sys.modules.get("torch"):  # last, because starting Numba's threads changes torch's
        torch.set_num_threads(number)


def kernel_threads() -> int:
    """Return the number of threads of kernels without changing that of torch.

    Starting Numba's threads sets OpenMP's number of threads, which torch shares: a torch limited to
    one thread would use all of them and let them spin.
    """
    _start_threads()
    return int(numba.get_num_threads())


@cache
def _start_threads() -> None:
    torch = sys.modules.get("torch")
    torch_threads = torch.get_num_threads() if torch else 0
    numba.get_num_threads()  # the first call starts them
    if torch:
        torch.set_num_threads(torch_threads)


def _openmp_is_loaded() -> bool:
    """Return whether this process has loaded GNU's OpenMP, which Numba uses only on Linux."""
    maps = Path("/proc/self/maps")
    return maps.exists() and b"libgomp" in maps.read_bytes()
