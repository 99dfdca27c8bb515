"""The formats of public recordings, recognised by the content of their files."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from mrsan.recording.json_lines import read_json_lines
from mrsan.recording.rows import Floats, RecordingError, Rows
from mrsan.recording.table import Table, is_number, read_table
from mrsan.recording.text import read_lines

MAX_FRAME, MAX_POSITION = 1e9, 1e11  # largest magnitudes; positions may be in mm
PLAIN = "plain table (frame id x y)"
_FRAME_RATE = re.compile(r"(?:frame ?rate|fps)\s*[:=]?\s*(\d+\.?\d*)", re.IGNORECASE)
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3}
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_EPOCH = (1e9, 4e9)  # s since 1970 in the years 2001 to 2096
_EPOCH_UNITS = {"seconds": 1.0, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_PERSON_LABEL = "pedestrian"  # in SDD
_WALKING_SPEED = 0.3  # smallest speed from which the time between frames is estimated, m/s
_UNSUPPORTED = {  # first character of files of other kinds: their kind, and a remedy
    "[": ("a JSON document", "it must be JSON lines, as in TrajNet++, or a table"),
    "<": ("an XML document", "export its trajectories as a table 'frame id x y'"),
}


def read_rows(path: Path) -> Rows:
    """Read a file of any supported format.

    Raises:
        RecordingError: the file cannot be read, has an unknown format or an invalid line.
    """
    lines = read_lines(path)
    first_line = next((line.strip() for line in lines if line.strip()), "")
    if "number of splines" in first_line:
        raise RecordingError("it contains splines of UCY (.vsp); it must be a table 'frame id x y'")
    if first_line[:1] in _UNSUPPORTED:
        kind, remedy = _UNSUPPORTED[first_line[:1]]
        raise RecordingError(f"it is {kind}; {remedy}")
    if first_line.startswith("{"):
        return _checked(read_json_lines(lines))
    table = read_table(lines)
    rows = _checked(_from_table(table))
    if table.placeholders:
        note = f"{table.placeholders} rows without positions ('?', to be predicted) are omitted"
        rows = replace(rows, notes=(*rows.notes, note))
    return rows


def _from_table(table: Table) -> Rows:
    """Recognise the columns of a table by their names or by their number."""
    length, width = table.cells.shape
    if table.columns:
        return _from_named_columns(table)
    if _frame_rate(table) and width >= 4:
        return replace(
            _from_columns(table, 1, 0, 2, 3),
            frame_seconds=_frame_rate(table),
            format="PedPy or JuPedSim (id frame x y)",
        )
    if length == 4 and width > 4:
        return _transposed(table)
    if width == 4:
        return _from_columns(table, 0, 1, 2, 3)
    if width == 8:
        return _atc(table) if _is_epoch(table.numbers(0, "time"), 1.0) else _obsmat(table)
    if width == 10 and not is_number(table.cells[9][0]):
        return _stanford_drone(table)
    raise RecordingError(
        f"its rows have {width} values and no header names them; it must have 4 (frame id x y), 8 "
        "(obsmat.txt of ETH, ATC) or 10 (SDD), or a first line that names frame, id, x and y"
    )


def _from_columns(table: Table, frame: int, person: int, x: int, y: int) -> Rows:
    """Return the rows of a table from the columns with these indices."""
    position = np.stack([table.numbers(x, "x"), table.numbers(y, "y")], -1)
    frames, persons = table.numbers(frame, "the frame number"), table.persons(person)
    return Rows(PLAIN, frames, persons, position, table.line, where=table.where)


def _from_named_columns(table: Table) -> Rows:
    """Read a table whose header or comment names its columns."""
    columns = table.columns
    time = columns.get("time")
    if time is None or (time.unit not in _SECONDS and "frame" in columns):
        time = columns["frame"]
    units = {role: columns[role].unit for role in ("x", "y")}
    if units["x"] != units["y"]:
        raise RecordingError(
            f"x is in {units['x']} and y in {units['y']}; both must be in the same unit"
        )
    rate = _frame_rate(table) if time == columns.get("frame") else None
    rows = _from_columns(table, time.index, *(columns[role].index for role in ("id", "x", "y")))
    unit = units["x"] or ""
    return replace(
        rows,
        format="PedPy or JuPedSim" if rate else "table with named columns",
        frame_seconds=rate or _SECONDS.get(time.unit or ""),
        metres=_METRES.get(unit),
        pixels=unit.startswith("p"),
    )


def _frame_rate(table: Table) -> float | None:
    """Return the time between frame numbers that a comment states, s."""
    for comment in table.comments:
        match = _FRAME_RATE.search(comment)
        if match and float(match[1]) > 0:
            return 1.0 / float(match[1])
    return None


def _transposed(table: Table) -> Rows:
    """Read files such as `true_pos_.csv`: one line each of frame numbers, ids, y and x."""
    columns = replace(
        table,
        cells=table.cells.T.reset_index(drop=True),
        line=np.arange(1, table.width + 1),
        where="column",
    )
    rows = _from_columns(columns, 0, 1, 3, 2)
    if np.abs(rows.position).max() <= 1.0:
        raise RecordingError(
            "its positions are relative to the width and height of the image, as in "
            "pixel_pos.csv; they must be in metres, as in true_pos_.csv"
        )
    return replace(rows, format="transposed (lines of frame, id, y and x)")


def _obsmat(table: Table) -> Rows:
    """Read `obsmat.txt` of ETH: frame, id, x, z, y and the velocity along each."""
    if any(np.ptp(table.numbers(column, name)) for column, name in ((3, "z"), (6, "v_z"))):
        raise RecordingError(
            "its rows have 8 values, but neither those of ETH's obsmat.txt (frame id x z y v_x v_z "
            "v_y with a constant z) nor those of ATC (which begin with a time in seconds since "
            "1970); a first line must name frame, id, x and y"
        )
    rows = _from_columns(table, 0, 1, 2, 4)
    velocity = np.hypot(table.numbers(5, "v_x"), table.numbers(7, "v_y"))
    seconds = _estimated_frame_seconds(rows, velocity)
    notes = () if seconds is None else (f"its velocities imply frames {seconds:g} s apart",)
    return replace(
        rows,
        format="obsmat.txt of ETH (frame id x z y and velocities)",
        frame_seconds=seconds,
        notes=notes,
    )


def _estimated_frame_seconds(rows: Rows, velocity: Floats) -> float | None:
    """Return the time between frame numbers at which displacements match the velocities, s."""
    order = np.lexsort((rows.frame, rows.person))
    frames, distance = np.diff(rows.frame[order]), np.diff(rows.position[order], axis=0)
    speed = velocity[order][:-1]
    walking = (np.diff(rows.person[order]) == 0) & (frames > 0) & (speed > _WALKING_SPEED)
    if not walking.any():
        return None
    lengths = np.linalg.norm(distance[walking], axis=1)
    seconds = np.median(lengths / speed[walking] / frames[walking])
    return float(f"{seconds:.3g}") or None


def _atc(table: Table) -> Rows:
    """Read ATC: time in seconds since 1970, id, x, y and z in mm, velocity, two angles."""
    return replace(
        _from_columns(table, 0, 1, 2, 3),
        format="ATC (seconds, id, x, y and z in mm, velocity, angles)",
        frame_seconds=1.0,
        metres=1e-3,
    )


def _stanford_drone(table: Table) -> Rows:
    """Read SDD: id, the corners of a box in pixels, frame, lost, occluded, generated, label."""
    boxes = np.stack([table.numbers(k, "a corner of the box") for k in (1, 2, 3, 4)], -1)
    people = table.cells[9].str.strip("\"'").str.lower().to_numpy() == _PERSON_LABEL
    visible = table.numbers(6, "lost") == 0
    used = people & visible
    if not used.any():
        raise RecordingError("it has no row of a visible Pedestrian; it must have some")
    notes = [
        f"{count} rows {reason} are omitted"
        for count, reason in (
            ((~people).sum(), "of bikers, cars and other agents"),
            ((people & ~visible).sum(), "of people outside the image"),
        )
        if count
    ]
    return Rows(
        "SDD (boxes in pixels)",
        frame=table.numbers(5, "the frame number")[used],
        person=table.persons(0)[used],
        position=((boxes[:, :2] + boxes[:, 2:]) / 2)[used],
        line=table.line[used],
        pixels=True,
        notes=tuple(notes),
    )


def _is_epoch(times: Floats, unit: float) -> bool:
    """Return whether times in units of `unit` seconds count from 1970."""
    return bool((times * unit > _EPOCH[0]).all() and (times * unit < _EPOCH[1]).all())


def _checked(rows: Rows) -> Rows:
    """Shift times since 1970 to begin at zero, and reject numbers that are too large.

    Raises:
        RecordingError: names the line with the largest number.
    """
    for name, unit in _EPOCH_UNITS.items():
        if _is_epoch(rows.frame, unit):
            rows = replace(
                rows,
                frame=rows.frame - rows.frame.min(),
                frame_seconds=rows.frame_seconds or unit,
                notes=(*rows.notes, f"its times are {name} since 1970"),
            )
            break
    for name, values, most in (
        ("the frame number", rows.frame, MAX_FRAME),
        ("a position", rows.position, MAX_POSITION),
    ):
        numbers = values.reshape(len(rows.line), -1)
        row, column = np.unravel_index(np.abs(numbers).argmax(), numbers.shape)
        if abs(numbers[row, column]) > most:
            raise RecordingError(
                f"{rows.where} {rows.line[row]}: {name} is {numbers[row, column]:g}; its magnitude "
                f"must be at most {most:g}"
            )
    return rows
