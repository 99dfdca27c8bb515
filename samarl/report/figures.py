"""Figures of tables, learning curves and sweeps."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter
from numpy.typing import NDArray

from mrsan import Scenario
from samarl.evaluation.summary import Column, Row, column_of
from samarl.evaluation.table import column_name, column_title, grid_of, row_settings
from samarl.report.leaderboard import Line, ranked
from samarl.report.style import COLOURS, INK, MUTED, STYLE
from samarl.training.learning_curve import Curve, Points, number_in

_AXES = {"fov_degrees": "field of view, degrees", "humans": "humans", "robots": "robots"}
_UNITS = {  # of fields of the scenario that sweeps vary
    "position_noise": "m",
    "radius_noise": "m",
    "velocity_noise": "m/s",
    "missed_detection": "probability",
    "sensing_range": "m",
    "team_range": "m",
    "team_delay": "s",
    "team_loss": "probability",
}
_POINTS = 200  # drawn per curve
_DASHES = ("-", "--", ":", "-.")  # the next style once all colours are used
_PANELS = 5  # of a table, per line
_EQUAL_BOUNDS = re.compile(r"(\S+)_min=(\S+) \1_max=\2")  # `a.x_min=1 a.x_max=1`, or `a.x=1`
_FIELD = re.compile(r"(?:\w+\.)*(\w+)=(\S+)")  # `a.x=1`, or `x 1`
_MOST_PANELS = 30  # of a table
_CURVE_PANELS = 3  # per line
_LIGHT_TEXT, _DARK_TEXT = "#FDFDFD", "#111111"  # on a heat map, in light and dark mode


def draw_curves(runs: Mapping[str, Sequence[Curve]], *columns: str) -> Figure:
    """Draw columns of all runs in panels: means over seeds as lines, their ranges as bands."""
    width = min(len(columns), _CURVE_PANELS)
    height = math.ceil(len(columns) / width)
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6 * width, 3.0 * height), layout="constrained")
        panels = figure.subplots(height, width, squeeze=False).ravel()
        lines: dict[str, Line2D] = {}
        for axes, column in zip(panels, columns, strict=False):
            for i, (name, curves) in enumerate(runs.items()):
                seeds = [curve[column] for curve in curves if column in curve]
                if seeds:  # a run has the same colour in every panel
                    line = _draw_run(axes, i, seeds, 100.0 if is_success(column) else 1.0)
                    lines[f"{name} ({len(seeds)} seed{'s' if len(seeds) > 1 else ''})"] = line
            axes.set_title(curve_title(column), loc="left")
            axes.set_ylabel(curve_unit(column))
            axes.set_xlabel("world steps")
            axes.xaxis.set_major_formatter(EngFormatter(sep=""))
            if is_performance(column):
                axes.set_ylim(-2, 102)
        for unused in panels[len(columns) :]:
            unused.set_visible(False)
        if lines:
            handles, names = list(lines.values()), list(lines)
            figure.legend(handles, names, loc="outside lower left", ncols=width, fontsize=10)
    return figure


def _draw_run(axes: Axes, i: int, seeds: Sequence[Points], scale: float) -> Line2D:
    """Draw the mean and the range of the seeds of run `i`; return the line of the mean."""
    grid, *values = mean_and_range(seeds)
    mean, low, high = (scale * value for value in values)
    colour, dashes = COLOURS[i % len(COLOURS)], _DASHES[i // len(COLOURS) % len(_DASHES)]
    marker = "o" if len(grid) == 1 else None  # a single point has no line
    (line,) = axes.plot(grid, mean, dashes, marker=marker, color=colour, linewidth=1.5)
    if len(seeds) > 1:
        axes.fill_between(grid, low, high, color=colour, alpha=0.18, linewidth=0)
    return line


def mean_and_range(
    seeds: Sequence[Points], points: int = _POINTS
) -> tuple[NDArray[np.float64], ...]:
    """Return steps, mean, lowest and highest value, up to the last step all seeds have reached."""
    last = min(steps[-1] for steps, _ in seeds)
    grid = np.unique(np.concatenate([steps for steps, _ in seeds]))
    grid = grid[grid <= last]
    grid = grid[np.linspace(0, len(grid) - 1, min(len(grid), points)).astype(int)]
    values = np.stack([np.interp(grid, *curve) for curve in seeds])
    return grid, values.mean(0), values.min(0), values.max(0)


def is_performance(column: str) -> bool:
    """Return whether a column holds success rates or social scores."""
    return "success" in column or "score" in column


def is_success(column: str) -> bool:
    """Return whether a column holds success rates, which are shown in %."""
    return "success" in column


def curve_unit(column: str) -> str:
    """Return the axis label of a column's values."""
    if "success" in column:
        return "success %"
    if "score" in column:
        return "social score, 0 to 100"
    return column.rpartition("/")[2].replace("_", " ")


