"""From episode records to a row of the table, and rows from files."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Crowd, Episodes, Scenario, social_score
from samarl.evaluation.metrics import METRICS, mean_interval, metric_fields, wilson_interval
from samarl.files import read_json

# One method in one column of the table: who and where, the metrics, and where it comes from.
Row = dict[str, Any]


class Column(NamedTuple):
    """Where rows were played; fields that a row lacks are as in Table I."""

    fov_degrees: float
    humans: int
    robots: int
    layout: str = "circle"
    goal_turn_degrees: float = 0.0
    team_perception: str = "none"
    recording: str | None = None  # the name of the file
    changes: str = ""  # other fields that are not as in the scenario of this name: `a=1 b=2`
    scenario: str = "samarl"  # its name
    collisions_end: bool = True

    @property
    def kind(self) -> str:
        """Under what a long table lists it."""
        if self.recording:
            return "Recorded people"
        if self.team_perception != "none":
            return "Robots that tell each other what they see"
        if not self.collisions_end:
            return "Collisions are counted and do not end the episode"
        if self.changes or self.scenario != Scenario.name:
            return "Other settings"
        if self.layout != "circle" or self.goal_turn_degrees:
            return "Other places"
        return "The circle"


IDENTITY = ("method", *Column._fields, "episodes")
PROVENANCE = ("command", "commit", "seed")
# What came of each case, in hexadecimal digits: whether it was a success, a bit each from the
# highest of the first byte on, and the rounded social score, a byte each.
BY_CASE = ("case_success", "case_social_score")
# What a row needs to be shown; other metrics may be missing where a row is older than they are.
HEADLINE = (
    "success_rate", "success_low", "success_high", "social_score", "social_low", "social_high",
)  # fmt: skip
_TEXTS = ("method", "layout", "team_perception", "changes", "scenario", "command", "commit")
_WHOLE = ("humans", "robots", "episodes", "seed", "training_seeds")
_OVER_SEEDS = [
    f"{name}_{key}" for name in ("success", "social") for key in ("iqm", "iqm_low", "iqm_high")
]
_NUMBERS = ("fov_degrees", "goal_turn_degrees", *_OVER_SEEDS)
_OF_SEEDS = ("success_of_seeds", "social_of_seeds")
NEEDED = [f for f in (*IDENTITY, *HEADLINE, *PROVENANCE) if f not in Column._field_defaults]


def row_fields() -> list[str]:
    """The fields of a row, in order."""
    return [*IDENTITY, *metric_fields(), *PROVENANCE, *BY_CASE]


def column_of(row: Row) -> Column:
    """The column a row belongs to."""
    return Column(**{name: row[name] for name in Column._fields if name in row})


def place_of(scenario: Scenario, named: Scenario | None = None) -> Column:
    """The column that a scenario is.

    Args:
        scenario: it.
        named: what the file of its name says. None: SAMARL's.
    """
    file = scenario.recording or "synthetic.txt"
    return Column(
        scenario.fov_degrees,
        scenario.humans,
        scenario.robots,
        scenario.layout.name,
        scenario.goal_turn_degrees,
        scenario.team_perception.name,
        Path(file).name if scenario.crowd == Crowd.recorded else None,
        _changes(scenario, named or Scenario()),
        scenario.name,
        scenario.collisions_end,
    )


def _changes(scenario: Scenario, named: Scenario) -> str:
    """The fields that no other field of a column tells of and that are not as in `named`.

    A name tells of the number of people and robots and of their views as well.
    """
    told = {"name", "frame_seconds", "recording_scale", "reward", "collisions_end"}
    if scenario.name == Scenario.name:
        told |= {*Column._fields}
    if scenario.crowd == Crowd.recorded:
        told |= {"crowd", "robot_way_min", "robot_way_max"}
    fields = changed_fields(scenario, named)
    return " ".join(f"{name}={value}" for name, value in fields if name not in told)


def changed_fields(given: Any, default: Any) -> Iterator[tuple[str, Any]]:
    """The fields of a dataclass that are not as in `default`: name and value, of enums the name."""
    for field in dataclasses.fields(given):
        value = getattr(given, field.name)
        if isinstance(value, dict):
            for key, item in value.items():
                if item != getattr(default, field.name).get(key):
                    yield f"{field.name}.{key}", item
        elif value != getattr(default, field.name):
            yield field.name, value.name if isinstance(value, Enum) else value


def summarise(
    episodes: Episodes, scenario: Scenario, method: str, command: str, commit: str, seed: int,
    named: Scenario | None = None,
) -> Row:  # fmt: skip
    """The row of one method in one scenario: rates in percent, lengths in m, times in s.

    Args:
        episodes: what happened.
        scenario: in which task.
        method: the name in the table.
        command: what produces the row again.
        commit: of the code that produced it.
        seed: the first case number.
        named: see `place_of`.
    """
    row: Row = {
        "method": method,
        **place_of(scenario, named)._asdict(),
        "episodes": len(episodes.case),
    }
    for known in METRICS.values():
        row |= known.of(episodes)
    score = social_score(episodes).mean(axis=1).round().astype(np.uint8)
    row |= {"command": command, "commit": commit, "seed": seed}
    return row | _in_digits(episodes.success, score)


def passed(row: Row) -> NDArray[np.bool_]:
    """Which cases of a row were a success, [B]."""
    bits = np.frombuffer(bytes.fromhex(row["case_success"]), np.uint8)
    return np.unpackbits(bits)[: row["episodes"]].astype(np.bool_)


def first_cases(row: Row, cases: int) -> Row:
    """The row of the first `cases` alone: success rate, and the mean of rounded social scores."""
    success = passed(row)[:cases]
    low, high = wilson_interval(int(success.sum()), cases)
    scores = np.frombuffer(bytes.fromhex(row["case_social_score"]), np.uint8)[:cases]
    rates = 100 * success.mean(), 100 * low, 100 * high, *mean_interval(scores.astype(np.float64))
    kept = {name: row[name] for name in (*IDENTITY, *PROVENANCE) if name in row}
    return kept | {"episodes": cases, **dict(zip(HEADLINE, rates, strict=True)),
                   **_in_digits(success, scores)}  # fmt: skip


def _in_digits(success: NDArray[np.bool_], scores: NDArray[np.uint8]) -> Row:
    """`BY_CASE` of a row."""
    digits = np.packbits(success).tobytes().hex(), scores.tobytes().hex()
    return dict(zip(BY_CASE, digits, strict=True))


def read_rows(path: Path) -> list[Row] | None:
    """The rows of a JSON file; None if it holds something else.

    Metrics that a row has and this version does not know are kept and not shown.

    Raises:
        ConfigurationError: it is not JSON, or rows lack a field they need or have a wrong one.
    """
    content = read_json(path)
    if not isinstance(content, list) or not any(map(_is_meant_as_row, content)):
        return None
    for number, row in enumerate(content):
        check_row(row, path, number)
    return content


def check_row(row: Any, path: Path, number: int = 0) -> None:
    """Refuse what is no row.

    Args:
        row: what stands in its place.
        path: of the file, for the error.
        number: which row of it.

    Raises:
        ConfigurationError: it lacks a field it needs, or has a wrong one.
    """
    seeds = isinstance(row, dict) and "training_seeds" in row
    needed = [*NEEDED, *_OVER_SEEDS, *_OF_SEEDS] if seeds else NEEDED
    for name in needed:
        if not isinstance(row, dict) or name not in row:
            raise ConfigurationError(
                f"{path} has no {name} in row {number}; every row must have {', '.join(needed)}"
            )
    for name, what in _wrong_fields(row):
        raise ConfigurationError(
            f"{path} has {name} {row[name]!r:.60} in row {number}; it must be {what}"
        )


def _wrong_fields(row: Row) -> Iterator[tuple[str, str]]:
    """The known fields of a row that hold what they may not, and what they must be."""
    for what, names, right in (
        ("a text", _TEXTS, lambda value: isinstance(value, str)),
        ("a whole number", _WHOLE, lambda value: isinstance(value, int) and 0 <= value < 2**63),
        ("a number", (*_NUMBERS, *HEADLINE), _is_number),
        ("a number or null", metric_fields(), lambda value: value is None or _is_number(value)),
        ("a text or null", ["recording"], lambda value: isinstance(value, str | None)),
        ("true or false", ["collisions_end"], lambda value: isinstance(value, bool)),
        ("hexadecimal digits", BY_CASE, _is_hexadecimal),
        ("a number of each training seed", _OF_SEEDS, lambda values: _are_numbers(values, row)),
    ):
        yield from ((name, what) for name in names if name in row and not right(row[name]))
    bits, scores = (len(row.get(name, "")) for name in BY_CASE)
    for name, length, digits in (
        (BY_CASE[0], bits, 2 * -(-row["episodes"] // 8)), (BY_CASE[1], scores, 2 * row["episodes"])
    ):  # fmt: skip
        if name in row and length != digits:
            yield name, f"{digits} digits"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < 1e12


def _are_numbers(values: Any, row: Row) -> bool:
    return (
        isinstance(values, list)
        and len(values) == row.get("training_seeds")
        and all(map(_is_number, values))
    )


def _is_hexadecimal(value: Any) -> bool:
    return isinstance(value, str) and bool(re.fullmatch("([0-9a-f]{2})*", value))


def _is_meant_as_row(item: Any) -> bool:
    return isinstance(item, dict) and bool({"method", "success_rate"} & item.keys())
