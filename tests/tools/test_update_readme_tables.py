"""The README shows the tables of `results/`."""

from pathlib import Path

import pytest

from tools.update_readme_tables import HEADINGS, first_table, replace_between_marks, update_readme

ROOT = Path(__file__).parents[2]
PAGE = "# One\n\n| a |\n|---|\n| 1 |\n\n# Two\n\nText.\n\n| b |\n|---|\n| 2 |\nMore.\n| c |\n"


@pytest.mark.parametrize(
    ("heading", "table"), [("# One", "| a |\n|---|\n| 1 |"), ("# Two", "| b |\n|---|\n| 2 |")]
)
def test_the_first_table_after_a_heading(heading: str, table: str) -> None:
    assert first_table(PAGE, heading) == table


def test_only_the_lines_between_the_marks_change() -> None:
    text = "x\n<!-- t -->\nold\nold\n<!-- /t -->\n<!-- u -->\nkept\n<!-- /u -->\n"
    assert replace_between_marks(text, "t", "| new |") == text.replace("old\nold", "| new |")


def test_the_committed_readme_shows_the_committed_tables(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    for name in ("README.md", *(f"results/{page}.md" for page in HEADINGS)):
        (tmp_path / name).write_text((ROOT / name).read_text())
    update_readme(tmp_path)
    assert (tmp_path / "README.md").read_text() == (ROOT / "README.md").read_text()
    assert not (tmp_path / "README.md.part").exists()


@pytest.mark.parametrize(
    ("readme", "page", "names"),
    [
        ("<!-- table1 -->\n<!-- /table1 -->\n", "# Table 2\n| a |\n", ("table1.md", "# Table I")),
        ("<!-- table1 -->\n", "# Table I\n| a |\n", ("README.md", "<!-- /table1 -->")),
        ("<!-- /table1 -->\n<!-- table1 -->\n", "# Table I\n| a |\n", ("README.md", "table1")),
    ],
)
def test_a_missing_heading_or_mark_leaves_the_readme_unchanged(
    tmp_path: Path, readme: str, page: str, names: tuple[str, ...]
) -> None:
    (tmp_path / "results").mkdir()
    (tmp_path / "README.md").write_text(readme)
    (tmp_path / "results/table1.md").write_text(page)
    with pytest.raises(ValueError) as error:  # noqa: PT011 (the names below tell it apart)
        update_readme(tmp_path)
    assert all(name in str(error.value) for name in names)
    assert (tmp_path / "README.md").read_text() == readme
