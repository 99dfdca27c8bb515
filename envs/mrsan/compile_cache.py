"""Where compiled kernels are kept, and what is said while they are made."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from pathlib import Path
from typing import Any

import numba
from numba import config
from numba.core import event


def ensure_compile_cache() -> None:
    """Let Numba keep kernels in a temporary folder where it cannot keep them anywhere else.

    It keeps them beside the package, or in the home; in a container that runs as another user it
    may write in neither and would refuse to compile at all.
    """
    try:
        numba.njit(cache=True)(_anything)
    except RuntimeError:
        config.CACHE_DIR = str(_temporary_folder())
        print(f"compiled kernels are kept in {config.CACHE_DIR}: neither the package's folder nor "
              "the home can be written", file=sys.stderr, flush=True)  # fmt: skip


def _anything() -> None:
    """A function that could be compiled."""


def _temporary_folder() -> Path:
    """A folder of this user's that nobody else can write: what lies in it is executed."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"mrsan-kernels-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    private = found.st_uid == user and not found.st_mode & 0o077 and stat.S_ISDIR(found.st_mode)
    if private or sys.platform == "win32":  # there the temporary folder is the user's own
        return folder
    return Path(tempfile.mkdtemp(prefix="mrsan-kernels-"))


class _Announcer(event.Listener):
    """Says what is being compiled, so that nobody wonders at the pause."""

    def __init__(self) -> None:
        self.said: set[str] = set()

    def on_start(self, event: Any) -> None:
        """Numba begins to compile (a kernel found in the cache does not come here)."""
        function = event.data["dispatcher"].py_func
        package, _, module = str(function.__module__).rpartition(".")
        if package.startswith("mrsan"):
            many = function.__qualname__.endswith("_parallel")
            what = f"the simulator of {'many worlds' if many else 'one world'}"
        else:
            what = module.replace("_", " ")
        if package.startswith(("mrsan", "samarl")) and what not in self.said:
            self.said.add(what)
            print(f"Compiling {what} (once) ...", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Nothing to say."""


event.register("numba:compile", _Announcer())