def curve_title(column: str) -> str:
    """Return the title of a column of a learning curve."""
    group, _, name = column.rpartition("/")
    name = re.sub(
        r"_([\d.]+)_(\d+)h_(\d+)r$", r", \1°, \2 people, \3 robots", name
    )  # column of a table
    name = name.replace("success", "success %").replace("_", " ")
    return f"{'training' if group == 'charts' else group}: {name}"


def draw_heat_map(rows: Sequence[Row], title: str) -> Figure:
    """Draw success over the field of view and the numbers of humans and robots as a heat map."""
    views = sorted({row["fov_degrees"] for row in rows})
    crowds = sorted({(row["humans"], row["robots"]) for row in rows})
    success = np.full((len(crowds), len(views)), np.nan)
    for row in rows:
        cell = crowds.index((row["humans"], row["robots"])), views.index(row["fov_degrees"])
        success[cell] = row["success_rate"]
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 1.5 + 0.3 * len(crowds)), layout="constrained")
        axes = figure.add_subplot()
        views_shown = [f"{view:g}°" for view in views]
        mesh = _draw_mesh(axes, success, views_shown, [f"{h}h {r}r" for h, r in crowds])
        axes.set_xlabel("field of view, degrees")
        axes.set_ylabel("humans (h), robots (r)")
        axes.set_title(title, loc="left")
        figure.colorbar(mesh, label="success %", pad=0.02).outline.set_visible(False)
    return figure


def _draw_mesh(
    axes: Axes, success: NDArray[np.float64], x_labels: Sequence[str], y_labels: Sequence[str]
) -> QuadMesh:
    """Draw success in % [Y, X] as coloured cells with numbers; NaN cells stay empty."""
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0)
    mesh = axes.pcolormesh(success, cmap="cividis", vmin=0, vmax=100, edgecolors="face")
    for (y, x), value in np.ndenumerate(success):
        if not math.isnan(value):
            colour = _LIGHT_TEXT if value < 55 else _DARK_TEXT
            text = f"{value:.0f}"
            axes.text(x + 0.5, y + 0.5, text, ha="center", va="center", fontsize=10, color=colour)
    axes.set_xticks(np.arange(len(x_labels)) + 0.5, x_labels)
    axes.set_yticks(np.arange(len(y_labels)) + 0.5, y_labels)
    return mesh


def draw_lines(
    rows: Sequence[Row], values: Sequence[float], name: str, title: str, lines: Sequence[str]
) -> Figure:
    """Draw success over a quantity, with its interval as a band."""
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 3.0), layout="constrained")
        axes = figure.add_subplot()
        for m, line in enumerate(dict.fromkeys(lines)):
            points = sorted(
                (x, row["success_rate"], row["success_low"], row["success_high"])
                for x, row, name_of_line in zip(values, rows, lines, strict=True)
                if name_of_line == line
            )
            x, rate, low, high = np.array(points).T
            colour = COLOURS[m % len(COLOURS)]
            axes.plot(x, rate, marker="o", markersize=4, color=colour, label=line)
            axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.set_ylim(0, 100)
        axes.set_xlabel(name)
        axes.set_ylabel("success %, 95 % interval")
        axes.set_title(title, loc="left")
        figure.legend(fontsize=10, loc="outside lower left")
    return figure


