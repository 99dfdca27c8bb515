"""Recorded pedestrians: `frame id x y` in metres, as ETH, UCY and TrajNet++ come.

Nobody in a recording reacts to a robot. The origin is moved to the middle of the floor.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SAMPLE = Path(__file__).parent / "recordings" / "synthetic.txt"
FARTHEST = 1e9  # from zero may numbers of frames and positions be
LEAST_STEP = 1e-6  # apart must the frames of a person be, in steps of the simulator
MOST_ROWS = 10**7  # steps that all people are there, together
COAST = 3.0  # people go on at constant velocity before and after they were seen, at most so long, s


class RecordingError(ValueError):
    """A file that is no recording; the message names the line and what would be right."""


class Recording(NamedTuple):
    """The ways of P people, step by step; the rows of one person follow each other."""

    first: NDArray[np.int32]  # [P] the step at which a person comes in, rising
    last: NDArray[np.int32]  # [P] the last step it is there
    row: NDArray[np.int32]  # [P] where in `position` it comes in
    position: NDArray[np.float32]  # [R, 2] m
    half_size: NDArray[np.float32]  # [2] half the sides of the floor that people walked on, m
    steps: int  # how long it is


NOBODY = Recording(
    first=np.zeros(0, np.int32),
    last=np.zeros(0, np.int32),
    row=np.zeros(0, np.int32),
    position=np.zeros((0, 2), np.float32),
    half_size=np.zeros(2, np.float32),
    steps=0,
)


def load_recording(path: Path | str | None, frame_seconds: float, time_step: float) -> Recording:
    """Read a recording and put it on the clock of the simulator.

    Args:
        path: a text file with a line `frame id x y` for each person in each frame, separated by
            white space or commas, or TrajNet++'s JSON lines. None: a synthetic one that ships.
        frame_seconds: the time from one frame number to the next, s (ETH and UCY: 0.04).
        time_step: of the simulator, s. Positions between frames lie on straight lines.

    Raises:
        RecordingError: the file cannot be read, or a line of it is wrong; which, and how.
    """
    path = SAMPLE if path is None else Path(path)
    try:
        changed = path.stat().st_mtime_ns
    except OSError as error:
        raise RecordingError(
            f"recording {path}: {error.strerror}; it must be a text file of 'frame id x y'"
        ) from None
    return _load(path, changed, frame_seconds, time_step)


@lru_cache(maxsize=16)
def _load(path: Path, changed: int, frame_seconds: float, time_step: float) -> Recording:
    rows = _read(path)
    places = rows[:, 2:]
    low, high = places.min(0), places.max(0)
    places -= (low + high) / 2
    steps = (rows[:, 0] - rows[:, 0].min()) * (frame_seconds / time_step)
    end = int(steps.max())
    found = []
    left = MOST_ROWS
    for person in np.unique(rows[:, 1]):
        mine = np.flatnonzero(rows[:, 1] == person)
        mine = mine[np.argsort(steps[mine])]
        apart = np.diff(steps[mine])
        left -= int(apart.sum()) + 1
        if left < 0 or (apart < LEAST_STEP).any():
            raise RecordingError(
                f"recording {path}: person {person:g} is there in frames that are too far apart or "
                "too near to each other"
            )
        way = _resampled(steps[mine], places[mine], end, round(COAST / time_step))
        if way is not None:
            found.append(way)
    found.sort(key=lambda way: way[0])
    lengths = np.array([len(places) for _, places in found], np.int32)
    first = np.array([begin for begin, _ in found], np.int32)
    return Recording(
        first=first,
        last=first + lengths - 1,
        row=np.cumsum(lengths, dtype=np.int32) - lengths,
        position=np.concatenate([places for _, places in found]).astype(np.float32),
        half_size=((high - low) / 2).astype(np.float32),
        steps=end,
    )


def _resampled(
    steps: NDArray[np.float64], places: NDArray[np.float64], end: int, coast: int
) -> tuple[int, NDArray[np.float64]] | None:
    """The first whole step at which a person is there, and its place at each; None: at none.

    Its `steps` rise.
    """
    if len(steps) > 1:  # it goes on as it came and as it left
        begin = (places[1] - places[0]) / (steps[1] - steps[0])
        leave = (places[-1] - places[-2]) / (steps[-1] - steps[-2])
        before, after = places[:1] - coast * begin, places[-1:] + coast * leave
        places = np.concatenate([before, places, after])
        steps = np.concatenate([steps[:1] - coast, steps, steps[-1:] + coast])
    whole = np.arange(max(np.ceil(steps[0]), 0), min(np.floor(steps[-1]), end) + 1)
    if not len(whole):
        return None
    return int(whole[0]), np.stack([np.interp(whole, steps, axis) for axis in places.T], -1)


def _read(path: Path) -> NDArray[np.float64]:
    """The rows `frame, id, x, y` of a file."""
    rows: list[tuple[float, ...]] = []
    seen: dict[tuple[float, ...], int] = {}  # in which line
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"recording {path} cannot be read as text ({error})") from None
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith(("#", '{"scene"')):
            continue
        try:
            row = _parsed(line)
        except (ValueError, KeyError, TypeError):
            raise RecordingError(
                f"recording {path}, line {number}: {line[:60]!r}; it must be four numbers, "
                "'frame id x y'"
            ) from None
        if row[:2] in seen:
            raise RecordingError(
                f"recording {path}, line {number}: person {row[1]:g} is in frame {row[0]:g} a "
                f"second time (line {seen[row[:2]]}); it must be there once"
            )
        seen[row[:2]] = number
        rows.append(row)
    if not rows:
        raise RecordingError(f"recording {path} is empty; it must have lines of 'frame id x y'")
    return np.array(rows)


def _parsed(line: str) -> tuple[float, ...]:
    if line.startswith("{"):  # TrajNet++
        track = json.loads(line)["track"]
        cells = [track[key] for key in ("f", "p", "x", "y")]
    else:
        cells = line.replace(",", " ").split()
    row = tuple(float(cell) for cell in cells)
    if len(row) != 4 or not np.isfinite(row).all() or np.abs([row[0], *row[2:]]).max() > FARTHEST:
        raise ValueError
    return row
