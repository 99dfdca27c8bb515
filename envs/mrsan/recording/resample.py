"""From the rows of a recording to where everybody is at each step of the simulator."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.recording.rows import Floats, People, RecordingError

LEAST_STEP = 1e-6  # apart must the frames of a person be, in steps of the simulator
MOST_ROWS = 10**7  # steps for which all people are there, together
MOST_STEPS = 10**9  # that a recording lasts
COAST = 3.0  # people go on at constant velocity before and after they were seen, at most so long, s


class Recording(NamedTuple):
    """The tracks of P people, step by step; the positions of one track follow each other."""

    first: NDArray[np.int32]  # [P] the step at which a track begins, rising
    last: NDArray[np.int32]  # [P] the last step of a track
    row: NDArray[np.int32]  # [P] where in `position` a track begins
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


def resample(people: People, time_step: float) -> Recording:
    """Put people on the clock of the simulator, with the origin in the middle of their floor.

    Args:
        people: their rows.
        time_step: of the simulator, s. Positions between rows lie on straight lines.

    Raises:
        RecordingError: two rows of a person are nearly at the same time, all of them together are
            there for too long, or nobody is there at any step.
    """
    low, high = people.position.min(0), people.position.max(0)
    position = people.position - (low + high) / 2
    frame = people.rows.frame
    steps = (frame - frame.min()) * (people.frame_seconds / time_step)
    end = int(steps.max())
    _check_clock(people, steps)
    coast = round(COAST / time_step)
    paths: list[tuple[int, Floats]] = []
    for rows, *gaps in people.tracks:
        # At most half of a gap within a person, so that nobody is there twice.
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
        half_size=((high - low) / 2).astype(np.float32),
        steps=end,
    )


def _check_clock(people: People, steps: Floats) -> None:
    """Refuse what cannot be interpolated or does not fit into memory."""
    total = 0.0
    for track in people.tracks:
        total += steps[track.rows[-1]] - steps[track.rows[0]] + 1
        close = np.flatnonzero(np.diff(steps[track.rows]) < LEAST_STEP)
        if len(close):
            a, b = track.rows[close[0] : close[0] + 2]
            frame = people.rows.frame
            raise RecordingError(
                f"person {people.rows.person[a]} is there twice at nearly the same time, in frames "
                f"{frame[a]:.15g} and {frame[b]:.15g}; its frames must differ"
            )
    if total > MOST_ROWS or steps.max() > MOST_STEPS:
        raise RecordingError(
            f"it lasts {people.seconds.max():.3g} s, and its people are there for {total:.3g} "
            f"steps together; it must be at most {MOST_ROWS:.0e} steps (scenario.frame_seconds "
            f"is {people.frame_seconds:g})"
        )


def _at_whole_steps(
    steps: Floats, position: Floats, end: int, before: float, after: float
) -> tuple[int, Floats] | None:
    """Interpolate a track.

    Args:
        steps: [K] when its rows are, rising.
        position: [K, 2] m.
        end: the last step of the recording.
        before: steps for which the person has come as it comes.
        after: steps for which it goes on as it leaves.

    Returns:
        The first whole step at which the person is there, and its positions from there on; None if
        there is no such step.
    """
    if len(steps) > 1:
        velocity = np.diff(position, axis=0) / np.diff(steps)[:, None]
        begin, leave = position[:1] - before * velocity[0], position[-1:] + after * velocity[-1]
        position = np.concatenate([begin, position, leave])
        steps = np.concatenate([steps[:1] - before, steps, steps[-1:] + after])
    whole = np.arange(max(np.ceil(steps[0]), 0), min(np.floor(steps[-1]), end) + 1)
    if not len(whole):
        return None
    return int(whole[0]), np.stack([np.interp(whole, steps, axis) for axis in position.T], -1)
