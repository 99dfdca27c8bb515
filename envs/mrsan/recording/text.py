"""The lines of a text file in one of several encodings."""

from __future__ import annotations

import codecs
from pathlib import Path

from mrsan.recording.rows import RecordingError

MAX_BYTES = 200 * 10**6  # of a file; reading takes twenty times as much memory
_REQUIREMENT = "it must be a text file of recorded people"
_SIGNATURES = {  # first bytes of files that are not text: their kind, and a remedy
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
        RecordingError: the file cannot be read, is too large, or is not text.
    """
    if "\0" in str(path):
        raise RecordingError(f"its path has a zero byte; {_REQUIREMENT}")
    try:
        size = path.stat().st_size
        if not path.is_file():  # a folder or a pipe
            raise RecordingError(f"it is not a file; {_REQUIREMENT}")
        if size > MAX_BYTES:
            raise RecordingError(
                f"it has {size / 1e6:.0f} MB; it must have at most {MAX_BYTES / 1e6:.0f} MB "
                "(cut out a few minutes)"
            )
        content = path.read_bytes()
    except OSError as error:
        raise RecordingError(f"it cannot be read ({error.strerror}); {_REQUIREMENT}") from None
    for signature, (kind, remedy) in _SIGNATURES.items():
        if content.startswith(signature):
            raise RecordingError(f"it is {kind}; {remedy}")
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
