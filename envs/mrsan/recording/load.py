"""Load a recording for a scenario."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from mrsan.recording.formats import read_rows
from mrsan.recording.plausibility import find_problem
from mrsan.recording.resample import Recording, resample
from mrsan.recording.rows import (
    FRAME_SECONDS,
    People,
    RecordingError,
    Rows,
    without_duplicates,
)

SAMPLE = Path(__file__).parent / "synthetic.txt"


def load_recording(
    path: Path | str | None,
    frame_seconds: float | None,
    time_step: float,
    scale: float | None = None,
    check: bool = True,
) -> Recording:
    """Read a recording, check that it is plausible and resample it to the simulator's time step.

    Args:
        path: a file of a format that docs/recordings.md lists. None: the included synthetic one.
        frame_seconds: time between frame numbers, s. None: the value that the file states, or 0.04
            as in ETH and UCY.
        time_step: of the simulator, s. Positions between rows are interpolated linearly.
        scale: metres per unit of its positions. None: the value that the file states, or 1.
        check: reject a recording that is implausible for walking people.

    Raises:
        RecordingError: the file cannot be read or is implausible; names the reason and a remedy.
    """
    path = SAMPLE if path is None else Path(path)
    try:
        modified = path.stat().st_mtime_ns
    except (OSError, ValueError):  # `read_rows` reports the reason; ValueError: a zero byte
        modified = 0
    return _load(path, modified, frame_seconds, time_step, scale, check)


@lru_cache(maxsize=16)
def _load(
    path: Path,
    modified: int,
    frame_seconds: float | None,
    time_step: float,
    scale: float | None,
    check: bool,
) -> Recording:
    people = read_people(path, frame_seconds, scale)
    problem = find_problem(people) if check else None
    if problem:
        reason = f"{problem}; scenario.recording_check=false uses it anyway"
        raise RecordingError(_described(path, people.rows, reason))
    try:
        return resample(people, time_step)
    except RecordingError as error:
        raise RecordingError(_described(path, people.rows, error)) from None


def read_people(
    path: Path, frame_seconds: float | None = None, scale: float | None = None
) -> People:
    """Read a recording in metres and seconds, without checking whether it is plausible.

    Args:
        path: of the file.
        frame_seconds: see `load_recording`.
        scale: see `load_recording`.

    Raises:
        RecordingError: the file cannot be read; names the reason and a remedy.
    """
    try:
        rows = read_rows(path)
    except RecordingError as error:
        raise RecordingError(f"recording is {str(path)!r}: {error}") from None
    try:
        rows = without_duplicates(rows)
    except RecordingError as error:
        raise RecordingError(_described(path, rows, error)) from None
    if rows.pixels and scale is None:
        reason = (
            "its positions are in pixels; set scenario.recording_scale to the metres per pixel "
            "(SDD: about 0.035), and scenario.frame_seconds unless it is 0.04 s (SDD: 0.0333)"
        )
        raise RecordingError(_described(path, rows, reason))
    return People(
        rows,
        frame_seconds=frame_seconds or rows.frame_seconds or FRAME_SECONDS,
        metres=scale or rows.metres or 1.0,
    )


def _described(path: Path, rows: Rows, reason: object) -> str:
    return f"recording is {str(path)!r}, read as {rows.format}: {reason}"
