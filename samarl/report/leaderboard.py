"""The methods of a table in groups, best first, each with what it is and where it comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markupsafe import Markup, escape

from samarl.configuration import available_agents, load_agent
from samarl.evaluation.summary import Row, column_of
from samarl.evaluation.table import grid_of
from samarl.files import find_folder

GROUPS = {"learned": "Learned", "ablation": "Ablations", "planner": "Planners"}


@dataclass
class Entry:
    """One method: a line of the leaderboard."""

    name: str
    group: str  # a key of GROUPS
    about: str  # in a line; empty if it is not known here
    checkpoint: str | None  # the policy it drives with
    rows: list[Row | None]  # of each column

    @property
    def label(self) -> Markup:
        """The name, which may break after its underscores."""
        return Markup(str(escape(self.name)).replace("_", "_<wbr>"))

    @property
    def success(self) -> float:
        """The mean over the columns that it has, %."""
        rates = [row["success_rate"] for row in self.rows if row is not None]
        return sum(rates) / len(rates)


def ranked(rows: Sequence[Row]) -> list[Entry]:
    """The methods by their group, and in it by their mean success over the columns, best first."""
    entries = [_entry(name, found) for name, found in grid_of(rows).ours.items()]
    order = list(GROUPS)
    return sorted(entries, key=lambda entry: (order.index(entry.group), -entry.success))


def is_best(row: Row, rows: Sequence[Row]) -> bool:
    """Is it the highest success rate of its column?"""
    column = column_of(row)
    return row["success_rate"] == max(r["success_rate"] for r in rows if column_of(r) == column)


def _entry(name: str, rows: list[Row | None]) -> Entry:
    """What the file of the agent says of itself; a stranger is a planner as far as one knows."""
    about = _comment(find_folder("conf") / "agent" / f"{name}.yaml")
    checkpoint = _checkpoint(name)
    group = "planner" if checkpoint is None else "learned"
    return Entry(name, "ablation" if about.startswith("An ablation") else group, about, checkpoint,
                 rows)  # fmt: skip


@cache
def _checkpoint(name: str) -> str | None:
    """The policy that an agent's configuration names; kept, as it takes a while to compose."""
    return load_agent(name).get("checkpoint") if name in available_agents() else None


def _comment(path: Path) -> str:
    """What a YAML file begins with."""
    if not path.is_file():
        return ""
    lines = path.read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in lines[:3] if line.startswith("#"))
