"""Comparison of table rows with committed ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

from samarl.evaluation.summary import CASE_FIELDS, Column, Row, column_of, first_cases
from samarl.evaluation.table import column_name, counts_collisions, row_settings

_MEASURED = (
    "episodes",
    "success_rate",
    "social_score",
    "collision_rate",
    "timeout_rate",
    *CASE_FIELDS,
)


def compare(row: Row, committed: Sequence[Row]) -> str:
    """Compare a row with the committed row of the same method and column, in one line.

    A row of fewer cases is compared with the first cases of the committed row. A single episode
    with another outcome always counts as close, since the interval of a rate of 100 % or 0 % may
    exclude it.
    """
    name = f"{row['method']} {column_name(column_of(row))}"
    same = [r for r in committed if (r["method"], column_of(r)) == (row["method"], column_of(row))]
    if not same:
        return f"new      {name}: no committed row"
    old = same[0]
    if row["episodes"] < old["episodes"] and row["seed"] == old["seed"] and "case_success" in old:
        row, old = first_cases(row, row["episodes"]), first_cases(old, row["episodes"])
    change = (
        f"{name}: success {old['success_rate']:.1f} -> {row['success_rate']:.1f} %, "
        f"social score {old['social_score']:.1f} -> {row['social_score']:.1f}"
    )
    if all(row.get(key) == old[key] for key in _MEASURED if key in old):
        return f"same     {change}"
    settings = [
        [word for word in row_settings(r) if not word.startswith("evaluation.cases=")]
        for r in (row, old)
    ]
    if row["episodes"] != old["episodes"] or settings[0] != settings[1]:
        return (
            f"other    {change}; the committed row has {old['episodes']} cases of {old['command']}"
        )
    one_episode = 100.0 / row["episodes"]  # its outcome may differ on another processor
    difference = abs(row["success_rate"] - old["success_rate"])
    bounds = [("social_score", "social_low", "social_high", one_episode)]
    if not math.isclose(difference, one_episode, abs_tol=0.11):  # rates are rounded
        bounds.insert(0, ("success_rate", "success_low", "success_high", 0.0))
    for key, low_key, high_key, tolerance in bounds:
        low, high = old[low_key], old[high_key]
        if not low - tolerance <= row[key] <= high + tolerance:
            return f"DIFFERS  {change}: {key} is outside [{low:.1f}, {high:.1f}]"
    return f"close    {change}, within the committed intervals"


def beside_committed(
    rows: Sequence[Row], committed: Sequence[Row], columns: Sequence[Column]
) -> list[Row]:
    """Return evaluated rows, labelled "(this run)", followed by committed rows of other methods.

    Committed rows are restricted to the cases of the evaluated rows of their column, so that all
    methods are compared on the same cases. Rows without a record of each case, and rows in which
    collisions are counted, are not restricted.
    """
    methods = {row["method"] for row in rows}
    longest = sorted(rows, key=lambda row: row["episodes"])
    cases = {column_of(row): (row["episodes"], row["seed"]) for row in longest}
    others = []
    for row in committed:
        column = column_of(row)
        if row["method"] in methods or column not in columns:
            continue
        episodes, seed = cases.get(column, (row["episodes"], row["seed"]))
        has_cases = "case_success" in row and not counts_collisions([row])
        if episodes < row["episodes"] and seed == row["seed"] and has_cases:
            row = first_cases(row, episodes)
        others.append(row)
    if not others:
        return list(rows)
    return [*({**row, "method": f"{row['method']} (this run)"} for row in rows), *others]
