"""List the targets of a Makefile with their descriptions: `python -m tools.list_targets Makefile`.

Runs before `.venv` exists, on any Python from 3.7 on.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

_TARGET = re.compile(r"^([a-z-]+):.*?## (.*)$", re.MULTILINE)
_FOOTER = """\
Every target first sets up .venv if necessary. PYTHON names the interpreter (3.11 to 3.13):
  make test PYTHON=python3.13"""


def described_targets(makefile: str) -> dict[str, str]:
    """Return the description of every target that has one, in the order of the file.

    Args:
        makefile: the text of a Makefile; a description follows the prerequisites after `##`.
    """
    return dict(_TARGET.findall(makefile))


def main() -> None:
    """Print one line for each described target."""
    for name, description in described_targets(
        Path(sys.argv[1]).read_text(encoding="utf-8")
    ).items():
        print(f"  make {name:12} {description}")
    print(_FOOTER)


if __name__ == "__main__":
    main()
