"""A table with all that is said around it, as a page of Markdown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from samarl.evaluation.seeds import probability_of_improvement
from samarl.evaluation.summary import Column, Row, column_of, passed
from samarl.evaluation.table import as_text, column_name, grids_as_markdown, rows_as_markdown
from samarl.files import machine

_OVER_SEEDS = """ Over training seeds: the interquartile mean (of fewer than four
seeds the mean) with the 95 % interval of 10,000 bootstrap draws of seeds."""


def page(
    name: str, about: str, rows: Sequence[Row], improvement_of: Sequence[str] = (),
    headline: Sequence[str] = (),
) -> str:  # fmt: skip
    """The page of a table.

    Args:
        name: of the table.
        about: its title and what it says first.
        rows: all of them.
        improvement_of: methods whose training seeds are compared with those of the others.
        headline: methods that have a short table of their own before all others, in this order.
    """
    commits = ", ".join(sorted({row["commit"] for row in rows}))
    first = [row for method in headline for row in rows if row["method"] == method]
    short = f"{grids_as_markdown(first)}\n\n## Every method\n\n" if first else ""
    return f"""# {about}
{short}{grids_as_markdown(rows)}
{_nobody_passed(rows)}{_improvement(rows, improvement_of)}
## Every row

{rows_as_markdown(rows)}

Made by `samarl-bench table={name}` at commit {commits} on {machine()}. Each row of `{name}.json`
holds the command that produces it alone.{
        _OVER_SEEDS if any("training_seeds" in row for row in rows) else ""
    }
"""


def _nobody_passed(rows: Sequence[Row]) -> str:
    """How many cases among recorded people no agent passes: nobody may be able to."""
    columns: dict[Column, list[Row]] = {}
    for row in rows:
        if row.get("recording"):
            columns.setdefault(column_of(row), []).append(row)
    shares = []
    for column, found in columns.items():
        of_same = {(row["seed"], row["episodes"], "case_success" in row) for row in found}
        if len(of_same) == 1 and "case_success" in found[0]:
            ever = np.any([passed(row) for row in found], axis=0)
            shares.append(f"{column_name(column)} {100 * (1 - ever.mean()):.1f} %")
    return f"\nCases that none of these agents passes: {', '.join(shares)}.\n" if shares else ""


def _improvement(rows: Sequence[Row], improvement_of: Sequence[str]) -> str:
    """How likely a training seed of some methods is better than one of each other."""
    with_seeds = [row for row in rows if "success_of_seeds" in row]
    lines = []
    for ours in (row for row in with_seeds if row["method"] in improvement_of):
        for theirs in with_seeds:
            same = all(ours[key] == theirs[key] for key in ("episodes", "seed"))
            if not same or column_of(theirs) != column_of(ours) or theirs is ours:
                continue
            names = [f"{row['method']} ({row['training_seeds']} seeds)" for row in (ours, theirs)]
            found = [
                probability_of_improvement(ours[key], theirs[key])
                for key in ("success_of_seeds", "social_of_seeds")
            ]
            cells = ["{:.2f} [{:.2f}, {:.2f}]".format(*of) for of in found]
            lines.append([*names, column_name(column_of(ours)), *cells])
    if not lines:
        return ""
    header = ("a seed of", "is better than one of", "in", "success", "social score")
    return f"\nProbability of improvement (Agarwal et al., 2021):\n\n{as_text(header, lines)}\n"
