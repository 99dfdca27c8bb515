"""Progress bars, which are readable in log files as well."""

from __future__ import annotations

import contextlib
import sys
import tempfile
import threading
from collections.abc import Iterator, MutableMapping
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

LOG_SECONDS = 10.0  # between two lines of a bar that is written to a file
_LOG_FORMAT = "{desc}: {n_fmt} of {total_fmt} {unit}s, {elapsed} elapsed, {remaining} left"
_BAR_FORMAT = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}, {rate_fmt}{postfix}]"
_FIRST_ESTIMATE = 0.05  # progress before which compiling makes estimates of the rest too large
_POLL_SECONDS = 0.5


class _Bar(tqdm):
    """A bar that estimates the remaining time only when enough is done."""

    @property
    def format_dict(self) -> MutableMapping[str, Any]:
        """What the bar is made of, see tqdm."""
        parts = super().format_dict
        if self.total and self.n < _FIRST_ESTIMATE * self.total:
            form = parts["bar_format"] or _BAR_FORMAT
            parts["bar_format"] = form.replace("<{remaining}", "").replace(", {remaining} left", "")
        return parts


class _Lines:
    """Write each update of a bar as a line of its own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> None:
        """Write the text without carriage returns, unless nothing is left of it."""
        if line := text.replace("\r", "").strip():
            self._stream.write(f"{line}\n")

    def flush(self) -> None:
        """Flush the stream."""
        self._stream.flush()


def progress_bar(iterable: Any = None, **settings: Any) -> tqdm:
    """Return a tqdm bar on standard error.

    Where standard error is not a terminal, a plain line is printed at most every 10 seconds.
    """
    if not sys.stderr.isatty():
        settings |= {
            "file": _Lines(sys.stderr),
            "mininterval": LOG_SECONDS,
            "delay": LOG_SECONDS,
            "bar_format": _LOG_FORMAT,
        }
    return _Bar(iterable, **settings)


@contextlib.contextmanager
def shared_progress(bar: tqdm, workers: int) -> Iterator[Path]:
    """Let worker processes advance a bar.

    The bar shows the sum of the counts of all workers.

    Yields:
        The path of the file of counts, see `SharedCount`.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "counts"
        counts = np.memmap(path, np.int64, "w+", shape=(workers,))
        finished = threading.Event()
        thread = threading.Thread(target=_follow, args=(bar, counts, finished), daemon=True)
        thread.start()
        try:
            yield path
        finally:
            finished.set()
            thread.join()
            del counts  # Windows does not delete open files


class SharedCount(NamedTuple):
    """The count of one worker of `shared_progress`; calling it advances the bar."""

    path: Path  # of the file of all counts
    worker: int  # its number

    def __call__(self, number: int) -> None:
        """Add to the count."""
        np.memmap(self.path, np.int64, "r+")[self.worker] += number


def _follow(bar: tqdm, counts: NDArray[np.int64], finished: threading.Event) -> None:
    """Show the sum of the counts until `finished` is set."""
    seconds = _POLL_SECONDS if sys.stderr.isatty() else LOG_SECONDS
    while not finished.wait(seconds):
        bar.n = int(counts.sum())
        bar.refresh()
