"""The learning curve of a training run: its file `progress.csv`."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError

Points = tuple[NDArray[np.float64], NDArray[np.float64]]  # steps and values
Curve = dict[str, Points]  # by column


def read_curve(path: Path) -> Curve:
    """Read the columns of a learning curve over its steps, without missing values.

    Raises:
        ConfigurationError: the file is not a table of comma-separated values.
    """
    points: dict[str, list[tuple[float, float]]] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            lines = list(csv.DictReader(file))
    except (csv.Error, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path} is not a learning curve ({error})") from error
    for line in lines:
        steps = number_in(line.get("steps"))
        for column, text in line.items():
            value = number_in(text)
            if column not in ("steps", "seconds") and math.isfinite(steps + value):
                points.setdefault(column, []).append((steps, value))
    return {column: (np.array(p).T[0], np.array(p).T[1]) for column, p in points.items()}


def number_in(text: str | None) -> float:
    """Return the number in a cell, NaN if there is none."""
    try:
        return float(text or "nan")
    except (ValueError, TypeError):  # a list of the cells beyond the header
        return math.nan
