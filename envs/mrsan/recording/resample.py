"""The positions of recorded people at each step of the simulator."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.recording.rows import Floats, People, RecordingError

MIN_FRAME_STEPS = 1e-6  # smallest time between rows of a person, in steps of the simulator
MAX_ROWS = 10**7  # largest sum of the lengths of all tracks, in steps
MAX_STEPS = 10**9  # longest duration of a recording, in steps
COAST = 3.0  # longest continuation of a track at constant velocity, before and after it, s


class Recording(NamedTuple):
    """P tracks of people, with a position for each step."""

    first: NDArray[np.int32]  # [P] first step of each track, ascending
    last: NDArray[np.int32]  # [P] last step of each track
    row: NDArray[np.int32]  # [P] index in `position` of the first step of each track
    position: NDArray[np.float32]  # [R, 2] of each step, track by track, m
    half_size: NDArray[np.float32]  # [2] half the sides of the floor that people walked on, m
    centre: NDArray[np.float64]  # [2] of the floor, in the coordinates of the file, m
    steps: int  # duration


NOBODY = Recording(
    first=np.zeros(0, np.int32),
    last=np.zeros(0, np.int32),
    row=np.zeros(0, np.int32),
    position=np.zeros((0, 2), np.float32),
    half_size=np.zeros(2, np.float32),
    centre=np.zeros(2),
    steps=0,
)


def resample(people: People, time_step: float) -> Recording:
    """Interpolate the positions of people at the steps of the simulator.

    Args:
        people: the recording; its origin moves to the centre of the floor.
        time_step: of the simulator, s. Positions between rows are interpolated linearly.

    Raises:
        RecordingError: two rows of a person are nearly simultaneous, the tracks are too long in
            total, or no person is present at any step.
    """
    position = people.position - people.centre
    frame = people.rows.frame
    steps = (frame - frame.min()) * (people.frame_seconds / time_step)
    end = int(steps.max())
    _check_clock(people, steps)
    coast = round(COAST / time_step)
    paths: list[tuple[int, Floats]] = []
    for rows, *gaps in people.tracks:
        # At most half of the gap between tracks of a person, so that nobody is there twice.
        before, after = (min(coast, (gap / time_step - 1) / 2) for gap in gaps)
        path = _at_whole_steps(steps[rows], position[rows], end, before, after)
        if path is not None:
            paths.append(path)
    if not paths:
        raise RecordingError(
            f"nobody is there at a multiple of scenario.time_step ({time_step:g} s); people must "
            "be in several frames each"
        )
    paths.sort(key=lambda path: path[0])
    lengths = np.array([len(positions) for _, positions in paths], np.int32)
    first = np.array([begin for begin, _ in paths], np.int32)
    return Recording(
        first=first,
        last=first + lengths - 1,
        row=np.cumsum(lengths, dtype=np.int32) - lengths,
        position=np.concatenate([positions for _, positions in paths]).astype(np.float32),
        half_size=(np.ptp(people.position, axis=0) / 2).astype(np.float32),
        centre=people.centre,
        steps=end,
    )


def _check_clock(people: People, steps: Floats) -> None:
    """Check that the rows can be interpolated and that the result fits into memory."""
    total = 0.0
    for track in people.tracks:
        total += steps[track.rows[-1]] - steps[track.rows[0]] + 1
        close = np.flatnonzero(np.diff(steps[track.rows]) < MIN_FRAME_STEPS)
        if len(close):
            a, b = track.rows[close[0] : close[0] + 2]
            frame = people.rows.frame
            raise RecordingError(
                f"person {people.rows.person[a]} is there twice at nearly the same time, in frames "
                f"{frame[a]:.15g} and {frame[b]:.15g}; its frames must differ"
            )
    if total > MAX_ROWS or steps.max() > MAX_STEPS:
        raise RecordingError(
            f"it lasts {people.seconds.max():.3g} s, and its people are there for {total:.3g} "
            f"steps together; it must be at most {MAX_ROWS:.0e} steps (scenario.frame_seconds "
            f"is {people.frame_seconds:g})"
        )


def _at_whole_steps(
    steps: Floats, position: Floats, end: int, before: float, after: float
) -> tuple[int, Floats] | None:
    """Interpolate a track.

    Args:
        steps: [K] times of its rows in steps, ascending.
        position: [K, 2] m.
        end: the last step of the recording.
        before: steps for which the track is extended before its first row, at constant velocity.
        after: steps for which it is extended after its last row.

    Returns:
        The first whole step at which the person is present and the positions from that step on;
        None if there is no such step.
    """
    if len(steps) > 1:
        velocity = np.diff(position, axis=0) / np.diff(steps)[:, None]
        entry, exit = position[:1] - before * velocity[0], position[-1:] + after * velocity[-1]
        position = np.concatenate([entry, position, exit])
        steps = np.concatenate([steps[:1] - before, steps, steps[-1:] + after])
    whole = np.arange(max(np.ceil(steps[0]), 0), min(np.floor(steps[-1]), end) + 1)
    if not len(whole):
        return None
    return int(whole[0]), np.stack([np.interp(whole, steps, axis) for axis in position.T], -1)
