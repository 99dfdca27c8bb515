"""How far predictions are off, beside constant velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mrsan.prediction import ConstantVelocity, Predictor
from samarl.evaluation.table import as_text
from samarl.files import machine
from samarl.prediction.windows import Windows


def displacement(predictor: Predictor, windows: Windows, steps: int) -> list[float]:
    """Mean distance of people from where they were predicted after 1..K steps, m."""
    known = windows.known[:, None, -predictor.history :]
    past = windows.past[:, None, -predictor.history :]
    found = predictor.predict(past, known, windows.velocity[:, None], steps)[:, 0]
    error = np.linalg.norm(found - windows.future[:, :steps], axis=-1).mean(0)
    return [round(float(value), 4) for value in error]


def errors(predictor: Predictor, crowds: Mapping[str, Windows], steps: int) -> dict[str, Any]:
    """`displacement` of a predictor and of constant velocity, crowd by crowd."""
    plain = ConstantVelocity(float(predictor.time_step))
    return {
        name: {
            "windows": len(windows.past),
            "constant_velocity": displacement(plain, windows, steps),
            "predictor": displacement(predictor, windows, steps),
        }
        for name, windows in crowds.items()
    }


def page(result: Mapping[str, Any], time_step: float) -> str:
    """The errors as a page of Markdown."""
    found = result["errors"]
    steps = range(1, 1 + len(next(iter(found.values()))["predictor"]))
    header = ["people", "windows", "predictor", *(f"{k * time_step:g} s" for k in steps), "last"]
    lines = []
    for name, row in found.items():
        least = row["constant_velocity"][-1]
        for which in ("constant_velocity", "predictor"):
            change = f"{100 * (row[which][-1] / least - 1):+.1f} %" if least else ""
            cells = [f"{error:.3f}" for error in row[which]]
            lines.append([name, str(row["windows"]), which.replace("_", " "), *cells,
                          change])  # fmt: skip
    return f"""# Predicting people

Mean distance, in metres, of where people are from where they were predicted so many seconds before.
Simulated crowds are of validation cases; nothing was trained or selected on recorded people. The
last column compares the last time with constant velocity.

{as_text(header, lines)}

Made by `{result["command"]}` at commit {result["commit"]} on {machine()}.
"""
