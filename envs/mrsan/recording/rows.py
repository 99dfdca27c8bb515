"""The rows of a recording: as its file has them, and in metres and seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FRAME_SECONDS = 0.04  # between two frame numbers of ETH, UCY and TrajNet, s
MAX_GAP = 3.0  # after which a person who comes back begins another track, s

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class RecordingError(ValueError):
    """A recording that cannot be used; the message says what is wrong and what would be right."""


@dataclass(frozen=True)
class Rows:
    """R rows of a file, one for each person in each frame, in the units of the file."""

    format: str  # that was recognised
    frame: Floats  # [R] frame numbers, or times
    person: Ints  # [R]
    position: Floats  # [R, 2]
    line: Ints  # [R] of the file, from 1
    frame_seconds: float | None = None  # from one frame number to the next, if the file states it
    metres: float | None = None  # per unit of the positions, if the file states it
    pixels: bool = False  # the file states that its positions are in pixels
    notes: tuple[str, ...] = ()  # what a user should know of how the file was read
    where: str = "line"  # what `line` counts


class Track(NamedTuple):
    """A person without gaps of more than `MAX_GAP`."""

    rows: Ints  # [K] their indices, in order of time
    gap_before: float  # s since the person's previous track; infinity: there is none
    gap_after: float  # s to the person's next track


@dataclass(frozen=True)
class People:
    """Everybody in a recording, in metres and seconds; each person is in a frame once."""

    rows: Rows  # without duplicates
    frame_seconds: float
    metres: float  # per unit of the positions in the file

    @cached_property
    def position(self) -> Floats:
        """Where everybody is, [R, 2], m."""
        return self.rows.position * self.metres

    @cached_property
    def seconds(self) -> Floats:
        """When, [R], since the first frame, s."""
        return (self.rows.frame - self.rows.frame.min()) * self.frame_seconds

    @cached_property
    def tracks(self) -> list[Track]:
        """Everybody's tracks, in order of persons and then of time."""
        person = self.rows.person
        order = np.lexsort((self.rows.frame, person))
        pauses = np.diff(self.seconds[order])
        changes = np.diff(person[order]) != 0
        ends = np.flatnonzero(changes | (pauses > MAX_GAP))
        gaps = [math.inf, *np.where(changes, math.inf, pauses)[ends].tolist(), math.inf]
        parts = np.split(order, ends + 1)
        return [Track(*track) for track in zip(parts, gaps[:-1], gaps[1:], strict=True)]


def without_duplicates(rows: Rows) -> Rows:
    """Drop rows that say the same again.

    Raises:
        RecordingError: a person is in one frame at two places.
    """
    order = np.lexsort((rows.line, rows.frame, rows.person))
    again = (np.diff(rows.frame[order]) == 0) & (np.diff(rows.person[order]) == 0)
    first, second = order[:-1][again], order[1:][again]
    contradictions = (rows.position[first] != rows.position[second]).any(1)
    if contradictions.any():
        a, b = (index[np.argmax(contradictions)] for index in (first, second))
        (x, y), (u, v) = rows.position[a].tolist(), rows.position[b].tolist()
        raise RecordingError(
            f"person {rows.person[a]} is in frame {rows.frame[a]:.10g} twice, at ({x:g}, {y:g}) in "
            f"{rows.where} {rows.line[a]} and at ({u:g}, {v:g}) in {rows.where} {rows.line[b]}; it "
            "must be there once"
        )
    if not len(second):
        return rows
    index = np.sort(np.setdiff1d(order, second))
    note = f"{len(second)} rows that repeat another one are left out"
    return replace(
        rows,
        frame=rows.frame[index],
        person=rows.person[index],
        position=rows.position[index],
        line=rows.line[index],
        notes=(*rows.notes, note),
    )


def typical_step(rows: Rows) -> float | None:
    """The median number of frames from one row of a person to its next; None: nobody has two."""
    order = np.lexsort((rows.frame, rows.person))
    steps = np.diff(rows.frame[order])[np.diff(rows.person[order]) == 0]
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None
