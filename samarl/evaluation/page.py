"""Markdown page of a table."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from samarl.evaluation.seeds import Improvements
from samarl.evaluation.summary import Column, Row, case_successes, column_of
from samarl.evaluation.table import column_name, grids_as_markdown, markdown_table, rows_as_markdown
from samarl.files import machine

_SEEDS = """ For methods with several
training seeds, the last columns give the mean over the seeds and the range from the worst to the
best seed."""


def page(
    name: str,
    about: str,
    rows: Sequence[Row],
    improvement: Sequence[Improvements] = (),
    headline: Sequence[str] = (),
) -> str:
    """Return the page of a table.

    Args:
        name: name of the table.
        about: its title and introduction.
        rows: its rows.
        improvement: probabilities of improvement, whose figure lies beside the page.
        headline: methods of the short table at the top, in this order; empty: no short table.
    """
    commits = ", ".join(sorted({row["commit"] for row in rows}))
    selection = [row for method in headline for row in rows if row["method"] == method]
    short = f"{grids_as_markdown(selection)}\n\n## All methods\n\n" if selection else ""
    return f"""# {about}
{short}{grids_as_markdown(rows)}
{_unsolved_cases(rows)}{_improvement(name, improvement)}
## All rows

<details markdown="1">
<summary>{len(rows)} rows with all metrics</summary>

{rows_as_markdown(rows)}

</details>

Created by `samarl-bench table={name}` at commit {commits} on {machine()}. Each row of
`{name}.json` holds the command that reproduces it.{
        _SEEDS if any("training_seeds" in row for row in rows) else ""
    }
"""


def _unsolved_cases(rows: Sequence[Row]) -> str:
    """Return a sentence on the cases among recorded people that no agent solves."""
    columns: dict[Column, list[Row]] = {}
    for row in rows:
        if row.get("recording"):
            columns.setdefault(column_of(row), []).append(row)
    shares = []
    for column, group in columns.items():
        cases = {(row["seed"], row["episodes"], "case_success" in row) for row in group}
        if len(cases) == 1 and "case_success" in group[0]:
            solved = np.any([case_successes(row) for row in group], axis=0)
            shares.append(f"{column_name(column)} {100 * (1 - solved.mean()):.1f} %")
    return f"\nCases that no agent solves: {', '.join(shares)}.\n" if shares else ""


def _improvement(name: str, improvement: Sequence[Improvements]) -> str:
    """Return the figure of the probabilities of improvement and tables of them, if there are any.

    The tables have a line for each other method, and a column for each of ours in each column.
    """
    tables = []
    for matrix in improvement:
        heads = [f"{method}, {column_name(column)}" for method, column in matrix.columns]
        lines = [
            [other, *map(_estimate, estimates)]
            for other, estimates in zip(matrix.others, matrix.estimates, strict=True)
        ]
        table = markdown_table(["better than", *heads], lines)
        tables.append(f"{matrix.quantity}:\n\n{table}\n")
    if not tables:
        return ""
    about = f"""
Probability of improvement (Agarwal et al., 2021): how often a seed of the method of a column is
better than a seed of the method of a line, with the 95 % interval. 0.5 means no difference.

![Probabilities of improvement as coloured matrices]({improvement_figure(name)})

<details markdown="1">
<summary>The probabilities with their intervals</summary>
"""
    return "\n".join([about, *tables, "</details>\n"])


def _estimate(values: Sequence[float]) -> str:
    """Return a probability with its interval as text; empty for NaN."""
    return "" if np.isnan(values[0]) else "{:.2f} [{:.2f}, {:.2f}]".format(*values)


def improvement_figure(name: str) -> str:
    """Return the name of the figure beside the page of the table `name`."""
    return f"{name}_improvement.png"
