"""Table rows: their construction from episode records, and their files."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Crowd, Episodes, Layout, Scenario, social_score
from samarl.evaluation.metrics import METRICS, mean_interval, metric_fields, wilson_interval
from samarl.files import read_json

# One method in one column of a table: its identity, its metrics and its provenance.
Row = dict[str, Any]


class Column(NamedTuple):
    """The setting in which a method was evaluated; fields that a row lacks are as in Table I."""

    fov_degrees: float
    humans: int
    robots: int
    layout: str = "circle"
    goal_turn_degrees: float = 0.0
    team_perception: str = "none"
    recording: str | None = None  # name of its file
    changes: str = ""  # other fields that differ from the named scenario: `a=1 b=2`
    scenario: str = "samarl"  # `Scenario.name`
    terminate_on_collision: bool = True

    @property
    def kind(self) -> str:
        """The heading under which long tables list the column."""
        if self.recording:
            return "Recorded people"
        if self.team_perception != "none":
            return "Robots that share what they see"
        if not self.terminate_on_collision:
            return "Collisions do not end the episode"
        if self.changes or self.scenario != Scenario.name:
            return "Other settings"
        if self.layout != "circle" or self.goal_turn_degrees:
            return "Other layouts"
        return "The circle"


IDENTITY = ("method", *Column._fields, "episodes")
PROVENANCE = ("command", "commit", "seed")
# Results of each case in hexadecimal digits: its success as one bit, starting with the highest bit
# of the first byte, and its rounded social score as one byte.
CASE_FIELDS = ("case_success", "case_social_score")
# Metrics that every row must have; others may be missing in older rows.
HEADLINE = (
    "success_rate",
    "success_low",
    "success_high",
    "social_score",
    "social_low",
    "social_high",
)
_STRING_FIELDS = ("method", "team_perception", "changes", "scenario", "command", "commit")
_INTEGER_FIELDS = ("humans", "robots", "episodes", "seed", "training_seeds")
_SEED_STATISTICS = [
    f"{name}_seed_{key}" for name in ("success", "social") for key in ("mean", "min", "max")
]
_FLOAT_FIELDS = ("fov_degrees", "goal_turn_degrees", *_SEED_STATISTICS)
_SEED_VALUES = ("success_of_seeds", "social_of_seeds")
REQUIRED_FIELDS = [
    f for f in (*IDENTITY, *HEADLINE, *PROVENANCE) if f not in Column._field_defaults
]


def row_fields() -> list[str]:
    """Return the fields of a row, in order."""
    return [*IDENTITY, *metric_fields(), *PROVENANCE, *CASE_FIELDS]


def column_of(row: Row) -> Column:
    """Return the column of a row."""
    return Column(**{name: row[name] for name in Column._fields if name in row})


def scenario_column(scenario: Scenario, named: Scenario | None = None) -> Column:
    """Return the column of a scenario.

    `named` is the scenario in the file of the same name; None: SAMARL's.
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
        scenario.terminate_on_collision,
    )


def _changes(scenario: Scenario, named: Scenario) -> str:
    """Return the changed fields that the other fields of `Column` do not cover.

    The name of another scenario than SAMARL's covers the numbers of people and robots and the view.
    """
    covered = {"name", "frame_seconds", "recording_scale", "reward", "terminate_on_collision"}
    if scenario.name == Scenario.name:
        covered |= {*Column._fields}
    if scenario.crowd == Crowd.recorded:
        covered |= {"crowd", "route_length_min", "route_length_max"}
    fields = changed_fields(scenario, named)
    return " ".join(
        f"{name}={value}" for name, value in fields if name.partition(".")[0] not in covered
    )