def draw_table(rows: Sequence[Row]) -> Figure:
    """Draw success with its interval and the social score of all methods, one panel per column.

    A table of very many columns is drawn as heat maps of success, one panel per method.
    """
    grid = grid_of(rows)
    lines = ranked(rows)
    if len(grid.columns) > _MOST_PANELS:
        return _draw_methods(grid.columns, lines)
    y = np.arange(len(lines))
    with rc_context({**STYLE, "axes.grid.axis": "x"}):
        height = math.ceil(len(grid.columns) / _PANELS)
        width = math.ceil(len(grid.columns) / height)
        size = (2.2 + 1.9 * width, 0.5 + (0.8 + 0.24 * len(lines)) * height)
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(height, width, sharey=True, squeeze=False).ravel()
        for unused in panels[len(grid.columns) :]:
            unused.set_visible(False)
        for c, (axes, column) in enumerate(zip(panels, grid.columns, strict=False)):
            cells = [line.rows[c] for line in lines]
            filled = np.array([row is not None for row in cells])
            rate, low, high, social = (
                np.array([row[key] for row in cells if row is not None])
                for key in ("success_rate", "success_low", "success_high", "social_score")
            )
            axes.barh(
                y[filled],
                rate,
                0.7,
                color=COLOURS[5],
                label="success %, 95 % interval",
                xerr=(rate - low, high - rate),
                ecolor=INK,
                error_kw={"elinewidth": 1, "capsize": 2},
            )
            axes.plot(social, y[filled], "D", color=COLOURS[1], markersize=4, label="social score")
            for line, row in enumerate(cells):
                text, colour = ("-", MUTED) if row is None else (f"{row['success_rate']:.0f}", INK)
                axes.text(105, line, text, va="center", fontsize=8, color=colour)
            axes.set_xlim(0, 100)
            axes.set_title(textwrap.fill(column_title(column), 21), loc="left", fontsize=10)
        panels[0].set_yticks(y, [line.label for line in lines])
        panels[0].set_ylim(len(lines) - 0.4, -0.6)  # of all
        handles, names = panels[0].get_legend_handles_labels()
        has_gaps = any(None in line.rows for line in lines)
        figure.legend(
            handles,
            names,
            title="numbers: success %" + (", -: not played" if has_gaps else ""),
            loc="outside lower center",
            ncols=2,
            fontsize=10,
        )
    return figure


def _draw_methods(columns: Sequence[Column], lines: Sequence[Line]) -> Figure:
    """Draw success of each method over its settings, and the numbers of people and robots."""
    settings = [[c.layout, *_EQUAL_BOUNDS.sub(r"\1=\2", c.changes).split()] for c in columns]
    shared = set.intersection(*map(set, settings))
    varied = [" ".join(word for word in words if word not in shared) for words in settings]
    y_labels = [_FIELD.sub(r"\1 \2", words).replace("_", " ") for words in varied]
    views = {column.fov_degrees for column in columns}
    x_labels = [
        (f"{column.fov_degrees:g}° " if len(views) > 1 else "")
        + f"{column.humans}h {column.robots}r"
        for column in columns
    ]
    ys, xs = list(dict.fromkeys(y_labels)), list(dict.fromkeys(x_labels))
    with rc_context(STYLE):
        width = min(len(lines), _CURVE_PANELS)
        height = math.ceil(len(lines) / width)
        size = (2.4 + 0.5 * len(xs) * width, 0.8 + (0.6 + 0.3 * len(ys)) * height)
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(height, width, sharey=True, squeeze=False).ravel()
        for axes, line in zip(panels, lines, strict=False):
            success = np.full((len(ys), len(xs)), np.nan)
            for x, y, row in zip(x_labels, y_labels, line.rows, strict=True):
                if row is not None:
                    success[ys.index(y), xs.index(x)] = row["success_rate"]
            mesh = _draw_mesh(axes, success, xs, ys)
            axes.set_title(textwrap.fill(line.label, 5 * len(xs)), loc="left", fontsize=10)
        panels[0].invert_yaxis()  # of all
        for unused in panels[len(lines) :]:
            unused.set_visible(False)
        label = "success %; humans (h), robots (r)"
        figure.colorbar(mesh, ax=panels, label=label, pad=0.02).outline.set_visible(False)
    return figure


