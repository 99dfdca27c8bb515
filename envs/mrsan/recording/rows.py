"""The rows of a recording, in the units of its file and in metres and seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FRAME_SECONDS = 0.04  # time between frame numbers of ETH, UCY and TrajNet, s
MAX_GAP = 3.0  # longest gap within a track; after a longer one a person begins another, s

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class RecordingError(ValueError):
    """A recording that cannot be used; the message names the reason and a remedy."""


@dataclass(frozen=True)
class Rows:
    """R rows of a file, one for each person in each frame, in the units of the file."""

    format: str  # name of the recognised format
    frame: Floats  # [R] frame numbers, or times
    person: Ints  # [R]
    position: Floats  # [R, 2]
    line: Ints  # [R] of the file, from 1
    frame_seconds: float | None = None  # time between frame numbers, if the file states it
    metres: float | None = None  # per unit of the positions, if the file states it
    pixels: bool = False  # the file states that its positions are in pixels
    notes: tuple[str, ...] = ()  # remarks for the user on how the file was read
    where: str = "line"  # what `line` counts


class Track(NamedTuple):
    """The rows of one person without gaps of more than `MAX_GAP`."""

    rows: Ints  # [K] indices of the rows, in order of time
    gap_before: float  # s since the person's previous track; infinity: there is none
    gap_after: float  # s to the person's next track


@dataclass(frozen=True)
class People:
    """All people of a recording, in metres and seconds; each is in a frame at most once."""

    rows: Rows  # without duplicates
    frame_seconds: float
    metres: float  # per unit of the positions in the file

    @cached_property
    def position(self) -> Floats:
        """Return the positions of the rows, [R, 2], m."""
        return self.rows.position * self.metres

    @property
    def centre(self) -> Floats:
        """Return the middle of the floor, [2], m."""
        return (self.position.min(0) + self.position.max(0)) / 2

    @cached_property
    def seconds(self) -> Floats:
        """Return the times of the rows since the first frame, [R], s."""
        return (self.rows.frame - self.rows.frame.min()) * self.frame_seconds

    @cached_property
    def tracks(self) -> list[Track]:
        """Return the tracks of all people, ordered by person and then by time."""
        person = self.rows.person
        order = np.lexsort((self.rows.frame, person))
        pauses = np.diff(self.seconds[order])
        changes = np.diff(person[order]) != 0
        ends = np.flatnonzero(changes | (pauses > MAX_GAP))
        gaps = [math.inf, *np.where(changes, math.inf, pauses)[ends].tolist(), math.inf]
        parts = np.split(order, ends + 1)
        return [Track(*track) for track in zip(parts, gaps[:-1], gaps[1:], strict=True)]


def without_duplicates(rows: Rows) -> Rows:
    """Drop rows that repeat another one.

    Raises:
        RecordingError: a person is at two positions in the same frame.
    """
    order = np.lexsort((rows.line, rows.frame, rows.person))
    repeated = (np.diff(rows.frame[order]) == 0) & (np.diff(rows.person[order]) == 0)
    first, second = order[:-1][repeated], order[1:][repeated]
    contradictions = (rows.position[first] != rows.position[second]).any(1)
    if contradictions.any():
        a, b = (index[np.argmax(contradictions)] for index in (first, second))
        (x, y), (u, v) = rows.position[a].tolist(), rows.position[b].tolist()
        raise RecordingError(
            f"person {rows.person[a]} is in frame {rows.frame[a]:.10g} twice, at ({x:g}, {y:g}) in "
            f"{rows.where} {rows.line[a]} and at ({u:g}, {v:g}) in {rows.where} {rows.line[b]}; it "
            "must be there only once"
        )
    if not len(second):
        return rows
    index = np.sort(np.setdiff1d(order, second))
    note = f"{len(second)} rows that repeat another one are omitted"
    return replace(
        rows,
        frame=rows.frame[index],
        person=rows.person[index],
        position=rows.position[index],
        line=rows.line[index],
        notes=(*rows.notes, note),
    )


def typical_step(rows: Rows) -> float | None:
    """Return the median number of frames between successive rows of a person.

    Returns None if no person has two rows.
    """
    order = np.lexsort((rows.frame, rows.person))
    steps = np.diff(rows.frame[order])[np.diff(rows.person[order]) == 0]
    steps = steps[steps > 0]
    return float(np.median(steps)) if len(steps) else None
