"""Prediction errors compared with constant velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mrsan.prediction import ConstantVelocity, Predictor, checked_prediction
from samarl.evaluation.table import markdown_table
from samarl.files import machine
from samarl.prediction.windows import Windows


def displacement(predictor: Predictor, windows: Windows, steps: int) -> list[float]:
    """Return the mean displacement error of predictions after 1..K steps, m."""
    known = windows.known[:, None, -predictor.history :]
    past = windows.past[:, None, -predictor.history :]
    predicted = checked_prediction(predictor, past, known, windows.velocity[:, None], steps)[:, 0]
    error = np.linalg.norm(predicted - windows.future[:, :steps], axis=-1).mean(0)
    return [round(float(value), 4) for value in error]


def errors(predictor: Predictor, crowds: Mapping[str, Windows], steps: int) -> dict[str, Any]:
    """Return `displacement` of a predictor and of constant velocity for each crowd."""
    baseline = ConstantVelocity(float(predictor.time_step))
    return {
        name: {
            "windows": len(windows.past),
            "constant_velocity": displacement(baseline, windows, steps),
            "predictor": displacement(predictor, windows, steps),
        }
        for name, windows in crowds.items()
    }


def page(result: Mapping[str, Any], time_step: float) -> str:
    """Return the errors as a page of Markdown."""
    crowds = result["errors"]
    steps = range(1, 1 + len(next(iter(crowds.values()))["predictor"]))
    header = ["people", "windows", "predictor", *(f"{k * time_step:g} s" for k in steps), "change"]
    lines = []
    for name, row in crowds.items():
        baseline = row["constant_velocity"][-1]
        for key in ("constant_velocity", "predictor"):
            change = f"{100 * (row[key][-1] / baseline - 1):+.1f} %" if baseline else ""
            cells = [f"{error:.3f}" for error in row[key]]
            lines.append([name, str(row["windows"]), key.replace("_", " "), *cells, change])
    return f"""# Predicting people

Mean distance in metres between predicted and actual positions, by prediction time. Simulated crowds
are validation cases; nothing was trained or selected on recorded people. The last column gives the
change from constant velocity at the longest time.

{markdown_table(header, lines)}

Created by `{result["command"]}` at commit {result["commit"]} on {machine()}.
"""
