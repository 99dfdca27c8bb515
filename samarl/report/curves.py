"""Learning curves by the task that a run was trained for, and their data for the chart."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mrsan import ConfigurationError, Layout
from samarl.evaluation.methods import is_ablation, label_of, method_of_policy
from samarl.files import read_json
from samarl.report.figures import (
    curve_title,
    curve_unit,
    is_performance,
    is_success,
    mean_and_range,
)
from samarl.training.learning_curve import Curve, read_curve

Runs = dict[str, list[Curve]]  # the curves of all seeds, by run
_POINTS = 60  # per line of the chart
_SEED = re.compile(r"[_,-]?(trainer\.)?seed[-_=]?\d+")  # in the name of a folder


def read_run_folders(folders: Sequence[Path]) -> Runs:
    """Return the curves of training runs by their folders without training seeds.

    Each is that of a run, or contains some.

    Raises:
        ConfigurationError: a folder contains no curve, or none of them has any values yet.
    """
    files: dict[Path, None] = {}
    for folder in folders:
        inside = sorted(folder.absolute().rglob("progress.csv"))
        if not inside:
            raise ConfigurationError(
                f"FOLDER is {str(folder)!r}; it must be the folder of a training run, with its "
                "progress.csv, or contain some"
            )
        files |= dict.fromkeys(inside)
    common = os.path.commonpath([file.parent.parent for file in files])
    runs: Runs = {}
    for file in files:
        if curve := read_curve(file):
            name = _SEED.sub("", file.parent.relative_to(common).as_posix())
            runs.setdefault(name or file.parent.parent.name, []).append(curve)
    if not runs:
        raise ConfigurationError(f"{next(iter(files))} has no values yet; wait for the first round")
    return runs


def group_runs(runs: Runs, checkpoints: Path) -> dict[str, Runs]:
    """Return the runs by task, according to the card of each policy in `checkpoints`."""
    groups: dict[str, Runs] = {}
    for name, curves in runs.items():
        card = checkpoints / f"{name}.json"
        try:
            task = _task(read_json(card)) if card.is_file() else "Other runs"
        except (LookupError, TypeError, AttributeError, ValueError, OverflowError):  # no such card
            task = "Other runs"
        groups.setdefault(task, {})[name] = curves
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
                "name": label_of(method_of_policy(name)),
                "seeds": len(curves),
                "main": not is_ablation(method_of_policy(name)),
                "lines": {column: line for column in order if (line := _line(curves, column))},
            }
            for name, curves in runs.items()
        ]
        data.append({"title": title, "quantities": quantities, "runs": entries})
    return data


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
