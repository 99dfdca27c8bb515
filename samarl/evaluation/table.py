"""Tables of rows as Markdown, next to the results in the papers."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from mrsan import Layout, Scenario
from samarl.evaluation.methods import label_of
from samarl.evaluation.metrics import METRICS, Metric, Tables
from samarl.evaluation.papers import PAPER_CO_PLANNING, PAPER_NAME, PAPER_SUCCESS
from samarl.evaluation.summary import Column, Row, column_of

_COLUMNS = (
    "agent=",
    "agent.",
    "scenario=",
    "scenario.fov_degrees=",
    "scenario.humans=",
    "scenario.robots=",
)
_MAX_CHANGES = 3  # named in a column heading
_CO_PLANNING = ("csr", "cr", "apl", "ntc", "cir")  # the metrics of MSA3C, Table 2


def column_name(column: Column) -> str:
    """Return a short name of a column."""
    if column.scenario != Scenario.name:
        return setting_name(column)
    words = [
        f"{column.fov_degrees:g}°",
        f"{column.humans}h",
        f"{column.robots}r",
        setting_name(column),
    ]
    if column.recording:
        del words[1]
    return " ".join(filter(None, words))


def column_title(column: Column) -> str:
    """Return the name of a column in words."""
    words = [
        f"{column.fov_degrees:g}° view",
        "" if column.recording else f"{column.humans} people",
        f"{column.robots} robots",
        setting_name(column).replace("_", " "),
    ]
    return ", ".join(filter(None, words))


def setting_name(column: Column) -> str:
    """Return how a column differs from those of Table I besides view, people and robots."""
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
    if len(changes) > _MAX_CHANGES:
        changes = [*changes[: _MAX_CHANGES - 1], "..."]
    words += [word.replace("_", " ").replace("=", " ").replace(" True", "") for word in changes]
    return " ".join(words)


def row_settings(row: Row) -> list[str]:
    """Return the overrides in a row's command other than its method and its column."""
    try:
        words = shlex.split(row["command"])
    except ValueError:  # unclosed quotes, in a file that another program wrote
        words = row["command"].split()
    return [word for word in words if "=" in word and not word.startswith(_COLUMNS)]


def markdown_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return an aligned Markdown table: first column left-aligned, the others right-aligned."""
    widths = [max(len(cells[i]) for cells in [header, *lines]) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        rest = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        return f"| {' | '.join([first, *rest])} |"

    rule = "|" + "|".join(["-" * (widths[0] + 2), *("-" * (w + 1) + ":" for w in widths[1:])]) + "|"
    return "\n".join([line(header), rule, *(line(cells) for cells in lines)])


def rows_as_markdown(rows: Sequence[Row], with_settings: bool = False) -> str:
    """Return a table with one line per row; see `rows_as_cells`."""
    return markdown_table(*rows_as_cells(rows, with_settings))


def has_driving_metrics(rows: Sequence[Row]) -> bool:
    """Return whether any row has metrics that only the table on driving shows."""
    fields = [f for f, metric in METRICS.items() if metric.tables is Tables.driving]
    return any(field in row for row in rows for field in fields)


def counts_collisions(rows: Sequence[Row]) -> bool:
    """Return whether collisions do not end the episode in the scenario of any row."""
    return any(not column_of(row).terminate_on_collision for row in rows)


def rows_as_cells(
    rows: Sequence[Row], with_settings: bool = False, table: Tables = Tables.printed
) -> tuple[tuple[str, ...], list[list[str]]]:
    """Return the header and the cells of each row.

    `with_settings` adds other overrides of the command line, where they distinguish rows.
    """
    driving = table is Tables.driving
    tables = table
    if not driving:
        tables |= Tables.counted if counts_collisions(rows) else Tables(0)
        tables |= Tables.walled if has_walls(rows) else Tables(0)
        tables |= Tables.grouped if has_groups(rows) else Tables(0)
    metrics = [metric for metric in METRICS.values() if metric.heading and tables & metric.tables]
    header = ("method", "FOV", "humans", "robots", *(metric.heading for metric in metrics))
    lines = [_cells(row, metrics) for row in rows]
    settings = [setting_name(column_of(row)) for row in rows]
    if any(settings):
        header = (*header[:4], "setting", *header[4:])
        for line, setting in zip(lines, settings, strict=True):
            line.insert(4, setting)
    if not driving:
        header += ("paper's success %",)
        for line, row in zip(lines, rows, strict=True):
            line.append(_paper_success(row))
    if not driving and any("training_seeds" in row for row in rows):
        header += ("seeds", "mean success % [range]", "mean social score [range]")
        for line, row in zip(lines, rows, strict=True):
            line += _seed_cells(row)
    names = {(row["method"], column_of(row)) for row in rows}
    if with_settings and len(names) < len(rows):
        header += ("overrides",)
        for line, row in zip(lines, rows, strict=True):
            line.append(" ".join(row_settings(row)))
    return header, lines


def has_walls(rows: Sequence[Row]) -> bool:
    """Return whether the rows are of walled environments."""
    return any(Layout[column_of(row).layout].has_walls for row in rows)


def has_groups(rows: Sequence[Row]) -> bool:
    """Return whether there are groups of people in the scenario of any row."""
    return any("groups.share=" in column_of(row).changes for row in rows)


def _cells(row: Row, metrics: Sequence[Metric]) -> list[str]:
    return [
        row["method"],
        f"{row['fov_degrees']:g}°",
        str(row["humans"]),
        str(row["robots"]),
        *(metric.cell(row) for metric in metrics),
    ]


def _paper_success(row: Row) -> str:
    """Return the success rate in the paper, empty if it has none."""
    rate = PAPER_SUCCESS.get(column_of(row), {}).get(PAPER_NAME.get(label_of(row["method"]), ""))
    return "" if rate is None else str(rate)


def _seed_cells(row: Row) -> list[str]:
    """Return number, means and ranges over training seeds; empty if only one was trained."""
    if "training_seeds" not in row:
        return ["", "", ""]
    form = "{:.1f} [{:.1f}, {:.1f}]"
    cells = [
        form.format(*(row[f"{name}_seed_{key}"] for key in ("mean", "min", "max")))
        for name in ("success", "social")
    ]
    return [str(row["training_seeds"]), *cells]


def group_by_kind(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Return the rows grouped by `Column.kind`."""
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        kinds.setdefault(column_of(row).kind, []).append(row)
    return kinds


