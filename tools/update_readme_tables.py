"""Copy tables from `results/` into the README: `python -m tools.update_readme_tables`.

The table `NAME` stands between `<!-- NAME -->` and `<!-- /NAME -->` in the README.
"""

from __future__ import annotations

import sys
from itertools import dropwhile, takewhile
from pathlib import Path

# The heading in results/NAME.md whose first table the README shows.
HEADINGS = {"table1": "# Table I", "transfer": "### Recorded people"}


def first_table(page: str, heading: str) -> str:
    """Return the first Markdown table that follows a heading.

    Raises:
        ValueError: the page has no such heading, or no table follows it.
    """
    after_heading = dropwhile(lambda line: line != heading, page.splitlines())
    from_table = dropwhile(lambda line: not line.startswith("|"), after_heading)
    table = list(takewhile(lambda line: line.startswith("|"), from_table))
    if not table:
        raise ValueError(f"no table follows the heading {heading!r}")
    return "\n".join(table)


def replace_between_marks(text: str, name: str, table: str) -> str:
    """Return the text with the lines between the marks of `name` replaced by the table.

    Raises:
        ValueError: the text does not have both marks, each once and in this order.
    """
    opening, closing = f"<!-- {name} -->\n", f"<!-- /{name} -->\n"
    if text.count(opening) != 1 or text.count(closing) != 1:
        raise ValueError(f"it must have the lines {opening.strip()} and {closing.strip()} once")
    before, _, after_opening = text.partition(opening)
    _, mark, after = after_opening.partition(closing)
    if not mark:
        raise ValueError(f"{opening.strip()} must stand before {closing.strip()}")
    return f"{before}{opening}{table}\n{closing}{after}"


def update_readme(root: Path) -> None:
    """Rewrite `README.md` with the current tables, completely or not at all.

    Raises:
        ValueError: a heading, a table or a mark is missing; the message names the file.
    """
    readme = root / "README.md"
    text = readme.read_text()
    for name, heading in HEADINGS.items():
        page = root / f"results/{name}.md"
        try:
            table = first_table(page.read_text(), heading)
        except ValueError as error:
            raise ValueError(f"{page}: {error}") from error
        try:
            text = replace_between_marks(text, name, table)
        except ValueError as error:
            raise ValueError(f"{readme}: {error}") from error
    part = readme.with_name("README.md.part")
    part.write_text(text)
    part.replace(readme)


def main() -> None:
    """Update the README in the current folder; errors end in one line."""
    try:
        update_readme(Path.cwd())
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
