"""Case files: the start of one episode, and what is changed while it runs.

They are YAML mappings, which `samarl-play` writes and people can edit:

- `scenario`: the fields of `Scenario` that differ from their defaults;
- `case`: its number, which determines whatever the file does not say;
- `walls`: polygons of points [x, y], two points for a thin wall, for layout `map` without a map
  file; `floor`: left, bottom, right and top of where people walk;
- `robots`, `people`: one mapping for each, with any of `position`, `velocity`, `goal`, `heading`
  (robots), and `radius`, `speed` and `path` (people); null: all as the case has it. A path is a
  list of [time, x, y], to which the person walks straight from its `position`, and from one to the
  next; afterwards it is simulated;
- `edits`: mappings with `time`, `robot` or `person` (a number), and one of `position` and `goal`,
  which take effect at that time, or the `action` of a robot in the step that begins then.

Units are m, s, m/s and rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mrsan.fields import ConfigurationError
from mrsan.fixed_map import FixedMap, map_of_polygons
from mrsan.kernels.walls import MOST_SEGMENTS
from mrsan.state import Floats
from mrsan.suggestions import choice_hint

_FARTHEST = 1e4  # m, or m/s, along an axis
_START = {"position": 2, "velocity": 2, "goal": 2}  # how many numbers a field has
_ROBOT = _START | {"heading": 1}
_PERSON = _START | {"radius": 1, "speed": 1}
_LOWEST = {"radius": 0.05, "speed": 0.0}
_HIGHEST = {"radius": 2.0, "speed": 10.0, "heading": 1e3}
Start = dict[str, Any]


class Edit(NamedTuple):
    """A change at a moment of an episode."""

    time: float  # s
    agent: str  # robot or person
    number: int  # which of them
    field: str  # position, goal or action
    value: tuple[float, ...]


class CaseFile(NamedTuple):
    """The content of a case file."""

    scenario: dict[str, Any]
    case: int
    walls: tuple[tuple[tuple[float, float], ...], ...]
    floor: tuple[float, ...]  # empty: the smallest rectangle around the walls
    robots: tuple[Start | None, ...]  # empty: all as the case has them
    people: tuple[Start | None, ...]
    edits: tuple[Edit, ...]


def read_case_file(path: str | Path) -> CaseFile:
    """Read and check a case file.

    Raises:
        ConfigurationError: names the field of the file, its value and what would be right.
    """
    file = Path(path)
    try:
        return _read(str(file.absolute()), file.stat().st_mtime_ns)
    except OSError as error:
        raise ConfigurationError(f"scenario.case_file is {str(path)!r}; {error.strerror}") from None


@lru_cache(maxsize=16)
def _read(path: str, changed: int) -> CaseFile:
    """Read a version of a file."""
    import yaml  # robots, which have no case files, need not have it

    try:
        content = yaml.load(
            Path(path).read_text(encoding="utf-8"),
            Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader),
        )
        return case_of(content)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise ConfigurationError(f"scenario.case_file: {path}: {reason:.200}") from None
    except ConfigurationError as error:
        raise ConfigurationError(f"scenario.case_file: {path}: {error}") from None


def case_of(content: Any) -> CaseFile:
    """Return the checked content of a case file.

    Raises:
        ConfigurationError: names the field, its value and what would be right.
    """
    fields = _mapping(content, "the file", CaseFile._fields)
    scenario, case = fields.get("scenario", {}), fields.get("case", 0)
    if not isinstance(scenario, dict):
        raise ConfigurationError(f"scenario is {scenario!r:.60}; it must be a mapping")
    if isinstance(case, bool) or not isinstance(case, int) or not 0 <= case < 2**62:
        raise ConfigurationError(f"case is {case!r:.60}; it must be a whole number of at least 0")
    walls = tuple(
        tuple(_numbers(point, f"walls[{k}]", 2) for point in _list(polygon, f"walls[{k}]"))
        for k, polygon in enumerate(_list(fields.get("walls"), "walls"))
    )
    for k, polygon in enumerate(walls):
        following = (*polygon[1:], polygon[:1][0]) if polygon else ()
        if len(polygon) < 2 or any(a == b for a, b in zip(polygon, following, strict=True)):
            raise ConfigurationError(
                f"walls[{k}] is {polygon!r:.60}; it must be two or more points, each different "
                "from the one before"
            )
    if sum(map(len, walls)) > MOST_SEGMENTS:
        raise ConfigurationError(
            f"walls has {sum(map(len, walls))} segments; it must have at most {MOST_SEGMENTS}"
        )
    floor = fields.get("floor")
    return CaseFile(
        scenario,
        case,
        walls,  # type: ignore[arg-type]
        () if floor is None else _numbers(floor, "floor", 4),
        _starts(fields.get("robots"), "robots", _ROBOT),
        _starts(fields.get("people"), "people", _PERSON),
        tuple(
            _edit(edit, f"edits[{k}]") for k, edit in enumerate(_list(fields.get("edits"), "edits"))
        ),
    )


def _starts(values: Any, name: str, sizes: dict[str, int]) -> tuple[Start | None, ...]:
    return tuple(
        None if value is None else _start(value, f"{name}[{k}]", sizes)
        for k, value in enumerate(_list(values, name))
    )


def _start(value: Any, name: str, sizes: dict[str, int]) -> Start:
    """Return the checked start of an agent; numbers by themselves are tuples of one."""
    permitted = [*sizes, *(["path"] if "speed" in sizes else [])]
    start: Start = {}
    for field, content in _mapping(value, name, permitted).items():
        path = f"{name}.{field}"
        if field == "path":
            points = [
                _numbers(point, f"{path}[{k}]", 3) for k, point in enumerate(_list(content, path))
            ]
            times = [time for time, _, _ in points]
            if any(b <= a for a, b in zip([0.0, *times], times, strict=False)):
                raise ConfigurationError(
                    f"{path} has times {times!r:.60}; they must increase from 0"
                )
            start[field] = points
            continue
        numbers = _numbers(content if sizes[field] > 1 else [content], path, sizes[field])
        low, high = _LOWEST.get(field, -_FARTHEST), _HIGHEST.get(field, _FARTHEST)
        if not all(low <= number <= high for number in numbers):
            raise ConfigurationError(
                f"{path} is {content!r:.60}; it must lie in [{low:g}, {high:g}]"
            )
        start[field] = numbers
    return start


def _edit(value: Any, name: str) -> Edit:
    fields = _mapping(value, name, ("time", "robot", "person", "position", "goal", "action"))
    agents = [agent for agent in ("robot", "person") if agent in fields]
    changes = [change for change in ("position", "goal", "action") if change in fields]
    if len(agents) != 1 or len(changes) != 1 or "time" not in fields:
        raise ConfigurationError(
            f"{name} has {', '.join(map(str, fields))}; it must have time, one of robot and "
            "person, and one of position, goal and action"
        )
    (agent,), (change,), number = agents, changes, fields[agents[0]]
    if isinstance(number, bool) or not isinstance(number, int) or number < 0:
        raise ConfigurationError(f"{name}.{agent} is {number!r:.60}; it must be its number, from 0")
    if change == "action" and agent == "person":
        raise ConfigurationError(f"{name}.action is that of a person; only robots have actions")
    time = _numbers([fields["time"]], f"{name}.time", 1)[0]
    if time < 0.0:
        raise ConfigurationError(f"{name}.time is {time}; it must be 0 or more")
    numbers = _numbers(fields[change], f"{name}.{change}", None if change == "action" else 2)
    return Edit(time, agent, number, change, numbers)


def _mapping(value: Any, name: str, permitted: Sequence[str]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigurationError(f"{name} is {value!r:.60}; it must be a mapping")
    for key in value:
        if key not in permitted:
            hint = choice_hint(str(key), list(permitted), f"{name} has {', '.join(permitted)}")
            raise ConfigurationError(f"{name} has {key!r:.60}; {hint}")
    return value


def _list(value: Any, name: str) -> list[Any]:
    if value is None:
        return []
    if not isinstance(value, list):
        raise ConfigurationError(f"{name} is {value!r:.60}; it must be a list")
    return value


def _numbers(value: Any, name: str, size: int | None) -> tuple[float, ...]:
    """Return a list of numbers, `size` of them unless it is None."""
    numbers = value if isinstance(value, list | tuple) else []
    valid = (
        isinstance(x, int | float) and not isinstance(x, bool) and abs(x) <= _FARTHEST
        for x in numbers
    )
    if len(numbers) != (len(numbers) if size is None else size) or not numbers or not all(valid):
        count = "numbers" if size is None else "a number" if size == 1 else f"{size} numbers"
        raise ConfigurationError(
            f"{name} is {value!r:.60}; it must be {count} of at most {_FARTHEST:g}"
        )
    return tuple(map(float, numbers))


def map_of_case(path: str, clearance: float) -> FixedMap:
    """Return the walls of a case file; see `mrsan.fixed_map.fixed_map`."""
    case = read_case_file(path)
    return _map_of(case.walls, case.floor, clearance)


@lru_cache(maxsize=16)
def _map_of(
    walls: tuple[tuple[tuple[float, float], ...], ...], floor: tuple[float, ...], clearance: float
) -> FixedMap:
    fixed = map_of_polygons([np.array(polygon) for polygon in walls], clearance)
    return fixed._replace(zone=np.array(floor, np.float32)) if floor else fixed


def steps_of(path: list[tuple[float, float, float]], time_step: float, steps: int) -> Floats:
    """Return the positions [T + 1, 2] at all steps of a path; NaN before and after it."""
    times, xs, ys = (np.array(values) for values in zip(*path, strict=True))
    now = np.arange(steps + 1) * time_step
    after = now > times[-1] + 1e-6
    before = now < times[0] - 1e-6
    out = np.stack([np.interp(now, times, xs), np.interp(now, times, ys)], -1)
    out[before | after] = math.nan
    return out.astype(np.float32)