def grids_as_markdown(rows: Sequence[Row], columns: Sequence[Column] = ()) -> str:
    """Return one grid per kind of column, with headings if there are several.

    Grids start with `columns`; others follow in order of appearance.
    """
    kinds = group_by_kind(rows)
    if len(kinds) == 1:
        return grid_as_markdown(rows, columns)
    return "\n\n".join(
        f"### {kind}\n\n{grid_as_markdown(group, columns)}" for kind, group in kinds.items()
    )


def grid_as_markdown(rows: Sequence[Row], columns: Sequence[Column] = ()) -> str:
    """Return a grid of success and social score, one line per method, then the paper's methods.

    If collisions do not end the episode, the table has the metrics of MSA3C instead.
    """
    if counts_collisions(rows):
        return markdown_table(*co_planning_as_cells(rows))
    grid = grid_of(rows, columns)
    header = ["success % / social score", *map(column_name, grid.columns)]
    lines = [
        [method]
        + ["" if r is None else f"{r['success_rate']:.1f} / {r['social_score']:.1f}" for r in cells]
        for method, cells in grid.ours.items()
    ]
    for name, figures in grid.paper.items():
        lines.append([f"paper: {name}"] + ["" if f is None else f"{f} / -" for f in figures])
    return markdown_table(header, lines)


def co_planning_as_cells(rows: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Return header and lines of joint success and MSA3C's metrics, with the paper's results."""
    metrics = [METRICS[name] for name in ("success_rate", *_CO_PLANNING)]
    header = ["scenario", "method", *(metric.heading for metric in metrics)]
    columns: dict[Column, list[Row]] = {}
    for row in rows:
        columns.setdefault(column_of(row), []).append(row)
    lines = []
    for column, group in columns.items():
        name = column_name(column)
        for row in group:
            lines.append([name, row["method"], *(metric.cell(row) for metric in metrics)])
        paper = PAPER_CO_PLANNING.get((column.scenario, column.changes), {})
        for method, figures in paper.items():
            lines.append([name, f"paper: {method}", "", *(str(figure) for figure in figures)])
    return header, lines


class Grid(NamedTuple):
    """Rows arranged as methods by columns."""

    columns: list[Column]
    ours: dict[str, list[Row | None]]  # per method, the row of each column
    paper: dict[str, list[int | None]]  # per method of the paper, its success rates, %


def grid_of(rows: Sequence[Row], columns: Sequence[Column] = ()) -> Grid:
    """Arrange rows by method and column, both in order of appearance.

    Those in `columns` come first, in this order, as far as they have rows.
    """
    present = list(dict.fromkeys(column_of(row) for row in rows))
    columns = [column for column in dict.fromkeys([*columns, *present]) if column in present]
    cells = {(row["method"], column_of(row)): row for row in rows}
    ours = {row["method"]: [cells.get((row["method"], c)) for c in columns] for row in rows}
    paper = {
        name: [PAPER_SUCCESS.get(column, {}).get(name) for column in columns]
        for name in next(iter(PAPER_SUCCESS.values()))
    }
    paper = {name: rates for name, rates in paper.items() if set(rates) != {None}}
    return Grid(columns, ours, paper)
