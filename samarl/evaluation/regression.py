"""How a row compares with the committed row of the same method and column."""

from __future__ import annotations

import math
from collections.abc import Sequence

from samarl.evaluation.summary import BY_CASE, Row, column_of, first_cases
from samarl.evaluation.table import column_name, settings_of

_MEASURED = (
    "episodes", "success_rate", "social_score", "collision_rate", "timeout_rate", *BY_CASE,
)  # fmt: skip


def compare(row: Row, committed: Sequence[Row]) -> str:
    """One line: how a row compares with the committed row of the same method and column.

    One of fewer cases is compared with the first cases of that row. Just one episode that ends
    otherwise is close: the interval of all but one never reaches all, however many there are.
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
        [word for word in settings_of(of) if not word.startswith("evaluation.cases=")]
        for of in (row, old)
    ]
    if row["episodes"] != old["episodes"] or settings[0] != settings[1]:
        return (
            f"other    {change}; the committed row is of {old['command']}, {old['episodes']} cases"
        )
    one_episode = 100.0 / row["episodes"]  # may end otherwise on another processor
    apart = abs(row["success_rate"] - old["success_rate"])
    bounds = [("social_score", "social_low", "social_high", one_episode)]
    if not math.isclose(apart, one_episode, abs_tol=0.11):  # rates are rounded
        bounds.insert(0, ("success_rate", "success_low", "success_high", 0.0))
    for key, low, high, slack in bounds:
        smallest, largest = old[low], old[high]
        if not smallest - slack <= row[key] <= largest + slack:
            return f"DIFFERS  {change}: {key} is outside [{smallest:.1f}, {largest:.1f}]"
    return f"close    {change}, within the committed intervals"
