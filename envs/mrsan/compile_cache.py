"""The folder of compiled kernels, and a notice while kernels are compiled."""

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

_NOTICE_PRINTED = "MRSAN_COMPILE_NOTICE_PRINTED"  # environment variable


def ensure_compile_cache() -> None:
    """Let Numba cache kernels in a temporary folder if it can cache them nowhere else.

    By default Numba writes beside the package or into the home folder. In a container that runs as
    another user, it may be able to write to neither and would refuse to compile.
    """
    try:
        numba.njit(cache=True)(_probe)
    except RuntimeError:
        config.CACHE_DIR = str(_temporary_folder())
        print(
            f"compiled kernels are cached in {config.CACHE_DIR}: neither the package's folder "
            "nor the home folder is writable",
            file=sys.stderr,
            flush=True,
        )


def _probe() -> None:
    """Do nothing: Numba looks for a cache folder when this function is decorated."""


def _temporary_folder() -> Path:
    """Return a folder that only this user can write to, because its content is executed."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = Path(tempfile.gettempdir()) / f"mrsan-kernels-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    private = status.st_uid == user and not status.st_mode & 0o077 and stat.S_ISDIR(status.st_mode)
    if private or sys.platform == "win32":  # where every user has a temporary folder
        return folder
    return Path(tempfile.mkdtemp(prefix="mrsan-kernels-"))


def print_compile_notice() -> None:
    """Explain the pause, once in this process and those that it starts."""
    if _NOTICE_PRINTED not in os.environ:
        os.environ[_NOTICE_PRINTED] = "1"
        print("Compiling (only the first time, up to a minute) ...", file=sys.stderr, flush=True)


class _CompilationNotice(event.Listener):
    """Print the notice when a kernel of this project is compiled."""

    def on_start(self, event: Any) -> None:
        """Print the notice; Numba does not call this for kernels that it loads from the cache."""
        if event.data["dispatcher"].py_func.__module__.startswith(("mrsan", "samarl")):
            print_compile_notice()

    def on_end(self, event: Any) -> None:
        """Do nothing; the interface requires this method."""


event.register("numba:compile", _CompilationNotice())
