"""Learning curves, heat maps of sweeps and bars of robustness."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from numpy.typing import NDArray

from mrsan import ConfigurationError, Scenario
from samarl.evaluation.summary import Column, Row, column_of
from samarl.evaluation.table import column_name, grid_of, settings_of
from samarl.report.leaderboard import ranked
from samarl.report.style import COLOURS, INK, MUTED, STYLE

Curve = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]  # column: steps, values
_BASELINES = ("model_predictive", "perimeter")  # planners that curves are compared with
_AXES = {"fov_degrees": "field of view, degrees", "humans": "humans", "robots": "robots"}
_POINTS = 200  # more do not show
_DASHES = ("-", "--", ":", "-.")  # each for as many runs as there are colours
_PANELS = 5  # of a table, side by side at most
_LIGHT_TEXT, _DARK_TEXT = "#FDFDFD", "#111111"  # on the colours of a heat map, in any mode


def read_curve(path: Path) -> Curve:
    """The columns of a training's curve over its steps, without the gaps.

    Raises:
        ConfigurationError: it is no table of comma-separated values.
    """
    points: dict[str, list[tuple[float, float]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
    except (csv.Error, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path} is no curve ({error})") from error
    for line in lines:
        steps = _number(line.get("steps"))
        for column, text in line.items():
            value = _number(text)
            if column not in ("steps", "seconds") and math.isfinite(steps + value):
                points.setdefault(column, []).append((steps, value))
    return {column: (np.array(p).T[0], np.array(p).T[1]) for column, p in points.items()}


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except (ValueError, TypeError):  # a list of what a line has beyond the header
        return math.nan


def baselines(rows: Sequence[Row], column: str) -> dict[str, float]:
    """What planners reach on the test cases of the column that a validation curve is of, %."""
    found = re.fullmatch(r"validation/(success|social_score)_([\d.]+)_(\d+)h_(\d+)r", column)
    if not found:
        return {}
    key = {"success": "success_rate", "social_score": "social_score"}[found[1]]
    place = Column(float(found[2]), int(found[3]), int(found[4]))
    return {row["method"]: row[key] for row in rows
            if row["method"] in _BASELINES and column_of(row) == place}  # fmt: skip


def draw_curves(
    runs: dict[str, list[Curve]], column: str, levels: Mapping[str, float] | None = None
) -> Figure:
    """One column of all runs: the mean of a run's seeds as a line, their range as a band.

    Args:
        runs: the curves of each run's seeds.
        column: which to draw.
        levels: drawn as horizontal lines, by their names.
    """
    shown = {
        name: found
        for name, curves in runs.items()
        if (found := [curve[column] for curve in curves if column in curve])
    }
    entries = len(shown) + len(levels or {})
    size = (4.6, 3.0) if entries <= len(COLOURS) else (7.0, max(3.0, 0.6 + 0.185 * entries))
    with rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        axes = figure.add_subplot()
        scale = 100.0 if "success" in column else 1.0
        for i, name in enumerate(runs):  # of the same colour in every figure
            if name not in shown:
                continue
            found = shown[name]
            last = min(steps[-1] for steps, _ in found)  # where all seeds have come to
            grid = np.unique(np.concatenate([steps for steps, _ in found]))
            grid = grid[grid <= last]
            grid = grid[np.linspace(0, len(grid) - 1, min(len(grid), _POINTS)).astype(int)]
            values = scale * np.stack([np.interp(grid, *curve) for curve in found])
            colour, dashes = COLOURS[i % len(COLOURS)], _DASHES[i // len(COLOURS) % len(_DASHES)]
            seeds = f" ({len(found)} seeds)" if len(found) > 1 else " (1 seed)"
            axes.plot(grid, values.mean(0), dashes, color=colour, linewidth=1.5, label=name + seeds)
            if len(found) > 1:
                axes.fill_between(
                    grid, values.min(0), values.max(0), color=colour, alpha=0.18, linewidth=0
                )
        for i, (name, level) in enumerate((levels or {}).items()):
            dots = (0, (1 + 2 * i, 1 + i))
            axes.axhline(level, color=MUTED, linewidth=1.2, linestyle=dots, label=name)
        axes.set_title(curve_title(column), loc="left")
        axes.set_ylabel(_unit(column))
        axes.set_xlabel("world steps")
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        if "success" in column or "score" in column:
            axes.set_ylim(-2, 102)
        if entries > len(COLOURS):
            figure.legend(fontsize=8, loc="outside right upper")
        elif entries:
            axes.legend(fontsize=8, loc="best")
    return figure


def _unit(column: str) -> str:
    """What stands at the axis of a column's values."""
    if "success" in column:
        return "success %"
    if "score" in column:
        return "social score"
    return column.rpartition("/")[2].replace("_", " ")


