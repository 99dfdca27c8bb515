"""Checks that a recording shows walking people, which detect wrong units, clocks and columns.

The six recordings of ETH and UCY are within all limits: nobody in them exceeds 3.9 m/s, and their
95th percentiles of speed are 1.3 to 1.9 m/s.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mrsan.recording.rows import MAX_GAP, Floats, Ints, People

MAX_SPEED = 5.0  # largest speed (running), m/s
MAX_MEDIAN_SPEED = 2.0  # largest median speed (the transition to running), m/s
MAX_SPEED_95 = 3.0  # largest 95th percentile of speed, m/s
MIN_SPEED_95 = 0.3  # smallest 95th percentile of speed, m/s
FLOOR_SIDE = (1.0, 300.0)  # range of the longer side of the floor, m
MIN_SECONDS = 6.0  # shortest duration: that of a robot's shortest route, s
MAX_PER_SQUARE_METRE = 10.0  # largest density of people
SPEED_WINDOW = 0.4  # time over which speeds are measured, which averages out noise, s
_MIN_PAUSE = 1e-9  # lower bound of times between rows, against rounding to zero, s
_USUAL_SPEED = 1.3  # m/s
_JUMP_FACTOR = 5.0  # a larger ratio of speed percentiles does not come from a wrong clock or unit
_CONTRADICTION = 0.02  # smallest relative difference between a setting and the file's statement


@dataclass(frozen=True)
class Summary:
    """Statistics of a recording, in metres and seconds."""

    people: int
    tracks: int
    rows: int
    seconds: float  # from the first frame to the last
    floor: tuple[float, float]  # along x and y, m
    people_at_once: int  # largest number
    speed_median: float  # of all steps of all people, m/s
    speed_95: float  # 95th percentile, m/s
    speed_largest: float  # m/s
    pause_median: float  # time between successive rows of a person, s; 0: nobody has two rows
    longest_gap: float  # longest time between successive rows of a person, s
    fastest: tuple[int, int]  # rows between which the largest speed occurs


def summarize(people: People) -> Summary:
    """Measure a recording."""
    position, seconds = people.position, people.seconds
    order = np.lexsort((people.rows.frame, people.rows.person))
    is_same = np.diff(people.rows.person[order]) == 0
    begin, end = order[:-1][is_same], order[1:][is_same]
    pauses = seconds[end] - seconds[begin]
    pause_median = float(np.median(pauses)) if len(pauses) else 0.0
    if pause_median <= MAX_GAP:  # else all tracks are too short to measure speeds
        begin, end = np.concatenate([_steps(seconds, t.rows) for t in people.tracks], axis=1)
    distance = np.linalg.norm(position[end] - position[begin], axis=1)
    speeds = distance / np.maximum(seconds[end] - seconds[begin], _MIN_PAUSE)
    fastest = int(speeds.argmax()) if len(speeds) else None
    sides = np.ptp(position, axis=0).tolist()
    return Summary(
        people=len(np.unique(people.rows.person)),
        tracks=len(people.tracks),
        rows=len(seconds),
        seconds=float(seconds.max()),
        floor=(sides[0], sides[1]),
        people_at_once=_people_at_once(people),
        speed_median=float(np.median(speeds)) if len(speeds) else 0.0,
        speed_95=float(np.quantile(speeds, 0.95)) if len(speeds) else 0.0,
        speed_largest=0.0 if fastest is None else float(speeds[fastest]),
        pause_median=pause_median,
        longest_gap=float(pauses.max()) if len(pauses) else 0.0,
        fastest=(0, 0) if fastest is None else (int(begin[fastest]), int(end[fastest])),
    )


def _steps(seconds: Floats, index: Ints) -> Ints:
    """Return pairs of rows of a track that are at least `SPEED_WINDOW` apart, [2, S].

    A shorter track is a single step.
    """
    times = seconds[index]
    ends = np.searchsorted(times, times + SPEED_WINDOW - 1e-6)
    begins = np.flatnonzero(ends < len(times))
    if not len(begins) and len(times) > 1:
        return index[[[0], [-1]]]
    return np.stack([index[begins], index[ends[begins]]])


def _people_at_once(people: People) -> int:
    times = np.array([people.seconds[track.rows[[0, -1]]] for track in people.tracks])
    moments = np.concatenate([times[:, 0], times[:, 1]])
    changes = np.repeat([1, -1], len(times))
    order = np.lexsort((-changes, moments))  # arrivals count before simultaneous departures
    return int(np.cumsum(changes[order]).max())


def find_problem(people: People, summary: Summary | None = None) -> str | None:
    """Return the first problem of a recording with a remedy; None if it is plausible."""
    return next(_problems(people, summary or summarize(people)), None)


def _problems(people: People, s: Summary) -> Iterator[str]:
    rows, (a, b), low, high = people.rows, s.fastest, *FLOOR_SIDE
    for name, value, stated in (
        ("frame_seconds", people.frame_seconds, rows.frame_seconds),
        ("recording_scale", people.metres, rows.metres),
    ):
        if stated and abs(value / stated - 1) > _CONTRADICTION:
            yield (
                f"scenario.{name} is {value:g}, but the file states {stated:.4g}; it must be that "
                "or null"
            )
    sides = f"{s.floor[0]:.4g} x {s.floor[1]:.4g} m"
    if s.people == s.rows:
        yield "each person is in only one frame; a person must have the same id in every frame"
    if s.pause_median > MAX_GAP:
        yield (
            f"a person's frames are {s.pause_median:.4g} s apart; they must be at most {MAX_GAP:g} "
            f"s: annotate people more often, or {_remedy(people, s)}"
        )
    jumps = s.speed_95 > _JUMP_FACTOR * s.speed_median  # of a few people
    is_fast = s.speed_median > MAX_MEDIAN_SPEED or (s.speed_95 > MAX_SPEED_95 and not jumps)
    if is_fast or s.speed_95 < MIN_SPEED_95:
        yield (
            f"the median speed is {s.speed_median:.3g} m/s and 95 % of all steps are below "
            f"{s.speed_95:.3g} m/s, on a floor of {sides}; people walk at {_USUAL_SPEED} m/s: "
            f"{_remedy(people, s)}"
        )
    if not low <= max(s.floor) <= high:
        yield (
            f"the floor is {sides}; its longer side must lie in [{low:g}, {high:g}] m (is a person "
            "far away, or are positions not in metres? scenario.recording_scale)"
        )
    if s.people > 1 and min(s.floor) == 0:
        axis = "xy"[s.floor.index(0)]
        yield f"{axis} is the same in all rows; it must be a coordinate (is it another column?)"
    if s.speed_largest > MAX_SPEED:
        yield (
            f"person {rows.person[a]} moves at {s.speed_largest:.3g} m/s from frame "
            f"{rows.frame[a]:.10g} ({rows.where} {rows.line[a]}) to {rows.frame[b]:.10g} "
            f"({rows.where} {rows.line[b]}); it must be at most {MAX_SPEED:g} m/s"
        )
    if s.seconds < MIN_SECONDS:
        yield f"it lasts {s.seconds:.3g} s; it must last at least {MIN_SECONDS:g} s"
    area = math.prod(side + 1.0 for side in s.floor)  # bodies extend beyond their centres
    if s.people_at_once > MAX_PER_SQUARE_METRE * area:
        yield (
            f"{s.people_at_once} people are present at once on {sides}; it must be at most "
            f"{MAX_PER_SQUARE_METRE:g} per square metre"
        )


def _remedy(people: People, s: Summary) -> str:
    """Return what would give people the usual speed."""
    factor = (s.speed_median or s.speed_95) / _USUAL_SPEED
    if not factor:
        return "nobody moves"
    frame_seconds = people.frame_seconds * factor
    clock = f"about {frame_seconds:.1g} s"
    if (people.rows.frame % 1.0).any() and 0.5 < frame_seconds < 2.0:
        clock = "1 s (frame numbers with fractions are seconds)"
    return (
        f"set scenario.frame_seconds to {clock}, or "
        f"scenario.recording_scale to about {people.metres / factor:.1g} m per unit, or name the "
        "columns in a first line such as 'id frame x y'"
    )
