"""Tables in text files: their separators, headers and numbers."""

from __future__ import annotations

import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from mrsan.recording.rows import Floats, Ints, RecordingError

COMMENTS = ("#", "%", "//", ";")  # prefixes of lines that do not belong to the table
PLACEHOLDER = "?"  # in TrajNet, a position that is to be predicted
_NUMBER = re.compile(r"""\s*["']?[-+]?\.?\d""")
_SHOWN = 60  # characters of a line in a message

# Names of columns without their units, reduced to lower-case letters.
_NAMES = {
    "frame": "frame frameid framenumber framenr frameno framenum frameindex fr f",
    "time": "time timestamp simtime seconds sec t",
    "id": "id pedid pedestrianid personid persid agentid trackid ped pedestrian person agent track "
    "pid p",
    "x": "x posx xpos positionx xposition xcenter xcentre centerx xcoord xworld worldx",
    "y": "y posy ypos positiony yposition ycenter ycentre centery ycoord yworld worldy",
}
_ROLES = {name: role for role, names in _NAMES.items() for name in names.split()}
_WITH_UNIT = re.compile(r"(.+?)\s*[\[(/_ ]\s*(m|cm|mm|px|pixels?|s|sec|seconds|ms)\s*[\])]?")


@dataclass(frozen=True)
class Column:
    """The index of a column, and the unit that its name states."""

    index: int
    unit: str | None = None


@dataclass(frozen=True)
class Table:
    """The R rows and C columns of a text file."""

    cells: Any  # pandas.DataFrame [R, C] of texts
    line: Ints  # [R] line numbers in the file, from 1
    columns: dict[str, Column]  # by role: frame, time, id, x, y; empty without a header
    comments: list[str]  # before the first row
    placeholders: int  # number of rows omitted because their positions are to be predicted
    where: str = "line"  # what `line` counts

    @property
    def width(self) -> int:
        """Return the number of columns C."""
        return int(self.cells.shape[1])

    def numbers(self, column: int, name: str) -> Floats:
        """Read a column of finite numbers, [R].

        Raises:
            RecordingError: a cell is not a finite number.
        """
        cells = self.cells[column].to_numpy(np.object_)
        try:
            values = cells.astype(np.float64)
            invalid = np.flatnonzero(~np.isfinite(values))
        except ValueError:
            invalid = np.array([row for row, cell in enumerate(cells) if not is_number(cell)])
        if len(invalid):
            row = invalid[0]
            raise RecordingError(
                f"{self.where} {self.line[row]}: {name} is {cells[row][:_SHOWN]!r}; it must be a "
                "finite number"
            )
        return values

    def persons(self, column: int) -> Ints:
        """Read a column of ids of people, which are whole numbers, [R].

        Raises:
            RecordingError: a cell is not a whole number.
        """
        cells = self.cells[column].to_numpy(np.object_)
        try:
            return np.array([int(cell) for cell in cells], np.int64)
        except (ValueError, OverflowError):  # "1.0", or not a whole number
            values = self.numbers(column, "the id")
        invalid = np.flatnonzero((values % 1 != 0) | (np.abs(values) > 2**53))
        if len(invalid):
            row = invalid[0]
            raise RecordingError(
                f"{self.where} {self.line[row]}: the id of a person is {cells[row]}; it must be a "
                "whole number below 2^53 (is another column the id?)"
            )
        return values.astype(np.int64)


def is_number(text: str) -> bool:
    """Return whether a text is a finite number."""
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def read_table(lines: Sequence[str]) -> Table:
    """Read the lines of a table, with or without a header.

    Cells are separated by white space, commas or semicolons; unless commas separate cells, they may
    be decimal marks.

    Raises:
        RecordingError: a line has a different number of cells than the others or is not a row.
    """
    begin = next((k for k, line in enumerate(lines) if _NUMBER.match(line)), None)
    if begin is None:
        _raise_without_rows(lines)
    separator = _separator(lines[begin])
    comments = tuple(mark for mark in COMMENTS if mark != separator)
    numbered = [
        (number, line.strip().rstrip(f"{separator or ''} \t"))
        for number, line in enumerate(lines[begin:], begin + 1)
        if line.strip() and not line.lstrip().startswith(comments)
    ]
    rows = [
        (number, line)
        for number, line in numbered
        if PLACEHOLDER not in line or PLACEHOLDER not in _split(line, separator)
    ]
    if not rows:
        raise RecordingError(f"every position is {PLACEHOLDER!r}; it must have some positions")
    cells = _cells(rows, separator)
    columns, notes = _header(lines[:begin], separator, cells.shape[1], comments)
    line = np.array([number for number, _ in rows])
    return Table(cells, line, columns, notes, len(numbered) - len(rows))


def _raise_without_rows(lines: Sequence[str]) -> NoReturn:
    for number, line in enumerate(lines, 1):
        if line.strip() and not line.lstrip().startswith(COMMENTS):
            raise RecordingError(
                f"line {number}: {line.strip()[:_SHOWN]!r} is not a row of numbers; it must be one "
                "such as 'frame id x y'"
            )
    raise RecordingError(
        "it is empty; it must have a row 'frame id x y' for each person in a frame"
    )


