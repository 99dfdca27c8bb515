"""Atomic file writing, and the provenance of results."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import subprocess
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

from mrsan import ConfigurationError

_SOURCE = Path(__file__).parent  # of this package


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path that replaces `path` on success and is removed on an error.

    Raises:
        ConfigurationError: the file cannot be written, for example because the disk is full.
    """
    temporary = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be written ({error.strerror or error})") from None


def check_writable(path: Path, field: str) -> None:
    """Check that a file can be written, before a long computation whose result it will hold.

    Messages name the setting `field`.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    try:
        with tempfile.TemporaryFile(dir=folder):  # if so, subfolders can be created as well
            pass
        if path.is_dir():
            raise IsADirectoryError("it is a folder")
    except OSError as error:
        raise ConfigurationError(
            f"{field} is {str(path)!r}, which cannot be written ({error.strerror or error})"
        ) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically, with one line per element of a top-level list."""
    if isinstance(content, list):
        text = "[\n" + ",\n".join(json.dumps(item) for item in content) + "\n]\n"
    else:
        text = json.dumps(content, indent=1) + "\n"
    write_text(path, text)


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        ConfigurationError: the file cannot be read or is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigurationError(f"{path} is not JSON ({error})") from error


def find_folder(name: str) -> Path:
    """Return `conf`, `examples` or `results`, in the installed package or next to the source."""
    installed = _SOURCE / name
    return installed if installed.is_dir() else _SOURCE.parent / name


def code_version() -> str:
    """Return the commit of the running code, with `-dirty` and a digest of uncommitted changes.

    The version of the package is returned instead if the code is not in a git repository.
    """
    try:
        commit = _git(_SOURCE, "rev-parse", "--short=10", "HEAD")
        tracked = _git(_SOURCE, "ls-files", "--error-unmatch", "__init__.py")
        changes = _git(_SOURCE, "diff", "HEAD", "--", ":/", ":!/results", ":!/README.md", ":!/docs")
        untracked = _git(
            _SOURCE, "ls-files", "--others", "--exclude-standard", ":/samarl", ":/envs", ":/conf"
        )
    except (OSError, subprocess.CalledProcessError):
        return version("samarl")
    if not tracked:
        return version("samarl")
    if not changes + untracked:
        return commit
    return f"{commit}-dirty.{hashlib.sha256((changes + untracked).encode()).hexdigest()[:8]}"


def machine() -> str:
    """Return processor, number of cores and Python version of this machine."""
    name = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        for line in (
            Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        ):
            if line.startswith("model name"):
                name = line.split(":", 1)[1].strip()
                break
    return f"{name}, {os.cpu_count()} cores, Python {platform.python_version()}"


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    output = subprocess.run(command, capture_output=True, check=True).stdout
    return output.decode("utf-8", "replace").strip()