def settings_labels(rows: Sequence[Row]) -> list[str]:
    """Return the overrides of each row that not all rows share."""
    words = [row_settings(row) for row in rows]
    shared = set.intersection(*map(set, words))
    return [
        ", ".join(w.removeprefix("scenario.") for w in ws if w not in shared) or "default"
        for ws in words
    ]


def sweep_figures(rows: Sequence[Row]) -> Iterable[tuple[str, Figure]]:
    """Yield title and figure of each part of a sweep.

    A single varied number is drawn as lines, several of view, humans and robots as heat maps, and
    other settings as a table.
    """
    labels = settings_labels(rows)
    has_settings = len(set(labels)) > 1
    names = [
        row["method"] + (f", {label}" if has_settings else "")
        for row, label in zip(rows, labels, strict=True)
    ]
    if len(_varied(rows)) == 1 and len(set(names)) <= len(COLOURS):
        yield _lines_over_axis(rows, names)
        return
    settings: dict[str, list[Row]] = {}
    columns: dict[Column, list[tuple[Row, str]]] = {}
    for row, label in zip(rows, labels, strict=True):
        settings.setdefault(label, []).append(row)
        columns.setdefault(Column(*column_of(row)[:3]), []).append((row, label))
    for label, group in settings.items():
        suffix = f", {label}" if has_settings else ""
        if len(_varied(group)) == 1:
            yield _lines_over_axis(group, [row["method"] for row in group], suffix)
        elif _varied(group):
            for method in dict.fromkeys(row["method"] for row in group):
                of_method = [row for row in group if row["method"] == method]
                yield method + suffix, draw_heat_map(of_method, method + suffix)
    for column, pairs in columns.items():
        column_rows, column_labels = [row for row, _ in pairs], [label for _, label in pairs]
        if len(set(column_labels)) > 1:
            title = column_name(column)
            if number := _single_number(column_labels):
                methods = [row["method"] for row in column_rows]
                yield title, draw_lines(column_rows, number[1], number[0], title, methods)
            else:
                yield title, draw_table(column_rows)


def _varied(rows: Sequence[Row]) -> list[str]:
    """Return the axes in which rows differ."""
    return [key for key in _AXES if len({row[key] for row in rows}) > 1]


def _lines_over_axis(
    rows: Sequence[Row], names: Sequence[str], suffix: str = ""
) -> tuple[str, Figure]:
    """Return title and figure of lines over the one axis in which rows differ."""
    key = _varied(rows)[0]
    values = [float(row[key]) for row in rows]
    title = _AXES[key] + suffix
    return title, draw_lines(rows, values, _AXES[key], title, names)


def _single_number(labels: Sequence[str]) -> tuple[str, list[float]] | None:
    """Return name and values if all labels set the same single number, otherwise None."""
    pairs = [label.partition("=") for label in labels]
    names = {name for name, sign, _ in pairs if sign}
    if len(names) != 1:
        return None
    name = names.pop()
    default = str(getattr(Scenario(), name, ""))
    values = [number_in(value if sign else default) for _, sign, value in pairs]
    title = ", ".join(filter(None, (name.replace("_", " "), _UNITS.get(name))))
    return (title, values) if np.isfinite(values).all() else None