def _separator(line: str) -> str | None:
    """Return the separator of the cells of a row; None for white space."""
    if ";" in line:
        return ";"
    cells = [cell.strip() for cell in line.split(",")]
    # Decimal commas in columns separated by white space do not separate: "0 6 6,80 12,44".
    spaced = any(character.isspace() for cell in cells[:2] for character in cell)
    return "," if len(cells) >= 3 and not spaced else None


def _split(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip("\"'") for cell in line.split(separator)]


def _cells(rows: Sequence[tuple[int, str]], separator: str | None) -> Any:
    """Return the cells of numbered lines as a DataFrame of texts, with decimal points."""
    try:
        import pandas as pd
    except ModuleNotFoundError:
        raise RecordingError(
            "pandas, which reads recordings, is not installed: pip install pandas"
        ) from None
    text = "\n".join(line for _, line in rows)
    options: dict[str, Any] = {"header": None, "dtype": str, "keep_default_na": False}
    try:
        cells = pd.read_csv(
            io.StringIO(text), sep=separator or r"\s+", skipinitialspace=True, **options
        )
    except pd.errors.ParserError as error:
        _reject_ragged(rows, separator)
        raise RecordingError(f"it must be a table ({str(error).strip()})") from None
    if (cells == "").to_numpy().any():
        _reject_ragged(rows, separator)
    if len(cells) != len(rows):
        raise RecordingError("quotation marks enclose whole lines; they must enclose cells")
    if separator != "," and "," in text:
        cells = cells.apply(lambda column: column.str.replace(",", "."))
    return cells


def _reject_ragged(rows: Sequence[tuple[int, str]], separator: str | None) -> None:
    """Raise an error for the first line with an unusual number of cells or an open quotation."""
    widths = [len(_split(line, separator)) for _, line in rows]
    usual = Counter(widths).most_common(1)[0][0]
    for (number, line), width in zip(rows, widths, strict=True):
        if line.count('"') % 2:
            raise RecordingError(
                f"line {number}: {line[:_SHOWN]!r} has a quotation mark that is not closed; it "
                "must be closed"
            )
        if width != usual:
            raise RecordingError(
                f"line {number}: {line[:_SHOWN]!r} has {width} values; it must have {usual} like "
                "the other lines"
            )


def _header(
    lines: Sequence[str], separator: str | None, width: int, comments: tuple[str, ...]
) -> tuple[dict[str, Column], list[str]]:
    """Return the columns named before the first row, and the comments before it."""
    columns: dict[str, Column] = {}
    notes = []
    for number, line in enumerate(lines, 1):
        text = line.strip()
        comment = text.startswith(comments)
        if comment:
            text = text.lstrip("".join(comments)).strip()
            notes.append(text)
        for names in (_split(text, separator), _split_at_spaces(text)):
            if len(names) == width - 1:  # the first column is an unnamed index
                names.insert(0, "")
            roles = _roles(names)
            if len(names) == width and not _missing(roles):
                _reject_ambiguous(number, names)
                columns = roles
                break
        else:
            if text and not comment:
                _raise_invalid_header(number, text, _roles(_split(text, separator)), width)
    return columns, notes


def _split_at_spaces(text: str) -> list[str]:
    return re.sub(r"\s+(?=[\[(])", "", text).split()  # "x [m]" is one name


def _roles(names: Sequence[str]) -> dict[str, Column]:
    """Return the columns with recognised names, by their roles."""
    roles: dict[str, Column] = {}
    for index, name in enumerate(names):
        role, unit = _parsed(name)
        if role:
            roles[role] = Column(index, unit)
    return roles


def _parsed(name: str) -> tuple[str | None, str | None]:
    """Return the role and the unit of a column from its name; None where unknown."""
    text = name.lower()
    match = _WITH_UNIT.fullmatch(text)
    stem, unit = match.groups() if match else (text, None)
    return _ROLES.get(re.sub("[^a-z]", "", stem)), unit


def _reject_ambiguous(number: int, names: Sequence[str]) -> None:
    for role in _NAMES:
        same = [name for name in names if _parsed(name)[0] == role]
        if len(same) > 1:
            raise RecordingError(
                f"line {number}: the columns {' and '.join(map(repr, same))} may both be {role}; "
                f"only one name must mean {role}"
            )


def _missing(roles: dict[str, Column]) -> list[str]:
    """Return the required roles that a header does not name."""
    clock = [] if {"frame", "time"} & roles.keys() else ["frame"]
    return clock + [role for role in ("id", "x", "y") if role not in roles]


def _raise_invalid_header(number: int, text: str, roles: dict[str, Column], width: int) -> NoReturn:
    missing = _missing(roles)
    if not missing:
        reason = f"does not name {width} columns, the number of values in each row"
    elif len(missing) < 3:
        reason = f"has no column named {' or '.join(missing)}"
    else:
        reason = "is neither a row of numbers nor names of columns"
    raise RecordingError(
        f"line {number}: {text[:_SHOWN]!r} {reason}; it must name frame (or time), id, x and y, or "
        "be a comment that begins with #"
    )
