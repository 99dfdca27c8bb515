"""The web pages of a results folder, and of the curves of training runs."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from mrsan import TASKS, ConfigurationError
from samarl.evaluation.methods import labelled
from samarl.evaluation.metrics import Tables
from samarl.evaluation.seeds import without_seed
from samarl.evaluation.summary import Row, read_rows
from samarl.evaluation.table import (
    co_planning_as_cells,
    column_title,
    counts_collisions,
    grid_of,
    group_by_kind,
    has_driving_metrics,
    rows_as_cells,
)
from samarl.files import atomic_write, code_version, write_text
from samarl.report.curves import Runs, chart_data, group_runs
from samarl.report.figures import (
    draw_curves,
    draw_table,
    is_performance,
    sweep_figures,
)
from samarl.report.leaderboard import GROUPS, Line, is_best, ranked, task_of, task_rows
from samarl.report.style import PALETTE, save_figure
from samarl.training.learning_curve import read_curve

_TEMPLATES = Path(__file__).parent / "site"
_MARKER = "site.css"  # identifies the folder of an earlier report
_FUNCTIONS = {  # that templates use
    "co_planning_as_cells": co_planning_as_cells,
    "column_titles": lambda columns: list(map(column_title, columns)),
    "counts_collisions": counts_collisions,
    "grid_of": grid_of,
    "groups": GROUPS,
    "has_driving_metrics": has_driving_metrics,
    "is_best": is_best,
    "labelled": labelled,
    "ranked": ranked,
    "rows_as_cells": rows_as_cells,
    "Tables": Tables,
}


def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.globals |= _FUNCTIONS
    return environment


def task_leaderboard(family: str, submissions: Path | None = None) -> str:
    """Return the leaderboard of the tasks of a family (`mrsan.Task.family`) as HTML.

    Args:
        family: the family.
        submissions: folder of files of `samarl-submit`.
    """
    tasks = {name: task for name, task in TASKS.items() if task.family == family}
    rows = [row for row in task_rows(submissions) if task_of(row) in tasks]
    lines = ranked(rows, task_of, list(tasks))
    template: Any = _environment().get_template("leaderboard.html").module
    return str(template.leaderboard([task.id for task in tasks.values()], lines, rows, set()))


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
    def page(self) -> str:
        """The name of the file of its page."""
        return f"table-{self.key.removeprefix('table-')}.html"

    @property
    def episodes(self) -> str:
        """The number of cases per row, or the smallest and the largest number."""
        counts = sorted({row["episodes"] for row in self.rows})
        return " to ".join(str(count) for count in sorted({counts[0], counts[-1]}))

    def best(self, group: str) -> Line | None:
        """Return the best of the methods of a group that play every column, if there are any."""
        lines = (line for line in ranked(self.rows) if line.group == group)
        return next((line for line in lines if None not in line.rows), None)


@dataclass
class SavedFigure:
    """A figure saved as `figures/KEY.svg` and `figures/KEY.png`."""

    key: str
    title: str


@dataclass
class Site:
    """Pages in a folder, and the figures that they show."""

    folder: Path
    pages: dict[str, str]  # the title of each page in the menu
    command: str  # shown in the footer
    figures: dict[str, Figure] = field(default_factory=dict)  # to be saved

    def __post_init__(self) -> None:
        """Write what all pages need."""
        self._environment = _environment()
        self._environment.globals |= {
            "pages": self.pages,
            "command": self.command,
            "commit": code_version(),
        }
        self.write("site.css", "site.css", palette=PALETTE)

    def write(self, name: str, template: str, **content: Any) -> None:
        """Write a page."""
        page = name.removesuffix(".html")
        text = self._environment.get_template(template).render(page=page, **content)
        write_text(self.folder / name, text)

    def copy_script(self, name: str) -> None:
        """Copy a script that pages use."""
        write_text(self.folder / name, (_TEMPLATES / name).read_text(encoding="utf-8"))

    def figure(self, title: str, key: str, figure: Figure) -> SavedFigure:
        """Return the names of a figure for a page, which `save_figures` saves."""
        self.figures[slug(key)] = figure
        return SavedFigure(slug(key), title)

    def save_figures(self) -> None:
        """Save all figures, which takes longer than writing the pages."""
        for key, figure in self.figures.items():
            for extension in ("svg", "png"):
                save_figure(figure, self.folder / f"figures/{key}.{extension}")


def build_site(
    output: Path, results: Path, command: str = "samarl-report", has_replays: bool = False
) -> list[Path]:
    """Build all pages but the replays in a folder, replacing an earlier report.

    Args:
        output: output folder; replays in an earlier report remain there, see `ReplayFolder`.
        results: folder with tables in `*.json`, learning curves in `curves/*.csv` and sweeps in
            `sweeps/*.json`.
        command: command line shown in the footer.
        has_replays: whether replays will be added.

    Returns:
        All files of the report.

    Raises:
        ConfigurationError: the folder contains other files, or a result cannot be read.
    """
    check_output(output)
    new = output.with_name(output.name + ".part")
    shutil.rmtree(new, ignore_errors=True)
    try:
        site = _write_pages(new, results, command, has_replays)
        if has_replays and (output / "replays").is_dir():
            (output / "replays").replace(new / "replays")
        if output.exists():
            shutil.rmtree(output)
        new.replace(output)
    finally:
        shutil.rmtree(new, ignore_errors=True)
    site.folder = output
    site.save_figures()
    return sorted(file for file in output.rglob("*") if file.is_file())


def check_output(output: Path) -> None:
    """Check that a folder can be replaced.

    Raises:
        ConfigurationError: it contains other files than an earlier report.
    """
    if output.exists() and not (output / _MARKER).is_file() and any(output.iterdir()):
        raise ConfigurationError(
            f"output is {str(output)!r}; it must be a new folder or contain an earlier report"
        )


def _write_pages(folder: Path, results: Path, command: str, has_replays: bool) -> Site:
    """Write the pages of a results folder; return the site, whose figures are not saved yet."""
    tables, sweeps = read_tables(results), read_tables(results / "sweeps")
    tables = [part for table in tables for part in _parts(table)]
    runs = read_runs(results / "curves")
    pages = {
        "index": "Results",
        "curves": "Learning curves" if runs else "",
        "sweeps": "Sweeps" if sweeps else "",
        "replays": "Replays" if has_replays else "",
    }
    site = Site(folder, {page: title for page, title in pages.items() if title}, command)
    cards = _copy_cards(results / "checkpoints", folder)
    site.write("index.html", "index.html", tables=tables)
    for table in tables:
        figure = site.figure(table.name, table.key, draw_table(table.rows))
        site.write(table.page, "table.html", table=table, tables=tables, cards=cards, figure=figure)
    if runs:
        _write_curves(site, "curves.html", group_runs(runs, results / "checkpoints"))
    if sweeps:
        figures = {
            sweep.name: [
                site.figure(title, f"{sweep.key}-{title}", figure)
                for title, figure in sweep_figures(labelled(sweep.rows))
            ]
            for sweep in sweeps
        }
        site.write("sweeps.html", "sweeps.html", sweeps=sweeps, figures=figures)
    if has_replays:
        site.write("replays.html", "replays.html")
        for script in ("drawing.js", "viewer.js"):
            site.copy_script(script)
    site.copy_script("leaderboard.js")
    return site


def build_curves(output: Path, runs: Runs, command: str) -> None:
    """Write a page with the curves of training runs, and a picture of success and social score.

    Raises:
        ConfigurationError: the folder contains other files.
    """
    check_output(output)
    site = Site(output, {"index": "Learning curves"}, command)
    columns = dict.fromkeys(c for curves in runs.values() for curve in curves for c in curve)
    shared = [c for c in columns if all(c in curve for curves in runs.values() for curve in curves)]
    drawn = [column for column in shared or columns if is_performance(column)] or list(columns)[:1]
    save_figure(draw_curves(runs, *drawn), output / "curves.png")
    _write_curves(site, "index.html", {"training runs": runs}, "curves.png")


def _write_curves(site: Site, name: str, groups: Mapping[str, Runs], picture: str = "") -> None:
    """Write a page with a chart of learning curves, and a link to a picture of them, if any."""
    site.write(name, "curves.html", chart=chart_data(groups), picture=picture)
    site.copy_script("curves.js")


def _parts(table: Table) -> list[Table]:
    """Return one table per kind of column."""
    kinds = group_by_kind(table.rows)
    if len(kinds) == 1:
        return [table]
    return [Table(f"{table.name}: {kind.lower()}", rows) for kind, rows in kinds.items()]


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


def _copy_cards(checkpoints: Path, site: Path) -> set[str]:
    """Copy the cards of the policies, which tell how each was trained; return their names."""
    cards = sorted(checkpoints.glob("*.json"))
    for card in cards:
        with atomic_write(site / "cards" / card.name) as part:
            shutil.copyfile(card, part)
    return {card.stem for card in cards}


def readable(stem: str) -> str:
    """Return a file name as a title: `Table 1` for `table1`."""
    words = re.sub(r"(?<=[A-Za-z])(?=\d)|[_-]+", " ", stem)
    return words[:1].upper() + words[1:]


def slug(name: str) -> str:
    """Return a name that is safe in file names and URLs."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower().replace("°", "")).strip("-")