def curve_title(column: str) -> str:
    """What a column of a curve is called."""
    group, _, name = column.rpartition("/")
    name = re.sub(r"_([\d.]+)_(\d+h)_(\d+r)$", r", \1° \2 \3", name)  # on the cases of a column
    name = name.replace("success", "success %").replace("_", " ")
    return f"{'training' if group == 'charts' else group}: {name}"


def draw_heat_map(rows: Sequence[Row], title: str) -> Figure:
    """Success over the field of view and the number of humans and robots."""
    views = sorted({row["fov_degrees"] for row in rows})
    crowds = sorted({(row["humans"], row["robots"]) for row in rows})
    success = np.full((len(crowds), len(views)), np.nan)
    for row in rows:
        place = crowds.index((row["humans"], row["robots"])), views.index(row["fov_degrees"])
        success[place] = row["success_rate"]
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 1.5 + 0.34 * len(crowds)), layout="constrained")
        axes = figure.add_subplot()
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
        mesh = axes.pcolormesh(success, cmap="cividis", vmin=0, vmax=100, edgecolors="face")
        for (y, x), value in np.ndenumerate(success):
            if not math.isnan(value):
                axes.text(x + 0.5, y + 0.5, f"{value:.0f}", ha="center", va="center", fontsize=8,
                          color=_LIGHT_TEXT if value < 55 else _DARK_TEXT)  # fmt: skip
        axes.set_xticks(np.arange(len(views)) + 0.5, [f"{view:g}°" for view in views])
        axes.set_yticks(np.arange(len(crowds)) + 0.5, [f"{h}h {r}r" for h, r in crowds])
        axes.set_xlabel("field of view")
        axes.set_title(title, loc="left")
        figure.colorbar(mesh, label="success %", pad=0.02).outline.set_visible(False)
    return figure


def draw_lines(
    rows: Sequence[Row], values: Sequence[float], name: str, title: str, lines: Sequence[str]
) -> Figure:
    """Success over a number, with its interval as a band.

    Args:
        rows: of all methods.
        values: the number in each row.
        name: what it is called.
        title: of the figure.
        lines: the name of the line that each row is on.
    """
    with rc_context(STYLE):
        figure = Figure(figsize=(4.6, 3.0), layout="constrained")
        axes = figure.add_subplot()
        for m, line in enumerate(dict.fromkeys(lines)):
            mine = sorted((x, row["success_rate"], row["success_low"], row["success_high"])
                          for x, row, of in zip(values, rows, lines, strict=True)
                          if of == line)  # fmt: skip
            x, rate, low, high = np.array(mine).T
            colour = COLOURS[m % len(COLOURS)]
            axes.plot(x, rate, marker="o", markersize=4, color=colour, label=line)
            axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.set_ylim(0, 100)
        axes.set_xlabel(name)
        axes.set_ylabel("success %, with the 95 % interval")
        axes.set_title(title, loc="left")
        figure.legend(fontsize=8, loc="outside lower left")
    return figure


def draw_bars(rows: Sequence[Row], title: str) -> Figure:
    """Success with its interval in one column of the table, for each setting and method."""
    labels = settings_labels(rows)
    settings, methods = list(dict.fromkeys(labels)), list(dict.fromkeys(r["method"] for r in rows))
    thickness = 0.8 / len(methods)
    with rc_context({**STYLE, "axes.grid.axis": "x"}):
        height = 1.2 + max(0.16 * len(methods), 0.3) * len(settings)
        figure = Figure(figsize=(4.6, height), layout="constrained")
        axes = figure.add_subplot()
        for m, method in enumerate(methods):
            mine = [(r, label) for r, label in zip(rows, labels, strict=True)
                    if r["method"] == method]  # fmt: skip
            rate = np.array([row["success_rate"] for row, _ in mine])
            low = np.array([row["success_low"] for row, _ in mine])
            high = np.array([row["success_high"] for row, _ in mine])
            place = [settings.index(label) - 0.4 + (m + 0.5) * thickness for _, label in mine]
            axes.barh(place, rate, 0.9 * thickness, color=COLOURS[m % len(COLOURS)], label=method,
                      xerr=(rate - low, high - rate), ecolor=INK,
                      error_kw={"elinewidth": 1, "capsize": 2})  # fmt: skip
        axes.set_yticks(range(len(settings)), settings)
        axes.invert_yaxis()
        axes.set_xlim(0, 100)
        axes.set_xlabel("success %, with the 95 % interval")
        axes.set_title(title, loc="left")
        axes.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
    return figure


