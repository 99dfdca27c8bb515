"""The table as Markdown, beside the papers' figures."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mrsan import Scenario
from samarl.evaluation.metrics import METRICS, Metric, Shown
from samarl.evaluation.papers import PAPER_CO_PLANNING, PAPER_NAME, PAPER_SUCCESS
from samarl.evaluation.summary import Column, Row, column_of

_COLUMNS = ("agent=", "scenario=", "scenario.fov_degrees=", "scenario.humans=", "scenario.robots=")
_CHANGES = 3  # so many are named
_CO_PLANNING = ("csr", "cr", "apl", "ntc", "cir")  # the metrics of MSA3C, Table 2


def column_name(column: Column) -> str:
    """The column in short."""
    if column.scenario != Scenario.name:
        return place_name(column)
    words = [
        f"{column.fov_degrees:g}°",
        f"{column.humans}h",
        f"{column.robots}r",
        place_name(column),
    ]
    if column.recording:
        del words[1]
    return " ".join(filter(None, words))


def place_name(column: Column) -> str:
    """How a column differs from those of Table I besides its numbers."""
    words = [column.scenario] if column.scenario != Scenario.name else []
    if column.recording:
        words.append(Path(column.recording).stem)
    if column.layout != "circle" and not column.recording:
        words.append(column.layout)
    if column.goal_turn_degrees:
        words.append(f"{column.goal_turn_degrees:+g}°")
    if column.team_perception != "none":
        words.append("team")
    changes = column.changes.split()
    shown = changes if len(changes) <= _CHANGES else [*changes[: _CHANGES - 1], "..."]
    words += [word.replace("_", " ").replace("=", " ").replace(" True", "") for word in shown]
    return " ".join(words)


def settings_of(row: Row) -> list[str]:
    """Return what the command that made a row sets besides its method and its column."""
    try:
        words = shlex.split(row["command"])
    except ValueError:  # quotes that are not closed, in a file from elsewhere
        words = row["command"].split()
    return [word for word in words if "=" in word and not word.startswith(_COLUMNS)]


def as_text(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """A Markdown table whose columns line up, the first to the left and the rest to the right."""
    widths = [max(len(cells[i]) for cells in [header, *lines]) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        rest = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return f"| {' | '.join([first, *rest])} |"

    rule = "|" + "|".join(["-" * (widths[0] + 2), *("-" * (w + 1) + ":" for w in widths[1:])]) + "|"
    return "\n".join([line(header), rule, *(line(cells) for cells in lines)])


def rows_as_markdown(rows: Sequence[Row], with_settings: bool = False) -> str:
    """All rows with what is measured of each; see `rows_as_cells`."""
    return as_text(*rows_as_cells(rows, with_settings))


def tells_of_driving(rows: Sequence[Row]) -> bool:
    """Has some row what only the table of how the robots drive shows?"""
    fields = [f for f, known in METRICS.items() if known.shown is Shown.driving]
    return any(field in row for row in rows for field in fields)


def counts_collisions(rows: Sequence[Row]) -> bool:
    """Is some row of a scenario in which collisions do not end the episode?"""
    return any(not column_of(row).collisions_end for row in rows)


def rows_as_cells(
    rows: Sequence[Row], with_settings: bool = False, table: Shown = Shown.printed
) -> tuple[tuple[str, ...], list[list[str]]]:
    """The header, and the cells of each row with what is measured of it.

    Args:
        rows: the rows.
        with_settings: say what else was set on the command line, where that tells rows apart.
        table: which of them.
    """
    tables = (
        table if table is Shown.driving or not counts_collisions(rows) else table | Shown.counted
    )
    shown = [known for known in METRICS.values() if known.heading and tables & known.shown]
    measured = [known.heading for known in shown]
    header = ("method", "FOV", "humans", "robots", *measured)
    lines = [_cells(row, shown) for row in rows]
    places = [place_name(column_of(row)) for row in rows]
    if any(places):
        header = (*header[:4], "place", *header[4:])
        for line, place in zip(lines, places, strict=True):
            line.insert(4, place)
    if table is not Shown.driving:
        header += ("paper's success %",)
        for line, row in zip(lines, rows, strict=True):
            line.append(_of_the_paper(row))
    if table is not Shown.driving and any("training_seeds" in row for row in rows):
        header += ("seeds", "success % over seeds", "social score over seeds")
        for line, row in zip(lines, rows, strict=True):
            line += _over_seeds(row)
    names = {(row["method"], column_of(row)) for row in rows}
    if with_settings and len(names) < len(rows):
        header += ("settings",)
        for line, row in zip(lines, rows, strict=True):
            line.append(" ".join(settings_of(row)))
    return header, lines


def _cells(row: Row, shown: Sequence[Metric]) -> list[str]:
    return [
        row["method"],
        f"{row['fov_degrees']:g}°",
        str(row["humans"]),
        str(row["robots"]),
        *(known.cell(row) for known in shown),
    ]


def _of_the_paper(row: Row) -> str:
    """Its success rate, empty where it has none."""
    paper = PAPER_SUCCESS.get(column_of(row), {}).get(PAPER_NAME.get(row["method"], ""))
    return "" if paper is None else str(paper)


def _over_seeds(row: Row) -> list[str]:
    """Interquartile means with their intervals; empty where only one seed was trained."""
    if "training_seeds" not in row:
        return ["", "", ""]
    form = "{:.1f} [{:.1f}, {:.1f}]"
    of_both = [
        form.format(*(row[f"{name}_{key}"] for key in ("iqm", "iqm_low", "iqm_high")))
        for name in ("success", "social")
    ]
    return [str(row["training_seeds"]), *of_both]


def by_kind(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """The rows of each kind of column."""
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        kinds.setdefault(column_of(row).kind, []).append(row)
    return kinds


def grids_as_markdown(rows: Sequence[Row]) -> str:
    """A grid for each kind of column, under a heading if there are several."""
    kinds = by_kind(rows)
    if len(kinds) == 1:
        return grid_as_markdown(rows)
    return "\n\n".join(f"### {kind}\n\n{grid_as_markdown(of)}" for kind, of in kinds.items())


def grid_as_markdown(rows: Sequence[Row]) -> str:
    """Success and social score, a line per method, the paper's methods below ours.

    Where collisions are counted and do not end the episode, MSA3C's table instead.
    """
    if counts_collisions(rows):
        return as_text(*co_planning_as_cells(rows))
    grid = grid_of(rows)
    header = ["success % / social score", *map(column_name, grid.columns)]
    lines = [
        [method]
        + ["" if r is None else f"{r['success_rate']:.1f} / {r['social_score']:.1f}" for r in found]
        for method, found in grid.ours.items()
    ]
    for name, figures in grid.paper.items():
        lines.append([f"paper: {name}"] + ["" if f is None else f"{f} / -" for f in figures])
    return as_text(header, lines)


def co_planning_as_cells(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """MSA3C's metrics beside joint success: the header, and the paper's lines below ours."""
    shown = [METRICS[name] for name in ("success_rate", *_CO_PLANNING)]
    header = ["scenario", "method", *(known.heading for known in shown)]
    columns: dict[Column, list[Row]] = {}
    for row in rows:
        columns.setdefault(column_of(row), []).append(row)
    lines = []
    for column, found in columns.items():
        name = column_name(column)
        lines += [[name, row["method"], *(known.cell(row) for known in shown)] for row in found]
        paper = PAPER_CO_PLANNING.get((column.scenario, column.changes), {})
        for method, figures in paper.items():
            lines.append([name, f"paper: {method}", "", *(str(figure) for figure in figures)])
    return header, lines


class Grid(NamedTuple):
    """Rows as methods by columns."""

    columns: list[Column]
    ours: dict[str, list[Row | None]]  # of each method, a row for each column
    paper: dict[str, list[int | None]]  # the same of the paper's success rates


def grid_of(rows: Sequence[Row]) -> Grid:
    """Arrange rows by method and column, both in the order in which they come."""
    columns = list(dict.fromkeys(column_of(row) for row in rows))
    cells = {(row["method"], column_of(row)): row for row in rows}
    ours = {row["method"]: [cells.get((row["method"], c)) for c in columns] for row in rows}
    paper = {
        name: [PAPER_SUCCESS.get(column, {}).get(name) for column in columns]
        for name in next(iter(PAPER_SUCCESS.values()))
    }
    known = {name: figures for name, figures in paper.items() if set(figures) != {None}}
    return Grid(columns, ours, known)
