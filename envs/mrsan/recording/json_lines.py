"""TrajNet++ files, in which every line is a JSON object: a scene, or a person in a frame."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrsan.recording.rows import RecordingError, Rows, typical_step

_FIELDS = ("f", "p", "x", "y")  # frame, person and position
_SHOWN = 60  # characters of a line in a message


def read_json_lines(lines: Sequence[str]) -> Rows:
    """Read the tracks of TrajNet++; of several predictions of a person, only number 0.

    Raises:
        RecordingError: a line is not JSON, or a track lacks a number.
    """
    values: list[list[float]] = []
    line_numbers: list[int] = []
    rates: set[Any] = set()
    predictions = alternatives = 0
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        kind, content = _parsed(line, number)
        if kind == "scene":
            rates.add(content.get("fps"))
            continue
        prediction = content.get("prediction_number")
        predictions += prediction is not None
        if prediction in (None, 0):
            values.append([_number(content, field, number) for field in _FIELDS])
            line_numbers.append(number)
        else:
            alternatives += 1
    if not values:
        raise RecordingError("it has no tracks; it must have one for each person in a frame")
    frame, person, *position = np.array(values).T
    note = f"{alternatives} rows of alternative predictions are omitted"
    rows = Rows(
        "TrajNet++ predictions" if predictions else "TrajNet++",
        frame,
        person.astype(np.int64),
        np.stack(position, -1),
        np.array(line_numbers),
        notes=(note,) * bool(alternatives),
    )
    return replace(rows, frame_seconds=_frame_seconds(rows, rates))


def _parsed(line: str, number: int) -> tuple[str, dict[str, Any]]:
    """Return the kind of a line, scene or track, and its fields."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        raise RecordingError(f"line {number}: {line[:_SHOWN]!r} must be a JSON object") from None
    for kind in ("scene", "track"):
        if isinstance(content, dict) and isinstance(content.get(kind), dict):
            return kind, content[kind]
    raise RecordingError(
        f"line {number}: {line[:_SHOWN]!r} is neither a scene nor a track; it must be one of them"
    )


def _number(track: dict[str, Any], field: str, line: int) -> float:
    """Return a field of a track, a finite number; that of the person must be whole."""
    value = track.get(field)
    try:
        number = float(value) if isinstance(value, int | float) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or (field == "p" and (number % 1 or abs(number) > 2**53)):
        required = "a whole number" if field == "p" else "a number"
        raise RecordingError(f"line {line}: {field} is {value!r:.60}; it must be {required}")
    return number


def _frame_seconds(rows: Rows, rates: set[Any]) -> float | None:
    """Return the time between frame numbers from `fps`, the rate of annotated frames, s."""
    rate = rates.pop() if len(rates) == 1 else None
    step = typical_step(rows)
    if not isinstance(rate, int | float) or not 0 < rate < math.inf or not step:
        return None
    return 1.0 / (rate * step)
