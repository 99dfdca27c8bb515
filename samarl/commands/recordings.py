"""The folder of recorded people that a command line names."""

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
        frame_seconds: by the names of files without extension; for other files it is null.

    Raises:
        ConfigurationError: there are no recordings in it.
    """
    if folder is None:
        return {}
    path = Path(folder)
    entries = sorted(path.iterdir()) if path.is_dir() else []
    files = [file for file in entries if file.suffix.lower() == ".txt"]
    if not files:
        raise ConfigurationError(
            f"recordings is {folder!r}; it must be a folder with *.txt files in it"
        )
    return {file: frame_seconds.get(file.stem) for file in files}
