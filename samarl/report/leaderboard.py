"""The methods of a table in groups, best first, with description and checkpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import yaml

from samarl.configuration import available_agents, load_agent_config
from samarl.evaluation.methods import is_ablation, label_of, split_method
from samarl.evaluation.summary import Row, column_of
from samarl.evaluation.table import grid_of
from samarl.files import find_folder

GROUPS = {"learned": "Learned", "ablation": "Ablations", "planner": "Planners"}


@dataclass
class Line:
    """A line of the leaderboard: one method."""

    name: str
    group: str  # a key of GROUPS
    description: str  # one line; empty if the method has no configuration file
    checkpoint: str | None  # of its policy
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


def ranked(rows: Sequence[Row]) -> list[Line]:
    """Return the methods by group, those in most columns first, then by mean success, best first.

    Means over different columns are not comparable, since columns differ in difficulty.
    """
    lines = [_line(name, method_rows) for name, method_rows in grid_of(rows).ours.items()]
    order = list(GROUPS)
    return sorted(
        lines, key=lambda line: (order.index(line.group), line.rows.count(None), -line.success)
    )


def is_best(row: Row, rows: Sequence[Row]) -> bool:
    """Return whether a row has the highest success rate of its column."""
    column = column_of(row)
    return row["success_rate"] == max(r["success_rate"] for r in rows if column_of(r) == column)


def _line(name: str, rows: list[Row | None]) -> Line:
    """Return the line of a method; methods without a configuration file count as planners."""
    agent, settings = split_method(name)
    checkpoint = (_configuration(agent) | settings).get("checkpoint")
    group = "planner" if checkpoint is None else "learned"
    if is_ablation(name):
        group = "ablation"
    return Line(name, group, _description(agent), checkpoint, rows)


@cache
def _configuration(name: str) -> dict[str, Any]:
    """Return the settings of an agent, empty if it has no file.

    Those of `conf/agent/` are read without Hydra, which would take seconds for all of them.
    """
    path = find_folder("conf") / "agent" / f"{name}.yaml"
    if not path.is_file():
        return load_agent_config(name) if name in available_agents() else {}
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
