"""Files that are either whole or not there, and where they come from."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import samarl
from mrsan import ConfigurationError


@contextlib.contextmanager
def unfinished(path: Path) -> Iterator[Path]:
    """Where to write a file that becomes `path` at the end, whole, or is removed on an error.

    Raises:
        ConfigurationError: it cannot be written, for example because the disk is full.
    """
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield part
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be written ({error.strerror or error})") from None


def check_writable(path: Path, field: str) -> None:
    """Find out before long work whether a file can be written where it shall lie.

    Args:
        path: of the file.
        field: that names it, for the error.

    Raises:
        ConfigurationError: it cannot.
    """
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=folder):  # the folders below it can be made
            pass
        if path.is_dir():
            raise IsADirectoryError("it is a folder")
    except OSError as error:
        raise ConfigurationError(
            f"{field} is {str(path)!r}, where nothing can be written ({error.strerror or error})"
        ) from error


def write_atomically(path: Path, text: str) -> None:
    """Write a text file so that a reader never sees half of it."""
    with unfinished(path) as part:
        part.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write JSON, one element of a top-level list per line."""
    if isinstance(content, list):
        text = "[\n" + ",\n".join(json.dumps(item) for item in content) + "\n]\n"
    else:
        text = json.dumps(content, indent=1) + "\n"
    write_atomically(path, text)


def read_json(path: Path) -> Any:
    """What a JSON file holds.

    Raises:
        ConfigurationError: it cannot be read, or is something else.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path} is not JSON ({error})") from error


def find_folder(name: str) -> Path:
    """The project's `conf` or `results`: in the installed package or beside the source."""
    installed = Path(samarl.__file__).parent / name
    return installed if installed.is_dir() else Path(samarl.__file__).parents[1] / name


def code_version() -> str:
    """The commit of the code that runs, with `-dirty` and a digest if it was changed since.

    Without git it is the version of the package.
    """
    source = Path(samarl.__file__).parent
    try:
        commit = _git(source, "rev-parse", "--short=10", "HEAD")
        tracked = _git(source, "ls-files", "--error-unmatch", "__init__.py")
        changes = _git(source, "diff", "HEAD", "--", ":/", ":!/results", ":!/README.md", ":!/docs")
        new = _git(
            source, "ls-files", "--others", "--exclude-standard", ":/samarl", ":/envs", ":/conf"
        )
    except (OSError, subprocess.CalledProcessError):
        return samarl.__version__
    if not tracked:
        return samarl.__version__
    if not changes + new:
        return commit
    return f"{commit}-dirty.{hashlib.sha256((changes + new).encode()).hexdigest()[:8]}"


def machine() -> str:
    """The machine in words: processor, cores, Python."""
    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                name = line.split(":", 1)[1].strip()
                break
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}"


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
