"""From episode records to a row of the table, and rows from files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mrsan import ConfigurationError, Episodes, Scenario
from samarl.evaluation.metrics import METRICS, metric_fields

# One method in one column of the table: who and where, the metrics, and where it comes from.
Row = dict[str, Any]

IDENTITY = ("method", "fov_degrees", "humans", "robots", "episodes")
PROVENANCE = ("command", "commit", "seed")
# What a row needs to be shown; other metrics may be missing where a row is older than they are.
HEADLINE = (
    "success_rate", "success_low", "success_high", "social_score", "social_low", "social_high",
)  # fmt: skip


def row_fields() -> list[str]:
    """The fields of a row, in order."""
    return [*IDENTITY, *metric_fields(), *PROVENANCE]


def summarise(
    episodes: Episodes, scenario: Scenario, method: str, command: str, commit: str, seed: int
) -> Row:
    """The row of one method in one scenario: rates in percent, lengths in m, times in s.

    Args:
        episodes: what happened.
        scenario: in which task.
        method: the name in the table.
        command: what produces the row again.
        commit: of the code that produced it.
        seed: the first case number.
    """
    row: Row = {
        "method": method,
        "fov_degrees": scenario.fov_degrees,
        "humans": scenario.humans,
        "robots": scenario.robots,
        "episodes": len(episodes.case),
    }
    for known in METRICS.values():
        row |= known.of(episodes)
    return row | {"command": command, "commit": commit, "seed": seed}


def read_rows(path: Path) -> list[Row] | None:
    """The rows of a JSON file; None if it holds something else.

    Metrics that a row has and this version does not know are kept and not shown.

    Raises:
        ConfigurationError: it is not JSON, or rows lack a field they need.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigurationError(f"{path} is not JSON ({error})") from error
    if not isinstance(content, list) or not any(map(_is_meant_as_row, content)):
        return None
    for number, row in enumerate(content):
        for name in (*IDENTITY, *HEADLINE, *PROVENANCE):
            if not isinstance(row, dict) or name not in row:
                raise ConfigurationError(
                    f"{path} has no {name} in row {number}; every row must have "
                    f"{', '.join((*IDENTITY, *HEADLINE, *PROVENANCE))}"
                )
    return content


def _is_meant_as_row(item: Any) -> bool:
    return isinstance(item, dict) and bool({"method", "success_rate"} & item.keys())
