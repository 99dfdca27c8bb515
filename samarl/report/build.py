"""The HTML report of a results folder."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from mrsan import ConfigurationError
from samarl.configuration import load_scenario
from samarl.evaluation.metrics import Tables
from samarl.evaluation.seeds import without_seed
from samarl.evaluation.summary import Row, read_rows, scenario_column
from samarl.evaluation.table import (
    co_planning_as_cells,
    column_name,
    counts_collisions,
    grid_of,
    group_by_kind,
    has_driving_metrics,
    rows_as_cells,
    setting_name,
)
from samarl.evaluation.trajectory import Trajectory
from samarl.files import atomic_write, code_version, write_text
from samarl.progress import progress_bar
from samarl.report.curves import Runs, chart_data, group_runs, is_performance
from samarl.report.figures import (
    baselines,
    curve_title,
    draw_curves,
    draw_table,
    read_curve,
    sweep_figures,
)
from samarl.report.leaderboard import GROUPS, is_best, ranked
from samarl.report.replays import as_replay
from samarl.report.style import PALETTE, save_figure

_TEMPLATES = Path(__file__).parent / "site"
_MARKER = "viewer.js"  # identifies the folder of an earlier report


@dataclass
class Table:
    """The rows of a file, or one kind of them."""

    name: str
    rows: list[Row]

    @property
    def key(self) -> str:
        """The name as part of a URL."""
        return slug(self.name)

    @property
    def episodes(self) -> str:
        """The number of cases per row, or the smallest and the largest number."""
        counts = sorted({row["episodes"] for row in self.rows})
        return " to ".join(str(count) for count in sorted({counts[0], counts[-1]}))

    def parts(self) -> list[Table]:
        """Return one table per kind of column, or an empty list if there is only one kind."""
        kinds = group_by_kind(self.rows)
        if len(kinds) == 1:
            return []
        return [Table(f"{self.name}: {kind.lower()}", rows) for kind, rows in kinds.items()]


@dataclass
class SavedFigure:
    """A figure saved as `figures/KEY.svg` and `figures/KEY.png`."""

    key: str
    title: str


def build_site(
    output: Path,
    results: Path,
    trajectories: Sequence[tuple[str, int, Trajectory]],
    split: str,
    command: str = "samarl-report",
) -> list[Path]:
    """Build all pages in a new folder, replacing an earlier report.

    Args:
        output: output folder.
        results: folder with tables in `*.json`, learning curves in `curves/*.csv` and sweeps in
            `sweeps/*.json`.
        trajectories: for each replay the name of the method, the index of the case in the split,
            and the trajectory.
        split: name of the split.
        command: command line shown in the footer.

    Returns:
        All files of the report.

    Raises:
        ConfigurationError: the folder contains other files, or a result cannot be read.
    """
    if output.exists() and not (output / _MARKER).is_file() and any(output.iterdir()):
        raise ConfigurationError(
            f"output is {str(output)!r}; it must be a new folder or contain an earlier report"
        )
    site = output.with_name(output.name + ".part")
    shutil.rmtree(site, ignore_errors=True)
    try:
        _build_pages(site, results, trajectories, split, command)
        if output.exists():
            shutil.rmtree(output)
        site.replace(output)
    finally:
        shutil.rmtree(site, ignore_errors=True)
    return sorted(file for file in output.rglob("*") if file.is_file())


def _build_pages(
    site: Path,
    results: Path,
    trajectories: Sequence[tuple[str, int, Trajectory]],
    split: str,
    command: str,
) -> None:
    """Write all files of the report into the folder `site`; see `build_site`."""
    tables, sweeps = read_tables(results), read_tables(results / "sweeps")
    transfer = [part for table in tables for part in table.parts()]
    tables = [table for table in tables if not table.parts()]
    runs = read_runs(results / "curves")
    pages = {
        "index": "Results",
        "transfer": "Transfer" if transfer else "",
        "curves": "Learning curves" if runs else "",
        "sweeps": "Sweeps" if sweeps else "",
        "replays": "Replays" if trajectories else "",
    }
    environment = _environment(
        pages={page: title for page, title in pages.items() if title},
        command=command,
        cards=_copy_cards(results / "checkpoints", site),
    )

    def write(name: str, **content: Any) -> None:
        write_text(site / name, environment.get_template(name).render(page=name, **content))

    write("site.css", palette=PALETTE)
    headlines = {
        table.name: _save(draw_table(table.rows), table.key, table.name, site)
        for table in (*tables, *transfer)
    }
    write("index.html", tables=tables, headlines=headlines)
    if transfer:
        write("transfer.html", tables=transfer, headlines=headlines)
    if runs:
        rows = [row for table in tables for row in table.rows]
        groups = group_runs(runs, results / "checkpoints")
        figures = _draw_runs(groups, rows, site)
        write("curves.html", figures=figures, chart=chart_data(groups))
    if sweeps:
        drawn = {sweep.name: _draw_sweep(sweep, site) for sweep in sweeps}
        write("sweeps.html", sweeps=sweeps, figures=drawn)
    if trajectories:
        write("replays.html", replays=_write_replays(trajectories, split, site))
    for script in _TEMPLATES.glob("*.js"):
        write_text(site / script.name, script.read_text(encoding="utf-8"))


def _environment(**variables: Any) -> Environment:
    """Return the template environment with the functions and variables that templates use."""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.globals |= variables | {
        "commit": code_version(),
        "grid_of": grid_of,
        "co_planning_as_cells": co_planning_as_cells,
        "counts_collisions": counts_collisions,
        "setting_name": setting_name,
        "rows_as_cells": rows_as_cells,
        "has_driving_metrics": has_driving_metrics,
        "Tables": Tables,
        "groups": GROUPS,
        "ranked": ranked,
        "is_best": is_best,
    }
    return environment


def read_tables(folder: Path) -> list[Table]:
    """Return the tables in the JSON files of a folder that contain rows, those of papers first.

    Raises:
        ConfigurationError: a file is not JSON, or a field of a row is missing or invalid.
    """
    tables = []
    paths = sorted(folder.glob("*.json"))
    for path in sorted(paths, key=lambda path: not path.stem.startswith("table")):
        rows = read_rows(path)
        if rows is not None:
            tables.append(Table(readable(path.stem), rows))
    return tables


def read_runs(folder: Path) -> Runs:
    """Return the curves of a folder by run; files `NAME_seedK.csv` belong to one run."""
    runs: Runs = {}
    for path in sorted(folder.glob("*.csv")):
        curve = read_curve(path)
        if curve:
            runs.setdefault(without_seed(path.stem), []).append(curve)
    return runs


def _draw_runs(
    groups: dict[str, Runs], rows: Sequence[Row], site: Path
) -> dict[str, list[SavedFigure]]:
    """Draw success and social score of every group of runs."""
    pairs = [
        (task, column)
        for task, runs in groups.items()
        for column in dict.fromkeys(
            c for curves in runs.values() for curve in curves for c in curve
        )
        if is_performance(column)
    ]
    figures: dict[str, list[SavedFigure]] = {task: [] for task in groups}
    for task, column in progress_bar(pairs, desc="curves", unit="figure"):
        figure = draw_curves(groups[task], column, baselines(rows, column))
        title = f"{task}, {curve_title(column)}"
        figures[task].append(_save(figure, f"curve-{task}-{column}", title, site))
    return figures


def _draw_sweep(sweep: Table, site: Path) -> list[SavedFigure]:
    return [
        _save(figure, f"{sweep.key}-{title}", title, site)
        for title, figure in sweep_figures(sweep.rows)
    ]


def _copy_cards(checkpoints: Path, site: Path) -> set[str]:
    """Copy the cards of the policies, which tell how each was trained; return their names."""
    cards = sorted(checkpoints.glob("*.json"))
    for card in cards:
        with atomic_write(site / "cards" / card.name) as part:
            shutil.copyfile(card, part)
    return {card.stem for card in cards}


def _save(figure: Figure, name: str, title: str, site: Path) -> SavedFigure:
    for extension in ("svg", "png"):
        save_figure(figure, site / "figures" / f"{slug(name)}.{extension}")
    return SavedFigure(slug(name), title)


def _write_replays(
    trajectories: Sequence[tuple[str, int, Trajectory]], split: str, site: Path
) -> list[dict[str, Any]]:
    """Write one script per replay, since pages opened from a disk may not fetch data.

    Returns:
        The entries for the lists of the viewer.
    """
    entries: list[dict[str, Any]] = []
    for method, case, trajectory in trajectories:
        scenario = trajectory.scenario
        column = scenario_column(scenario, load_scenario(scenario.name))
        key = slug(f"{method}-{column_name(column)}-{split}-{case}")
        data = json.dumps(as_replay(trajectory), separators=(",", ":"))
        write_text(site / f"replays/{key}.js", f"replay({json.dumps(key)},{data});\n")
        people = "" if column.recording else f"{scenario.humans} humans"
        words = [f"{scenario.fov_degrees:g}° view", people, f"{scenario.robots} robots"]
        words.append(setting_name(column))
        entries.append(
            {
                "key": key,
                "method": method,
                "column": ", ".join(filter(None, words)),
                "case": f"{split} case {case}",
                "success": bool(trajectory.episodes.success[0]),
            }
        )
    return entries


def readable(stem: str) -> str:
    """Return a file name as a title: `Table 1` for `table1`."""
    words = re.sub(r"(?<=[A-Za-z])(?=\d)|[_-]+", " ", stem)
    return words[:1].upper() + words[1:]


def slug(name: str) -> str:
    """Return a name that is safe in file names and URLs."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower().replace("°", "")).strip("-")
