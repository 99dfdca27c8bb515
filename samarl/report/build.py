"""The pages of the report, from whatever a results folder holds."""

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
from tqdm import tqdm

from mrsan import ConfigurationError
from samarl.configuration import load_scenario
from samarl.evaluation.metrics import Shown
from samarl.evaluation.recording import Recording
from samarl.evaluation.seeds import without_seed
from samarl.evaluation.summary import Row, place_of, read_rows
from samarl.evaluation.table import (
    by_kind,
    co_planning_as_cells,
    column_name,
    counts_collisions,
    grid_of,
    place_name,
    rows_as_cells,
    tells_of_driving,
)
from samarl.files import code_version, unfinished, write_atomically
from samarl.report.figures import (
    Curve,
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
KINDS = {  # of curves: the first whose pattern is found in the name of the column
    "How well it does": "success|score",
    "Statistics of the policy and of its updates": (
        "kl|clip_fraction|entropy|effective|explained|gradient|epochs|unsafe"
    ),
    "Speed": "charts/",
    "Losses": "",
}
_MARK = "viewer.js"  # an earlier report has it


@dataclass
class Table:
    """A file of rows."""

    name: str
    rows: list[Row]

    @property
    def key(self) -> str:
        """The name as part of an address."""
        return slug(self.name)

    @property
    def episodes(self) -> str:
        """How many cases a row is of: one number, or the fewest and the most."""
        counts = sorted({row["episodes"] for row in self.rows})
        return " to ".join(str(count) for count in sorted({counts[0], counts[-1]}))

    def parts(self) -> list[Table]:
        """A table of each kind of columns; none if there is one kind."""
        kinds = by_kind(self.rows)
        if len(kinds) == 1:
            return []
        return [Table(f"{self.name}: {kind.lower()}", rows) for kind, rows in kinds.items()]


@dataclass
class Picture:
    """A figure that was saved as `figures/KEY.svg` and `.png`."""

    key: str
    title: str


def build_site(
    output: Path,
    results: Path,
    recordings: Sequence[tuple[str, int, Recording]],
    split: str,
    command: str = "samarl-report",
) -> list[Path]:
    """Build all pages in a new folder that takes the place of an earlier report.

    Args:
        output: the folder.
        results: tables in `*.json`, learning curves in `curves/*.csv`, sweeps in `sweeps/*.json`.
        recordings: each with the method's name and the place of its case in the split.
        split: its name.
        command: what made the pages, for their foot.

    Returns:
        All files of the report.

    Raises:
        ConfigurationError: the folder holds something else, or a result cannot be read.
    """
    if output.exists() and not (output / _MARK).is_file() and any(output.iterdir()):
        raise ConfigurationError(
            f"output is {str(output)!r}; it must be a new folder or that of an earlier report"
        )
    site = output.with_name(output.name + ".part")
    shutil.rmtree(site, ignore_errors=True)
    try:
        _build_pages(site, results, recordings, split, command)
        if output.exists():
            shutil.rmtree(output)
        site.replace(output)
    finally:
        shutil.rmtree(site, ignore_errors=True)
    return sorted(file for file in output.rglob("*") if file.is_file())


def _build_pages(
    site: Path,
    results: Path,
    recordings: Sequence[tuple[str, int, Recording]],
    split: str,
    command: str,
) -> None:
    """See `build_site`."""
    tables, sweeps = read_tables(results), read_tables(results / "sweeps")
    elsewhere = [part for table in tables for part in table.parts()]
    tables = [table for table in tables if not table.parts()]
    runs = read_runs(results / "curves")
    pages = {"index": "Results", "elsewhere": "Elsewhere", "curves": "Learning curves",
             "sweeps": "Sweeps", "replays": "Replays"}  # fmt: skip
    there = {"index": True, "elsewhere": elsewhere, "curves": runs, "sweeps": sweeps,
             "replays": recordings}  # fmt: skip
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=StrictUndefined,
    )  # fmt: skip
    environment.globals |= {
        "pages": {page: title for page, title in pages.items() if there[page]},
        "commit": code_version(),
        "command": command,
        "grid_of": grid_of,
        "co_planning_as_cells": co_planning_as_cells,
        "counts_collisions": counts_collisions,
        "place_name": place_name,
        "rows_as_cells": rows_as_cells,
        "tells_of_driving": tells_of_driving,
        "Shown": Shown,
        "groups": GROUPS,
        "ranked": ranked,
        "is_best": is_best,
        "cards": _copy_cards(results / "checkpoints", site),
    }

    def write(name: str, **content: Any) -> None:
        write_atomically(site / name, environment.get_template(name).render(page=name, **content))

    write("site.css", palette=PALETTE)
    headlines = {
        table.name: _save(draw_table(table.rows), table.key, table.name, site)
        for table in (*tables, *elsewhere)
    }
    write("index.html", tables=tables, headlines=headlines)
    if elsewhere:
        write("elsewhere.html", tables=elsewhere, headlines=headlines)
    if runs:
        rows = [row for table in tables for row in table.rows]
        write("curves.html", pictures=_draw_runs(runs, rows, site), runs=runs)
    if sweeps:
        pictures = {
            sweep.name: [
                _save(figure, f"{sweep.key}-{title}", title, site)
                for title, figure in sweep_figures(sweep.rows)
            ]
            for sweep in sweeps
        }
        write("sweeps.html", sweeps=sweeps, pictures=pictures)
    if recordings:
        write("replays.html", replays=_write_replays(recordings, split, site))
    for script in _TEMPLATES.glob("*.js"):
        write_atomically(site / script.name, script.read_text(encoding="utf-8"))


