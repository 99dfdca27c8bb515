"""Checks that a recording shows walking people, which detect wrong units, clocks and columns.

The six recordings of ETH and UCY are within all limits: nobody in them exceeds 3.9 m/s, and their
95th percentiles of speed are 1.3 to 1.9 m/s.
"""

from __future__ import annotations

import math
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
_USUAL_SPEED_95 = 1.6  # 95th percentile of speed in ETH and UCY, m/s
_USUAL_CLOCKS = (0.001, 1 / 60, 1 / 30, 0.04, 1 / 15, 0.1, 0.4, 1.0)  # between frames, s
_USUAL_UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "kilometres": 1e3}  # m
_DEGREE = 1e5  # approximate length of a degree of latitude, m
_LARGEST_CROWDED_FLOOR = 150.0  # a larger floor suggests that the unit is not metres, m
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
    position, seconds, tracks = people.position, people.seconds, people.tracks
    steps = [_steps(seconds, track.rows) for track in tracks]
    begin, end = np.concatenate(steps, axis=1)
    distance = np.linalg.norm(position[end] - position[begin], axis=1)
    speeds = distance / np.maximum(seconds[end] - seconds[begin], _MIN_PAUSE)
    fastest = int(speeds.argmax()) if len(speeds) else None
    pauses, _ = _moves(people)
    sides = np.ptp(position, axis=0).tolist()
    return Summary(
        people=len(np.unique(people.rows.person)),
        tracks=len(tracks),
        rows=len(seconds),
        seconds=float(seconds.max()),
        floor=(sides[0], sides[1]),
        people_at_once=_people_at_once(people),
        speed_median=float(np.median(speeds)) if len(speeds) else 0.0,
        speed_95=float(np.quantile(speeds, 0.95)) if len(speeds) else 0.0,
        speed_largest=0.0 if fastest is None else float(speeds[fastest]),
        pause_median=float(np.median(pauses)) if len(pauses) else 0.0,
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


def _moves(people: People) -> tuple[Floats, Floats]:
    """Return the times (s) and distances (m) between all successive rows of each person."""
    order = np.lexsort((people.rows.frame, people.rows.person))
    same = np.diff(people.rows.person[order]) == 0
    distance = np.linalg.norm(np.diff(people.position[order], axis=0), axis=1)
    pauses = np.maximum(np.diff(people.seconds[order]), _MIN_PAUSE)
    return pauses[same], distance[same]


def _people_at_once(people: People) -> int:
    times = np.array([people.seconds[track.rows[[0, -1]]] for track in people.tracks])
    moments = np.concatenate([times[:, 0], times[:, 1]])
    changes = np.repeat([1, -1], len(times))
    order = np.lexsort((-changes, moments))  # arrivals count before simultaneous departures
    return int(np.cumsum(changes[order]).max())


def find_problem(people: People, summary: Summary | None = None) -> str | None:
    """Return the first problem of a recording with a remedy; None if it is plausible.

    Args:
        people: the recording.
        summary: its statistics. None: they are computed.
    """
    summary = summary or summarize(people)
    problems = (
        _contradiction,
        _ids,
        _sparse,
        _too_fast,
        _too_slow,
        _floor,
        _jump,
        _too_short,
        _too_dense,
    )
    return next(filter(None, (problem(people, summary) for problem in problems)), None)


def _contradiction(people: People, _: Summary) -> str | None:
    for name, value, stated in (
        ("frame_seconds", people.frame_seconds, people.rows.frame_seconds),
        ("recording_scale", people.metres, people.rows.metres),
    ):
        if stated and abs(value / stated - 1) > _CONTRADICTION:
            return (
                f"scenario.{name} is {value:g}, but the file states {stated:.4g}; it must be that "
                "or null"
            )
    return None


def _ids(_: People, s: Summary) -> str | None:
    if s.people < s.rows:
        return None
    return (
        f"each of its {s.people} people is in only one frame, so nobody walks; a person must have "
        "the same id in every frame"
    )


def _sparse(people: People, s: Summary) -> str | None:
    if s.pause_median <= MAX_GAP:
        return None
    pauses, distance = _moves(people)
    speed_95 = float(np.quantile(distance / pauses, 0.95))
    walking = MIN_SPEED_95 < speed_95 < MAX_SPEED_95
    hint = "annotate people more often" if walking else _clock_hint(people, speed_95)
    return (
        f"a person's frames are {_short(s.pause_median)} s apart; they must be at most {MAX_GAP:g} "
        f"s: {hint}"
    )


def _too_fast(people: People, s: Summary) -> str | None:
    jumps = s.speed_95 > _JUMP_FACTOR * s.speed_median  # of a few people
    if s.speed_median <= MAX_MEDIAN_SPEED and (s.speed_95 <= MAX_SPEED_95 or jumps):
        return None
    if _swapped(people):
        hint = (
            "are frame and id swapped? then name the columns in a first line, such as 'id frame x "
            "y'"
        )
    elif max(s.floor) > _LARGEST_CROWDED_FLOOR:
        hint = _scale_hint(people, s)
    else:
        hint = _clock_hint(people, s.speed_95)
        hint += ", or scenario.recording_scale if positions are not in metres"
    return f"{_speeds(s)}; people walk at about 1.3 m/s: {hint}"


def _too_slow(people: People, s: Summary) -> str | None:
    if s.speed_95 >= MIN_SPEED_95:
        return None
    small = max(s.floor) < 3 * FLOOR_SIDE[0]
    hint = _scale_hint(people, s) if small else _clock_hint(people, s.speed_95)
    return f"{_speeds(s)}; people walk at about 1.3 m/s: {hint}"


def _floor(_: People, s: Summary) -> str | None:
    low, high = FLOOR_SIDE
    if not low <= max(s.floor) <= high:
        return (
            f"the floor is {_sides(s)}; its longer side must lie in [{low:g}, {high:g}] m (is "
            "a person far away, or are positions not in metres? scenario.recording_scale)"
        )
    if s.people > 1 and min(s.floor) == 0:
        axis = "xy"[s.floor.index(0)]
        return f"{axis} is the same in all rows; it must be a coordinate (is it another column?)"
    return None


def _jump(people: People, s: Summary) -> str | None:
    if s.speed_largest <= MAX_SPEED:
        return None
    rows, (a, b) = people.rows, s.fastest
    return (
        f"person {rows.person[a]} moves at {s.speed_largest:.3g} m/s from frame "
        f"{rows.frame[a]:.10g} ({rows.where} {rows.line[a]}) to {rows.frame[b]:.10g} ({rows.where} "
        f"{rows.line[b]}); it must be at most {MAX_SPEED:g} m/s (do two people share an id?)"
    )


def _too_short(_: People, s: Summary) -> str | None:
    if s.seconds >= MIN_SECONDS:
        return None
    return (
        f"it lasts {_short(s.seconds)} s; it must last at least {MIN_SECONDS:g} s, so that robots "
        "can arrive while people are present"
    )


def _too_dense(_: People, s: Summary) -> str | None:
    area = math.prod(side + 1.0 for side in s.floor)  # bodies extend beyond their centres
    if s.people_at_once <= MAX_PER_SQUARE_METRE * area:
        return None
    return (
        f"{s.people_at_once} people are present at once on {_sides(s)}; it must be at most "
        f"{MAX_PER_SQUARE_METRE:g} per square metre"
    )


def _swapped(people: People) -> bool:
    """Return whether paths are much shorter when frame numbers and ids are exchanged."""
    rows = people.rows
    medians = []
    for frame, person in ((rows.frame, rows.person), (rows.person, rows.frame)):
        order = np.lexsort((frame, person))
        distance = np.linalg.norm(np.diff(rows.position[order], axis=0), axis=1)
        distance = distance[np.diff(person[order]) == 0]
        medians.append(np.median(distance) if len(distance) else math.inf)
    return bool(medians[1] < medians[0] / 3)


def _clock_hint(people: People, speed_95: float) -> str:
    """Suggest the time between frames at which people would walk at the usual speed."""
    if not speed_95:
        return "nobody moves"
    seconds = people.frame_seconds * speed_95 / _USUAL_SPEED_95
    usual = min(_USUAL_CLOCKS, key=lambda clock: abs(math.log(clock / seconds)))
    if not 0.5 < usual / seconds < 2:
        return (
            f"set scenario.frame_seconds to the time between frame numbers, about {seconds:.1g} s"
        )
    return f"are frame numbers {usual:.3g} s apart? then set scenario.frame_seconds={usual:.3g}"


def _scale_hint(people: People, s: Summary) -> str:
    """Suggest the unit of positions at which people would walk at the usual speed."""
    if not s.speed_95:
        return "nobody moves"
    metres = people.metres * _USUAL_SPEED_95 / s.speed_95
    for name, unit in _USUAL_UNITS.items():
        if 0.55 < metres / unit < 1.8:
            return f"are positions in {name}? then set scenario.recording_scale={unit:g}"
    if metres > _DEGREE / 3:
        return "are positions in degrees of latitude and longitude? they must be in metres"
    kind = "pixels" if metres < 1 else "fractions of the image"
    return (
        f"are positions in {kind}? then set scenario.recording_scale to the metres per unit, about "
        f"{metres:.1g}"
    )


def _speeds(s: Summary) -> str:
    return (
        f"the median speed is {_short(s.speed_median)} m/s and 95 % of all steps are below "
        f"{_short(s.speed_95)} m/s, on a floor of {_sides(s)}"
    )


def _sides(s: Summary) -> str:
    return f"{_short(s.floor[0])} x {_short(s.floor[1])} m"


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.3g}"
