"""The methods of a table or of the named tasks in groups, best first."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from mrsan import TASKS
from samarl.configuration import available_agents, load_agent_config
from samarl.evaluation.methods import is_ablation, label_of, split_method
from samarl.evaluation.seeds import without_seed
from samarl.evaluation.summary import Column, Row, column_of, read_rows, scenario_column
from samarl.files import find_folder, read_json
from samarl.policies.card import is_policy
from samarl.submission import submission_rows

GROUPS = {"learned": "Learned", "ablation": "Ablations", "planner": "Planners"}


@dataclass
class Line:
    """A line of the leaderboard: one method."""

    name: str
    group: str  # a key of GROUPS
    description: str  # one line; empty if the method has no configuration file
    checkpoint: str | None  # of its policy
    has_shield: bool
    is_privileged: bool  # robots know more than their sensors and messages say
    communicates: bool  # its robots report what they see, or tell each other what they do
    rows: list[Row | None]  # one per column

    @property
    def label(self) -> str:
        """The name for readers."""
        return label_of(self.name)

    @property
    def success(self) -> float:
        """The mean success rate over the columns with a row, %."""
        rates = [row["success_rate"] for row in self.rows if row is not None]
        return sum(rates) / len(rates)


def ranked(
    rows: Sequence[Row], column: Callable[[Row], Hashable] = column_of, columns: Sequence[Any] = ()
) -> list[Line]:
    """Return the methods by group, those in most columns first, then by mean success, best first.

    Means over different columns are not comparable, since columns differ in difficulty.

    Args:
        rows: the rows; of several of a method in a column, the one with the most cases counts.
        column: the column of a row.
        columns: all columns, in order; empty: those of the rows, in order of appearance.
    """
    columns = columns or list(dict.fromkeys(map(column, rows)))
    methods: dict[tuple[str, bool], dict[Hashable, Row]] = {}
    for row in sorted(rows, key=lambda row: int(row["episodes"])):
        methods.setdefault((row["method"], _communicates(row)), {})[column(row)] = row
    lines = [
        _line(*method, [cells.get(name) for name in columns]) for method, cells in methods.items()
    ]
    order = list(GROUPS)
    return sorted(
        lines, key=lambda line: (order.index(line.group), line.rows.count(None), -line.success)
    )


@cache
def _task_columns() -> dict[Column, str]:
    """Return the names in `mrsan.TASKS` by the columns of their rows."""
    scenarios = {name: task.scenario for name, task in TASKS.items()}
    return {scenario_column(s, scenarios.get(s.name)): name for name, s in scenarios.items()}


def task_of(row: Row) -> str | None:
    """Return the task of a row by its name in `mrsan.TASKS`, or None.

    Robots may tell each other who goes first in every task.
    """
    column = column_of(row)
    changes = [word for word in column.changes.split() if word != "team_messages=True"]
    alone = column._replace(team_perception="none", changes=" ".join(changes))
    return _task_columns().get(alone)


def task_rows(submissions: Path | None = None) -> list[Row]:
    """Return the rows in `results/` that are of a task, without those of ablations.

    Args:
        submissions: folder of files of `samarl-submit`, whose rows are added.
    """
    rows: list[Row] = []
    for path in sorted(find_folder("results").glob("*.json")):
        rows += read_rows(path) or []
    for path in sorted(submissions.glob("*.json")) if submissions else []:
        rows += submission_rows(read_json(path))
    rows = [row for row in rows if without_seed(row["method"]) == row["method"]]
    return [row for row in rows if task_of(row) and not is_ablation(row["method"])]


def _communicates(row: Row) -> bool:
    column = column_of(row)
    return column.team_perception != "none" or "team_messages=True" in column.changes


def is_best(row: Row, rows: Sequence[Row]) -> bool:
    """Return whether a row has the highest success rate of its column or task."""
    place = task_of(row) or column_of(row)
    rates = [r["success_rate"] for r in rows if (task_of(r) or column_of(r)) == place]
    return bool(row["success_rate"] == max(rates))


def _line(name: str, communicates: bool, rows: list[Row | None]) -> Line:
    """Return the line of a method; one that is neither an agent nor a policy is a planner."""
    agent, settings = split_method(name)
    settings = _configuration(agent) | settings
    first: Row = next(filter(None, rows))
    about = first.get("submission", {})
    settings |= about.get("settings", {})
    learned = (settings.get(part) for part in ("checkpoint", "macro_level", "driver"))
    checkpoint = next(filter(None, learned), None)
    group = "planner" if checkpoint is None else "learned"
    return Line(
        name=name,
        group="ablation" if is_ablation(name) else group,
        description=about.get("description") or _description(agent),
        checkpoint=checkpoint,
        has_shield=bool(settings.get("shield")),
        is_privileged=bool(about.get("privileged") or settings.get("central")),
        communicates=communicates,
        rows=rows,
    )


@cache
def _configuration(name: str) -> dict[str, Any]:
    """Return the settings of an agent or of an included policy; empty if it is neither.

    Those of `conf/agent/` are read without Hydra, which would take seconds for all of them.
    """
    path = find_folder("conf") / "agent" / f"{name}.yaml"
    if not path.is_file():
        is_known = name in available_agents() or is_policy(name)
        return load_agent_config(name) if is_known else {}
    own = yaml.safe_load(path.read_text(encoding="utf-8"))
    for parent in own.pop("defaults", []):
        own = _configuration(parent) | own
    return own


@cache
def _description(name: str) -> str:
    """Return the comment at the top of an agent's file, at most three lines."""
    path = find_folder("conf") / "agent" / f"{name}.yaml"
    if not path.is_file():
        return ""
    lines = path.read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in lines[:3] if line.startswith("#"))
