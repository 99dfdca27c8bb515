"""The documentation shows the figures of `results/`."""

import json
from pathlib import Path

import pytest
import yaml

from samarl.evaluation.summary import read_rows
from samarl.report.leaderboard import task_rows
from tools.doc_tables import METHODS
from tools.figures import figure
from tools.model_cards import model_cards
from tools.update_docs import fill, pages, update_docs

ROOT = Path(__file__).parents[2]


def waypoints_at_360_degrees() -> dict[str, float]:
    rows = read_rows(ROOT / "results/table1.json") or []
    (row,) = [
        r
        for r in rows
        if (r["method"], r["fov_degrees"], r["robots"]) == ("samarl_waypoints", 360.0, 3)
    ]
    return row


def test_a_figure_is_the_field_of_a_row() -> None:
    row = waypoints_at_360_degrees()
    words = "table1 samarl_waypoints 360/10/3"
    assert figure(f"{words} success".split()) == f"{row['success_rate']:.1f}"
    assert figure(f"{words} path_length .1f".split()) == f"{row['path_length']:.1f}"
    seeds = [row[f"success_seed_{key}"] for key in ("mean", "min", "max")]
    assert figure(f"{words} seeds".split()) == "{:.1f} [{:.1f}, {:.1f}]".format(*seeds)


def test_a_figure_is_a_value_of_a_file() -> None:
    recipes = json.loads((ROOT / "results/learning_speed.json").read_text())["recipes"]
    minutes = sum(recipes["flat"]["seconds_to_90"]) / 3 / 60
    words = "learning_speed recipes.flat.seconds_to_90 mean /60 .2f"
    assert figure(words.split()) == f"{minutes:.2f}"


@pytest.mark.parametrize(
    "text",
    [
        "<!-- table headline -->\n| a |\n",
        "| a |\n<!-- /table -->\n",
        "<!--fig table1 samarl 360/10/3 success-->1.0",
        "<!-- table nothing -->\n<!-- /table -->\n",
    ],
)
def test_a_wrong_mark_leaves_every_page_unchanged(tmp_path: Path, text: str) -> None:
    (tmp_path / "docs").mkdir()
    good = "<!--fig table1 samarl 360/10/3 success-->0<!--/-->\n"
    (tmp_path / "README.md").write_text(good)
    (tmp_path / "docs/page.md").write_text(text)
    with pytest.raises(ValueError, match=r"page\.md"):
        update_docs(tmp_path)
    assert (tmp_path / "README.md").read_text() == good
    assert (tmp_path / "docs/page.md").read_text() == text


def test_the_committed_pages_show_the_committed_results() -> None:
    for page in pages(ROOT):
        text = page.read_text(encoding="utf-8")
        assert fill(text) == text, page.name
    for path, text in model_cards(ROOT, task_rows()).items():
        assert path.read_text(encoding="utf-8") == text, path.name


def test_make_bench_plays_the_rows_of_the_readme() -> None:
    table = yaml.safe_load((ROOT / "conf/table/table1.yaml").read_text())
    assert set(table["headline"]) == set(METHODS)
