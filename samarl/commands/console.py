"""What the commands with options share: their parser, one-line errors, closed pipes."""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

import samarl
from mrsan import ConfigurationError
from samarl.files import check_writable

PICTURES = (".png", ".svg", ".pdf")


class Parser(argparse.ArgumentParser):
    """Parses the options of a command; reports errors in one line."""

    def __init__(
        self,
        prog: str,
        description: str,
        about: str,
        metavar: str = "FILE",
        nargs: str | None = None,
    ) -> None:
        """Add the argument and the options that all such commands have.

        Args:
            prog: name of the command.
            description: of the command.
            about: describes the argument.
            metavar: name of the argument; in lower case, that of its value.
            nargs: how many of them there may be, see `argparse`.
        """
        super().__init__(prog=prog, description=description, allow_abbrev=False)
        self.add_argument(metavar.lower(), metavar=metavar, type=Path, nargs=nargs, help=about)
        self.add_argument("--version", action="version", version=f"samarl {samarl.__version__}")

    def error(self, message: str) -> NoReturn:
        """Report a wrong option."""
        fail(message)


def run(
    parser: Parser,
    task: Callable[[argparse.Namespace], None],
    options: Mapping[str, str] | None = None,
) -> None:
    """Parse the options and run the command; a `ValueError` becomes one line.

    Messages name settings, which become the `options` of this command.
    """
    for stream in (sys.stdout, sys.stderr):  # some terminals support ASCII only
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    arguments = parser.parse_args()
    try:
        task(arguments)
        sys.stdout.flush()
    except ValueError as error:
        message = str(error)
        for setting, option in (options or {}).items():
            message = message.replace(setting, option)
        fail(message)
    except BrokenPipeError:  # the reader of the output, such as `head`, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def fail(message: str) -> NoReturn:
    """Print an error in one line and exit."""
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)


def check_output(option: str, path: Path | None, file: Path, pictures: bool = False) -> None:
    """Check that an output can be written and does not replace the file that is read.

    Raises:
        ConfigurationError: it cannot, or it is no picture although it must be.
    """
    if path is None:
        return
    if pictures and path.suffix not in PICTURES:
        raise ConfigurationError(f"{option} is {str(path)!r}; it must end in {', '.join(PICTURES)}")
    if path.exists() and path.samefile(file):
        raise ConfigurationError(
            f"{option} is {str(path)!r}, which is the file that is read; it must be another file"
        )
    check_writable(path, option)


def origin_of_world(point: NDArray[np.float64]) -> str:
    """Return the words for where the origin of the simulated world is in a file, m."""
    x, y = (point.round(2) + 0.0).tolist()  # without a negative zero
    return f"of the simulated world: ({x:.2f}, {y:.2f}) in the file"


def table(rows: list[tuple[str, str]]) -> str:
    """Return lines of names and values."""
    return "\n".join(f"{name:<12} {value}" for name, value in rows)
