"""Learning curves by the task that a run was trained for, and their data for the chart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mrsan import Layout
from samarl.files import read_json
from samarl.report.figures import Curve, curve_title, curve_unit, is_success, mean_and_range
from samarl.report.leaderboard import is_ablation

Runs = dict[str, list[Curve]]  # the curves of all seeds, by run
_POINTS = 60  # per line of the chart


def group_runs(runs: Runs, checkpoints: Path) -> dict[str, Runs]:
    """Return the runs by task, according to the card of each policy in `checkpoints`."""
    groups: dict[str, Runs] = {}
    for name, curves in runs.items():
        card = checkpoints / f"{name}.json"
        groups.setdefault(_task(read_json(card)) if card.is_file() else "Other runs", {})[name] = (
            curves
        )
    return dict(sorted(groups.items(), key=lambda group: -len(group[1])))


def _task(card: Mapping[str, Any]) -> str:
    """Return what a policy was trained for, from the last scenarios of its curriculum."""
    curriculum = card["provenance"]["configuration"].get("curriculum") or {}
    scenarios = [stage["scenario"] for stage in curriculum.get("stages", [])]
    if not scenarios:
        return "Other runs"
    last = scenarios[-1]
    layouts = {_name(scenario, "layout", "circle") for scenario in scenarios}
    if any(_name(scenario, "crowd", "orca") == "recorded" for scenario in scenarios):
        return "Recorded people"
    if any(Layout[layout].has_walls for layout in layouts):
        return "Places with walls"
    if layouts != {"circle"}:
        return "Any layout"
    if _name(last, "kinematics", "acceleration_heading") == "holonomic":
        return "MSA3C's circle, holonomic robots"
    views = {scenario["fov_degrees"] for scenario in scenarios}
    view = f"{last['fov_degrees']:g}° view" if len(views) == 1 else "any view"
    return f"SAMARL's circle, {view}"


def _name(scenario: Mapping[str, Any], field: str, default: str) -> str:
    """Return the member of an enum, which older cards write as `Class.member` or lack."""
    return str(scenario.get(field, default)).rpartition(".")[2]


def chart_data(groups: Mapping[str, Runs]) -> list[dict[str, Any]]:
    """Return the groups for the chart, ready for JSON.

    Each has `quantities` with title and unit, and `runs` whose `lines` hold steps, mean, lowest and
    highest value over the seeds by quantity. At first the chart shows the runs that are `main`: all
    that are not ablations.
    """
    data = []
    for title, runs in groups.items():
        columns = dict.fromkeys(c for curves in runs.values() for curve in curves for c in curve)
        order = sorted(columns, key=lambda column: not is_performance(column))
        quantities = [{"key": c, "title": curve_title(c), "unit": curve_unit(c)} for c in order]
        entries = [
            {
                "name": name,
                "seeds": len(curves),
                "main": not is_ablation(name),
                "lines": {column: line for column in order if (line := _line(curves, column))},
            }
            for name, curves in runs.items()
        ]
        data.append({"title": title, "quantities": quantities, "runs": entries})
    return data


def is_performance(column: str) -> bool:
    """Return whether a column holds success rates or social scores."""
    return "success" in column or "score" in column


def _line(curves: Sequence[Curve], column: str) -> list[list[float]]:
    """Return steps, mean, lowest and highest value of a column; empty if no seed has it."""
    seeds = [curve[column] for curve in curves if column in curve]
    if not seeds:
        return []
    scale = 100.0 if is_success(column) else 1.0
    series = mean_and_range(seeds, _POINTS)
    return [
        [float(f"{value:.4g}") for value in factor * values]
        for factor, values in zip((1.0, scale, scale, scale), map(np.asarray, series), strict=True)
    ]
