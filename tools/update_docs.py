"""Fill figures and tables of `results/` into the documentation: `python -m tools.update_docs`.

In `README.md`, `paper.md` and `docs/*.md` a figure stands between `<!--fig WORDS-->` and `<!--/-->`
(`tools/figures.py` explains the words), and a table between the lines `<!-- table NAME -->` and
`<!-- /table -->` (`tools/doc_tables.py` has the names). `tools/model_cards.py` adds model cards.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from samarl.files import write_text
from samarl.report.leaderboard import task_rows
from tools.doc_tables import TABLES
from tools.figures import figure
from tools.model_cards import model_cards

_FIGURE = re.compile(r"<!--fig ([^>]+)-->(.*?)<!--/-->", re.DOTALL)
_TABLE = re.compile(r"<!-- table (\w+) -->\n(.*?)<!-- /table -->\n", re.DOTALL)
_ANY_MARK = re.compile(r"<!--fig |<!--/-->|<!-- /?table\b")


def fill(text: str) -> str:
    """Return a page with the current figures and tables between its marks.

    Raises:
        ValueError: a mark has no counterpart, or names a figure or table that does not exist.
    """
    check_marks(text)
    text = _FIGURE.sub(lambda mark: f"<!--fig {mark[1]}-->{figure(mark[1].split())}<!--/-->", text)
    return _TABLE.sub(
        lambda mark: f"<!-- table {mark[1]} -->\n{_table(mark[1])}\n<!-- /table -->\n", text
    )


def without_marks(text: str) -> str:
    """Return a page without its marks."""
    return _TABLE.sub(lambda mark: mark[2], _FIGURE.sub(lambda mark: mark[2], text))


def check_marks(text: str) -> None:
    """Check that every mark is one of a pair.

    Raises:
        ValueError: one is not; the message shows the text around it.
    """
    rest = without_marks(text)
    if stray := _ANY_MARK.search(rest):
        raise ValueError(f"unpaired mark: {rest[stray.start() : stray.start() + 60]!r}")


def _table(name: str) -> str:
    if name not in TABLES:
        raise ValueError(f"table is {name!r}; it must be one of {', '.join(sorted(TABLES))}")
    return TABLES[name]()


def pages(root: Path) -> list[Path]:
    """Return the pages that may have marks."""
    return [root / "README.md", *root.glob("paper.md"), *sorted((root / "docs").glob("*.md"))]


def update_docs(root: Path) -> None:
    """Rewrite all pages and model cards, or none of them.

    Raises:
        ValueError: a mark is wrong; the message names the page.
    """
    filled = {}
    for page in pages(root):
        try:
            filled[page] = fill(page.read_text(encoding="utf-8"))
        except (ValueError, KeyError, IndexError) as error:
            raise ValueError(f"{page}: {error}") from error
    for page, text in (filled | model_cards(root, task_rows())).items():
        write_text(page, text)


def main() -> None:
    """Update the pages in the current folder; errors end in one line."""
    try:
        update_docs(Path.cwd())
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