def read_tables(folder: Path) -> list[Table]:
    """Every JSON file of a folder that is a list of rows.

    Raises:
        ConfigurationError: a file is not JSON, or its rows lack a field they need.
    """
    tables = []
    for path in sorted(folder.glob("*.json")):
        rows = read_rows(path)
        if rows is not None:
            tables.append(Table(readable(path.stem), rows))
    return tables


def read_runs(folder: Path) -> dict[str, list[Curve]]:
    """Every curve of a folder by the name of its run; files `NAME_seedK.csv` are one run."""
    runs: dict[str, list[Curve]] = {}
    for path in sorted(folder.glob("*.csv")):
        curve = read_curve(path)
        if curve:
            runs.setdefault(without_seed(path.stem), []).append(curve)
    return runs


def _draw_runs(
    runs: dict[str, list[Curve]], rows: Sequence[Row], site: Path
) -> dict[str, list[Picture]]:
    """Figures of all columns by what they tell of."""
    columns = list(dict.fromkeys(c for curves in runs.values() for curve in curves for c in curve))
    pictures: dict[str, list[Picture]] = {kind: [] for kind in KINDS}
    for column in tqdm(columns, "curves", unit="figure", disable=None):
        kind = next(kind for kind, pattern in KINDS.items() if re.search(pattern, column))
        figure = draw_curves(runs, column, baselines(rows, column))
        pictures[kind].append(_save(figure, f"curve-{column}", curve_title(column), site))
    return pictures


def _copy_cards(checkpoints: Path, site: Path) -> set[str]:
    """The cards of the policies, for those who want to know how one was made; their names."""
    cards = sorted(checkpoints.glob("*.json"))
    for card in cards:
        with unfinished(site / "cards" / card.name) as part:
            shutil.copyfile(card, part)
    return {card.stem for card in cards}


def _save(figure: Figure, name: str, title: str, site: Path) -> Picture:
    for ending in ("svg", "png"):
        save_figure(figure, site / "figures" / f"{slug(name)}.{ending}")
    return Picture(slug(name), title)


def _write_replays(
    recordings: Sequence[tuple[str, int, Recording]], split: str, site: Path
) -> list[dict[str, Any]]:
    """A script for each recording (pages from a disk may not fetch data), and the list of them."""
    entries = []
    for method, case, recording in recordings:
        scenario = recording.scenario
        column = place_of(scenario, load_scenario(scenario.name))
        key = slug(f"{method}-{column_name(column)}-{split}-{case}")
        data = json.dumps(as_replay(recording), separators=(",", ":"))
        write_atomically(site / f"replays/{key}.js", f"replay({json.dumps(key)},{data});\n")
        people = "" if column.recording else f"{scenario.humans} humans"
        words = [f"{scenario.fov_degrees:g}° view", people, f"{scenario.robots} robots"]
        words.append(place_name(column))
        entries.append(
            {"key": key, "method": method, "column": ", ".join(filter(None, words)),
             "case": f"{split} case {case}", "success": bool(recording.episodes.success[0])}
        )  # fmt: skip
    return entries


def readable(stem: str) -> str:
    """A file's name as a title: `table1` is `Table 1`."""
    words = re.sub(r"(?<=[A-Za-z])(?=\d)|[_-]+", " ", stem)
    return words[:1].upper() + words[1:]


def slug(name: str) -> str:
    """A name that is safe as a file's and in an address."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower().replace("°", "")).strip("-")
