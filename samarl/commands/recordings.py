"""The folder of recordings named on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from mrsan import ConfigurationError


def recordings_in(
    folder: str | None, frame_seconds: Mapping[str, float]
) -> dict[Path, float | None]:
    """Return the recordings in a folder, each with its `scenario.frame_seconds`.

    Args:
        folder: the setting `recordings`; None: no recordings.
        frame_seconds: values by file name without extension; None for other files.

    Raises:
        ConfigurationError: the folder contains no recordings.
    """
    if folder is None:
        return {}
    path = Path(folder)
    entries = sorted(path.iterdir()) if path.is_dir() else []
    files = [file for file in entries if file.suffix.lower() == ".txt"]
    if not files:
        raise ConfigurationError(f"recordings is {folder!r}; it must be a folder with *.txt files")
    return {file: frame_seconds.get(file.stem) for file in files}