def draw_table(rows: Sequence[Row]) -> Figure:
    """Success with its interval and social score of every method, a panel for each column."""
    grid = grid_of(rows)
    methods = [entry.name for entry in reversed(ranked(rows))]  # the first stands on top
    place = np.arange(len(methods))
    with rc_context({**STYLE, "axes.grid.axis": "x"}):
        down = math.ceil(len(grid.columns) / _PANELS)
        across = math.ceil(len(grid.columns) / down)
        size = (1.6 + 1.9 * across, 0.5 + (0.4 + 0.24 * len(methods)) * down)
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(down, across, sharey=True, squeeze=False).ravel()
        for unused in panels[len(grid.columns) :]:
            unused.set_visible(False)
        panels = panels[: len(grid.columns)]
        for c, (axes, column) in enumerate(zip(panels, grid.columns, strict=True)):
            found = [grid.ours[name][c] for name in methods]
            there = np.array([row is not None for row in found])
            rate, low, high, social = (
                np.array([row[key] for row in found if row is not None])
                for key in ("success_rate", "success_low", "success_high", "social_score")
            )
            axes.barh(place[there], rate, 0.7, color=COLOURS[5], label="success %, 95 % interval",
                      xerr=(rate - low, high - rate), ecolor=INK,
                      error_kw={"elinewidth": 1, "capsize": 2})  # fmt: skip
            axes.plot(social, place[there], "D", color=COLOURS[1], markersize=4,
                      label="social score")  # fmt: skip
            axes.set_xlim(0, 100)
            axes.set_title(column_name(column), loc="left")
        panels[0].set_yticks(place, methods)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2,
                      fontsize=8)  # fmt: skip
    return figure


def settings_labels(rows: Sequence[Row]) -> list[str]:
    """What was set for each row and not for all of them."""
    words = [settings_of(row) for row in rows]
    shared = set.intersection(*map(set, words))
    return [
        ", ".join(w.removeprefix("scenario.") for w in ws if w not in shared) or "default"
        for ws in words
    ]


def sweep_figures(rows: Sequence[Row]) -> Iterable[tuple[str, Figure]]:
    """What a sweep varies: a number alone as lines, views and crowds as maps, the rest as bars."""
    labels = settings_labels(rows)
    several = len(set(labels)) > 1
    names = [row["method"] + (f", {label}" if several else "")
             for row, label in zip(rows, labels, strict=True)]  # fmt: skip
    if len(_varied(rows)) == 1 and len(set(names)) <= len(COLOURS):
        yield _lines_over_axis(rows, names)
        return
    settings: dict[str, list[Row]] = {}
    columns: dict[Column, list[tuple[Row, str]]] = {}
    for row, label in zip(rows, labels, strict=True):
        settings.setdefault(label, []).append(row)
        columns.setdefault(Column(*column_of(row)[:3]), []).append((row, label))
    for label, mine in settings.items():
        suffix = f", {label}" if several else ""
        if len(_varied(mine)) == 1:
            yield _lines_over_axis(mine, [row["method"] for row in mine], suffix)
        elif _varied(mine):
            for method in dict.fromkeys(row["method"] for row in mine):
                of_method = [row for row in mine if row["method"] == method]
                yield method + suffix, draw_heat_map(of_method, method + suffix)
    for column, found in columns.items():
        of_column, of_label = [row for row, _ in found], [label for _, label in found]
        if len(set(of_label)) > 1:
            title = column_name(column)
            if number := _one_number(of_label):
                methods = [row["method"] for row in of_column]
                yield title, draw_lines(of_column, number[1], number[0], title, methods)
            else:
                yield title, draw_bars(of_column, title)


def _varied(rows: Sequence[Row]) -> list[str]:
    """Which of the axes rows differ in."""
    return [key for key in _AXES if len({row[key] for row in rows}) > 1]


def _lines_over_axis(
    rows: Sequence[Row], names: Sequence[str], suffix: str = ""
) -> tuple[str, Figure]:
    """Lines over the one axis that rows differ in, and their title."""
    key = _varied(rows)[0]
    values = [float(row[key]) for row in rows]
    title = _AXES[key] + suffix
    return title, draw_lines(rows, values, _AXES[key], title, names)


def _one_number(labels: Sequence[str]) -> tuple[str, list[float]] | None:
    """The name and the values of the one number that labels set; None if it is not one."""
    pairs = [label.partition("=") for label in labels]
    names = {name for name, sign, _ in pairs if sign}
    if len(names) != 1:
        return None
    name = names.pop()
    default = str(getattr(Scenario(), name, ""))
    values = [_number(value if sign else default) for _, sign, value in pairs]
    return (name.replace("_", " "), values) if np.isfinite(values).all() else None
