"""What a user sees on stderr while kernels are compiled: a notice, then lines every few seconds."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import event

_NOTICE_PRINTED = "MRSAN_COMPILE_NOTICE_PRINTED"  # environment variable, for child processes
_LINE_SECONDS = 5.0  # of compiling between two lines


class _Clock:
    """How long this process has compiled."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.depth = 0  # of compilations within each other
        self.finished = threading.Event()
        self.seconds = 0.0  # of those that have finished
        self.printed = 0.0  # seconds in the last line
        self.started = 0.0

    def start(self, status: Callable[[], str]) -> None:
        with self.lock:
            self.depth += 1
            if self.depth > 1:
                return
            self.started, self.finished = time.monotonic(), threading.Event()
        _print_notice()
        threading.Thread(
            target=self._print_lines, args=(self.finished, status), daemon=True
        ).start()

    def stop(self) -> None:
        with self.lock:
            self.depth -= 1
            if self.depth == 0:
                self.seconds += time.monotonic() - self.started
                self.finished.set()

    def _print_lines(self, finished: threading.Event, status: Callable[[], str]) -> None:
        before = self.seconds
        while not finished.wait(self.printed + _LINE_SECONDS - before - self._elapsed()):
            self.printed = before + self._elapsed()
            _print(f"compiling: {self.printed:.0f} s{status()}")

    def _elapsed(self) -> float:
        return time.monotonic() - self.started


_CLOCK = _Clock()


@contextlib.contextmanager
def compile_progress(status: Callable[[], str] = str) -> Iterator[None]:
    """Print that something is compiled while the body runs.

    Args:
        status: returns what a line says besides the time; not called within another body.
    """
    _CLOCK.start(status)
    try:
        yield
    finally:
        _CLOCK.stop()


def _print_notice() -> None:
    """Explain the pause, once in this process and those that it starts."""
    if _NOTICE_PRINTED not in os.environ:
        os.environ[_NOTICE_PRINTED] = "1"
        _print("Compiling (only the first time, up to a minute) ...")


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


class _Compilation(event.Listener):
    """Show the progress of functions that Numba compiles on their own."""

    def on_start(self, event: Any) -> None:
        """Start, unless the function is somebody else's. Loading from the cache is no event."""
        if _is_own(event):
            _CLOCK.start(str)

    def on_end(self, event: Any) -> None:
        """Stop likewise."""
        if _is_own(event):
            _CLOCK.stop()


def _is_own(event: Any) -> bool:
    module: str = event.data["dispatcher"].py_func.__module__
    return module.startswith(("mrsan", "samarl"))


event.register("numba:compile", _Compilation())
