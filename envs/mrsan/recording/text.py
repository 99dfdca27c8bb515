"""From the bytes of a file to its lines."""

from __future__ import annotations

import codecs
from pathlib import Path

from mrsan.recording.rows import RecordingError

MAX_BYTES = 200 * 10**6  # of a file; reading takes twenty times as much memory
_RIGHT = "it must be a text file of recorded people"
_SIGNATURES = {  # of files that are not text: what they are, and what to do
    b"\x1f\x8b": ("compressed", "unpack it first"),
    b"PK\x03\x04": ("a ZIP archive or an Excel workbook", "unpack it, or save the sheet as CSV"),
    b"\xd0\xcf\x11\xe0": ("an Excel workbook", "save the sheet as CSV"),
    b"SQLite format 3": ("an SQLite database", "export its trajectories as text"),
    b"\x89HDF": ("an HDF5 file", "export its trajectories as text"),
    b"MATLAB": ("a MATLAB file", "export its trajectories as text"),
}
_BYTE_ORDER_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file in UTF-8, UTF-16 with a byte-order mark, or Latin-1.

    Raises:
        RecordingError: it cannot be read, is too large, or is not text.
    """
    if "\0" in str(path):
        raise RecordingError(f"its path has a zero byte; {_RIGHT}")
    try:
        size = path.stat().st_size
        if not path.is_file():  # a folder or a pipe
            raise RecordingError(f"it is not a file; {_RIGHT}")
        if size > MAX_BYTES:
            raise RecordingError(
                f"it has {size / 1e6:.0f} MB; it must have at most {MAX_BYTES / 1e6:.0f} MB (use "
                "some minutes of it)"
            )
        content = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"it cannot be read ({error.strerror}); {_RIGHT}") from None
    for signature, (what, remedy) in _SIGNATURES.items():
        if content.startswith(signature):
            raise RecordingError(f"it is {what}; {remedy}")
    return _decode(content).splitlines()


def _decode(content: bytes) -> str:
    marked = [name for mark, name in _BYTE_ORDER_MARKS.items() if content.startswith(mark)]
    for encoding in marked or ["utf-8", "latin-1"]:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if not any(character < " " and not character.isspace() for character in set(text)):
            return text
    raise RecordingError("it cannot be read as text; it must be text in UTF-8 or UTF-16")
