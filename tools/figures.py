"""Figures of the documentation, looked up in `results/`.

A figure is named by words: the file in `results/` without its extension, what to look up in it,
and how to print it.

- In a table of results: the method, its column (`360/10/3`: view in degrees, humans, robots),
  optional conditions (`layout=doorway`), and `success`, `social`, `both`, `seeds` or
  `FIELD FORMAT`. Example: `table1 samarl 360/10/3 both`.
- In any other file: the path of a value, optional operations (`mean`, `/60`, `round3`,
  `change:PATH`, the change in percent from another value), and a format of Python. An item of a
  list is chosen by its index or by one of its values. Example:
  `throughput full_step.world_steps_per_second round3 ,.0f`.

`$` stands for a space in a method, in a condition or in a key of a path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any

from samarl.evaluation.summary import Row, column_of, read_rows
from samarl.files import read_json

RESULTS = Path(__file__).parents[1] / "results"


@cache
def result_rows(name: str) -> list[Row]:
    """Return the rows of `results/NAME.json`.

    Raises:
        ValueError: the file has no rows.
    """
    path = RESULTS / f"{name}.json"
    rows = read_rows(path)
    if rows is None:  # a table with its provenance beside it, such as that of physics
        content = read_json(path)
        rows = content.get("rows") if isinstance(content, dict) else None
    if not rows or any("fov_degrees" not in row for row in rows):
        raise ValueError(f"results/{name}.json is not a table of results")
    return rows


def find_row(name: str, method: str, column: str, conditions: Sequence[str] = ()) -> Row:
    """Return the row of a method in a column `VIEW/HUMANS/ROBOTS` of `results/NAME.json`.

    Raises:
        ValueError: not exactly one row matches.
    """
    fields = dict(zip(("fov_degrees", "humans", "robots"), column.split("/"), strict=True))
    fields |= dict(condition.replace("$", " ").split("=", 1) for condition in conditions)

    def matches(row: Row) -> bool:
        values = column_of(row)._asdict()
        return all(_text(values[key]) == value for key, value in fields.items())

    method = method.replace("$", " ")
    rows = [row for row in result_rows(name) if row["method"] == method and matches(row)]
    if len(rows) != 1:
        cell = " ".join([column, *conditions])
        raise ValueError(f"results/{name}.json has {len(rows)} rows of {method} in {cell}; need 1")
    return rows[0]


def _text(value: Any) -> str:
    """Return a field of a column as the words of a figure have it."""
    if value is None:
        return ""
    return f"{value:g}" if isinstance(value, float) else str(value)


def print_row(row: Row, kind: str) -> str:
    """Return `success`, `social`, `both` or `seeds` of a row as text."""
    if kind == "seeds":
        return "{:.1f} [{:.1f}, {:.1f}]".format(
            *(row[f"success_seed_{statistic}"] for statistic in ("mean", "min", "max"))
        )
    success, social = f"{row['success_rate']:.1f}", f"{row['social_score']:.1f}"
    return {"success": success, "social": social, "both": f"{success} / {social}"}[kind]


def find_value(name: str, path: str) -> Any:
    """Return the value at a path such as `a.b.0` in `results/NAME.json`.

    Raises:
        ValueError: there is no such value.
    """
    value = read_json(RESULTS / f"{name}.json")
    for key in path.replace("$", " ").split("."):
        if isinstance(value, list):
            named = [item for item in value if isinstance(item, dict) and key in item.values()]
            value = named[0] if named else value[int(key)]
        elif isinstance(value, dict) and key in value:
            value = value[key]
        else:
            raise ValueError(f"results/{name}.json has no {path}")
    return value


def _apply(operation: str, value: Any, name: str) -> float:
    if operation == "mean":
        return fmean(value)
    if operation.startswith("change:"):
        return float(100.0 * (value / find_value(name, operation.removeprefix("change:")) - 1.0))
    if operation == "round3":  # three significant digits
        return round(value, 2 - math.floor(math.log10(abs(value))))
    if operation.startswith("/"):
        return float(value) / float(operation[1:])
    raise ValueError(f"operation is {operation!r}; it must be mean, round3, /NUMBER or change:PATH")


def figure(words: Sequence[str]) -> str:
    """Return the figure that the words name, as text.

    Raises:
        ValueError: there is no such figure.
    """
    name, *rest = words
    if rest[-1] in ("success", "social", "both", "seeds"):
        method, column, *conditions, kind = rest
        return print_row(find_row(name, method, column, conditions), kind)
    if len(rest) > 3 and "/" in rest[1] and not rest[1].startswith("/"):
        method, column, *conditions, field, form = rest
        return format(find_row(name, method, column, conditions)[field], form)
    path, *operations, form = rest
    value = find_value(name, path)
    for operation in operations:
        value = _apply(operation, value, name)
    return format(value, form)
