"""The documentation shows the figures of `results/`."""

import json
from pathlib import Path

import pytest
import yaml

from samarl.evaluation.summary import read_rows
from tools.doc_tables import METHODS, ONE_LEVEL, TABLES
from tools.figures import figure
from tools.update_docs import fill, pages, update_docs, without_marks

ROOT = Path(__file__).parents[2]


def samarl_at_360_degrees() -> dict[str, float]:
    rows = read_rows(ROOT / "results/table1.json") or []
    (row,) = [
        r for r in rows if (r["method"], r["fov_degrees"], r["robots"]) == ("samarl", 360.0, 3)
    ]
    return row


def test_a_figure_is_the_field_of_a_row() -> None:
    row = samarl_at_360_degrees()
    words = "table1 samarl 360/10/3"
    assert figure(f"{words} success".split()) == f"{row['success_rate']:.1f}"
    assert figure(f"{words} path_length .1f".split()) == f"{row['path_length']:.1f}"
    seeds = [row[f"success_seed_{key}"] for key in ("mean", "min", "max")]
    assert figure(f"{words} seeds".split()) == "{:.1f} [{:.1f}, {:.1f}]".format(*seeds)


def test_a_figure_is_a_value_of_a_file() -> None:
    recipes = json.loads((ROOT / "results/learning_speed.json").read_text())["recipes"]
    minutes = sum(recipes["flat"]["seconds_to_90"]) / 3 / 60
    words = "learning_speed recipes.flat.seconds_to_90 mean /60 .2f"
    assert figure(words.split()) == f"{minutes:.2f}"


def test_a_figure_is_the_change_from_another_value() -> None:
    errors = json.loads((ROOT / "results/prediction.json").read_text())["errors"]["biwi_hotel"]
    change = errors["predictor"][4] / errors["constant_velocity"][4] - 1
    words = "prediction errors.biwi_hotel.predictor.4 change:errors.biwi_hotel.constant_velocity.4"
    assert figure([*words.split(), "+.1f"]) == f"{change:+.1%}".removesuffix("%")


def test_a_condition_with_spaces() -> None:
    rows = json.loads((ROOT / "results/physics.json").read_text())["rows"]
    changes = "engine=mujoco engine.friction=0.05"
    (row,) = [r for r in rows if (r["method"], r["changes"]) == ("samarl", changes)]
    words = "physics samarl 360/10/3 changes=engine=mujoco$engine.friction=0.05 success_rate .0f"
    assert figure(words.split()) == f"{row['success_rate']:.0f}"


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("table1 nobody 360/10/3 both", "0 rows of nobody"),
        ("transfer samarl 360/10/3 both", "rows of samarl in 360/10/3; need 1"),
        ("learning_speed flat 360/10/3 success .1f", "is not a table of results"),
        ("throughput full_step.speed .1f", "has no full_step.speed"),
        ("throughput full_step.min half .1f", "operation is 'half'"),
    ],
)
def test_a_figure_that_does_not_exist(words: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem.replace("[", r"\[")):
        figure(words.split())


def test_only_the_text_between_marks_changes() -> None:
    text = "a <!--fig table1 samarl 360/10/3 success-->0<!--/--> b\n"
    success = figure(["table1", "samarl", "360/10/3", "success"])
    assert without_marks(fill(text)) == f"a {success} b\n"
    table = "x\n<!-- table headline -->\nold\n<!-- /table -->\ny\n"
    assert without_marks(fill(table)) == f"x\n{TABLES['headline']()}\ny\n"


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


def test_only_one_level_has_empty_cells_in_the_headline_table() -> None:
    lines = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in TABLES["headline"]().splitlines()[2:]
    ]
    assert len(lines) == len(METHODS) + len(ONE_LEVEL)
    assert all(len(line) == 5 and all(line) for line in lines)
    assert not any("-" in line for line in lines[: len(METHODS)])
    assert all(line[1:3] == ["-", "-"] for line in lines[len(METHODS) :])
    _, narrow, _, _, wide = lines[len(METHODS) - 1]  # SAMARL: 90° and 360°, three robots
    assert wide == figure(["table1", "samarl", "360/10/3", "both"])
    assert narrow == figure(["table1", "samarl", "90/10/3", "both"])


def test_make_bench_plays_the_rows_of_the_readme() -> None:
    table = yaml.safe_load((ROOT / "conf/table/table1.yaml").read_text())
    assert set(table["headline"]) == {*METHODS, *ONE_LEVEL}