def changed_fields(instance: Any, default: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and values of fields that differ from `default`; enums by member name.

    The fields of a dataclass in a field have names such as `reward.arrival`.
    """
    for field in dataclasses.fields(instance):
        value = getattr(instance, field.name)
        if dataclasses.is_dataclass(value):
            for name, item in changed_fields(value, getattr(default, field.name)):
                yield f"{field.name}.{name}", item
        elif isinstance(value, dict):
            for key, item in value.items():
                if item != getattr(default, field.name).get(key):
                    yield f"{field.name}.{key}", item
        elif value != getattr(default, field.name):
            yield field.name, value.name if isinstance(value, Enum) else value


def summarise(
    episodes: Episodes,
    scenario: Scenario,
    method: str,
    command: str,
    commit: str,
    seed: int,
    named: Scenario | None = None,
) -> Row:
    """Return the row of one method in one scenario: rates in percent, lengths in m, times in s.

    `seed` is the first case number; for `named` see `scenario_column`.
    """
    row: Row = {
        "method": method,
        **scenario_column(scenario, named)._asdict(),
        "episodes": len(episodes.case),
    }
    for metric in METRICS.values():
        row |= metric.row_fields(episodes)
    score = social_score(episodes).mean(axis=1).round().astype(np.uint8)
    row |= {"command": command, "commit": commit, "seed": seed}
    return row | _encode_cases(episodes.success, score)


def case_successes(row: Row) -> NDArray[np.bool_]:
    """Return the success of each case of a row, [B]."""
    bits = np.frombuffer(bytes.fromhex(row["case_success"]), np.uint8)
    return np.unpackbits(bits)[: row["episodes"]].astype(np.bool_)


def first_cases(row: Row, cases: int) -> Row:
    """Return the row restricted to its first cases, with rounded social scores per case."""
    success = case_successes(row)[:cases]
    low, high = wilson_interval(int(success.sum()), cases)
    scores = np.frombuffer(bytes.fromhex(row["case_social_score"]), np.uint8)[:cases]
    rates = 100 * success.mean(), 100 * low, 100 * high, *mean_interval(scores.astype(np.float64))
    common = {name: row[name] for name in (*IDENTITY, *PROVENANCE) if name in row}
    return common | {
        "episodes": cases,
        **dict(zip(HEADLINE, rates, strict=True)),
        **_encode_cases(success, scores),
    }


def _encode_cases(success: NDArray[np.bool_], scores: NDArray[np.uint8]) -> Row:
    """Return the `CASE_FIELDS` of a row."""
    digits = np.packbits(success).tobytes().hex(), scores.tobytes().hex()
    return dict(zip(CASE_FIELDS, digits, strict=True))


def read_rows(path: Path) -> list[Row] | None:
    """Return the rows of a JSON file, or None if it does not contain rows.

    Unknown metrics are preserved but not shown.

    Raises:
        ConfigurationError: the file is not JSON, or a field of a row is missing or invalid.
    """
    content = read_json(path)
    if not isinstance(content, list) or not any(map(_looks_like_row, content)):
        return None
    for number, row in enumerate(content):
        check_row(row, path, number)
    return content


def check_row(row: Any, path: Path, number: int = 0) -> None:
    """Check the fields of a row.

    Raises:
        ConfigurationError: a field is missing or invalid.
    """
    has_seeds = isinstance(row, dict) and "training_seeds" in row
    required = [*REQUIRED_FIELDS, *_SEED_STATISTICS, *_SEED_VALUES]
    required = required if has_seeds else REQUIRED_FIELDS
    for name in required:
        if not isinstance(row, dict) or name not in row:
            raise ConfigurationError(
                f"{path} has no {name} in row {number}; every row must have {', '.join(required)}"
            )
    for name, requirement in _invalid_fields(row):
        raise ConfigurationError(
            f"{path} has {name} {row[name]!r:.60} in row {number}; it must be {requirement}"
        )


def _invalid_fields(row: Row) -> Iterator[tuple[str, str]]:
    """Yield the name of each invalid field and the requirement that it does not meet."""
    for requirement, names, is_valid in (
        ("a string", _STRING_FIELDS, lambda value: isinstance(value, str)),
        (
            "a non-negative integer",
            _INTEGER_FIELDS,
            lambda value: isinstance(value, int) and 0 <= value < 2**63,
        ),
        ("a number", (*_FLOAT_FIELDS, *HEADLINE), _is_number),
        ("a number or null", metric_fields(), lambda value: value is None or _is_number(value)),
        ("the name of a layout", ["layout"], lambda value: value in list(Layout.__members__)),
        ("a string or null", ["recording"], lambda value: isinstance(value, str | None)),
        ("true or false", ["terminate_on_collision"], lambda value: isinstance(value, bool)),
        ("hexadecimal digits", CASE_FIELDS, _is_hexadecimal),
        (
            "a list with one number per training seed",
            _SEED_VALUES,
            lambda values: _are_numbers(values, row),
        ),
    ):
        yield from (
            (name, requirement) for name in names if name in row and not is_valid(row[name])
        )
    success, social_score = CASE_FIELDS
    for name, digits in (
        (success, 2 * -(-row["episodes"] // 8)),
        (social_score, 2 * row["episodes"]),
    ):
        if name in row and len(row[name]) != digits:
            yield name, f"{digits} hexadecimal digits"


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


def _looks_like_row(item: Any) -> bool:
    return isinstance(item, dict) and bool({"method", "success_rate"} & item.keys())
