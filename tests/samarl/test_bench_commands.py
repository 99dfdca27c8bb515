"""Rows of a table: their commands and their sensitivity to regressions."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from mrsan import Crowd, Reward, Scenario, Split
from samarl.commands.bench import _command, _row, _Task, main
from samarl.configuration import load_agent_config
from samarl.evaluation.regression import beside_committed, compare
from samarl.evaluation.runner import Evaluation
from samarl.evaluation.seeds import improvements, other_seeds
from samarl.evaluation.summary import Row, case_successes, column_of, first_cases, read_rows
from samarl.evaluation.table import grids_as_markdown
from samarl.files import find_folder, write_json
from samarl.policies.card import find_policy
from samarl.policies.checkpoint import load_policy, save_policy
from samarl.report.improvement import draw_improvements


def test_the_command_names_all_changed_fields() -> None:
    column = Scenario(fov_degrees=90.0, humans=4, robots=2)
    plain = "samarl-evaluate agent=orca scenario=samarl"
    plain += " scenario.fov_degrees=90 scenario.humans=4 scenario.robots=2"
    assert _command("orca", column, Scenario(), Evaluation()) == plain
    assert (
        _command("orca", column, Scenario(), Evaluation(batch=7)) == plain
    )  # does not change the result
    scenario = replace(column, crowd=Crowd.still, occlusion=True, reward=Reward(arrival=3.0))
    evaluation = Evaluation(split=Split.validation, first_case=7, cases=9)
    assert _command("orca", scenario, Scenario(), evaluation) == plain + (
        " scenario.occlusion=True scenario.crowd=still scenario.reward.arrival=3.0"
        " evaluation.split=validation evaluation.first_case=7 evaluation.cases=9"
    )


def row_of(
    method: str, variants: list[dict[str, Any]], scenario: Scenario, evaluation: Evaluation
) -> Row:
    return _row(_Task(method, method, variants, scenario, evaluation), scenario, "", [])


def played(monkeypatch: pytest.MonkeyPatch, *words: str) -> None:
    monkeypatch.setattr(sys, "argv", ["samarl-bench", "output=mine", "jobs=1", *words])
    main()


def test_rows_with_fewer_cases_are_not_merged(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    columns = "columns=[{robots: 1, humans: 0}]"
    played(
        monkeypatch,
        "agents=[straight,samarl_circle]",
        "learned_cases=2",
        columns,
        "evaluation.cases=3",
    )
    path = tmp_path / "mine" / "table1.json"
    rows = read_rows(path)
    assert rows is not None
    assert [(r["method"], r["episodes"]) for r in rows] == [("straight", 3), ("samarl_circle", 2)]
    played(monkeypatch, "agents=[orca]", "merge=true", columns, "evaluation.cases=3")
    rows = read_rows(path)
    assert rows is not None
    assert [row["method"] for row in rows] == ["straight", "samarl_circle", "orca"]
    assert "| ORCA " in path.with_suffix(".md").read_text()
    before = path.read_bytes()
    with pytest.raises(SystemExit):
        played(monkeypatch, "agents=[straight]", "merge=true", columns, "evaluation.cases=2")
    error = capsys.readouterr().err
    assert "the row of straight must have at least the 3 cases" in error
    assert path.read_bytes() == before


def test_training_seeds_of_a_macro_level_are_aggregated(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    agent = "right_of_way macro_level=right_of_way_macro"
    column = "columns=[{scenario: doorway, robots: 2, humans: 0, team_messages: true}]"
    played(
        monkeypatch, f"agents=['{agent}',right_of_way]", "seeds=true", column, "evaluation.cases=4"
    )
    rows = read_rows(tmp_path / "mine" / "table1.json")
    assert rows is not None
    learned, rule = rows
    others = other_seeds("right_of_way_macro")
    assert others
    assert learned["training_seeds"] == len(learned["success_of_seeds"]) == 1 + len(others)
    assert learned["success_of_seeds"][0] == learned["success_rate"]
    assert "training_seeds" not in rule


def test_a_page_is_written_again_with_its_figure(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine/table1.json"
    rows = [
        row for row in committed() if row["method"] in ("orca", "samarl_waypoints", "samarl_circle")
    ]
    write_json(path, rows)
    before = path.read_bytes()
    monkeypatch.setattr("samarl.commands.bench._run", lambda *_: pytest.fail("played"))
    played(monkeypatch, "agents=[]", "merge=true")
    assert path.read_bytes() == before
    page = path.with_suffix(".md").read_text()
    assert "](table1_improvement.png)" in page
    assert "| One level, circle, shielded (3 seeds) |" in page
    with Image.open(tmp_path / "mine/table1_improvement.png") as image:
        assert 900 < image.width < 1100  # pixels, which fit in a page
    (success, _) = draw_improvements(improvements(rows, ["samarl_waypoints"])).axes[:2]
    assert success.get_title(loc="left") == "Success"
    assert [label.get_text() for label in success.get_yticklabels()] == ["samarl_circle (3 seeds)"]
    # Only two columns have been played by both.
    values = [text.get_text() for text in success.texts if text.get_text() != "samarl_waypoints"]
    assert values == re.findall(r"([\d.]+) \[", page.split("Success:")[1].split("Social")[0])
    assert len(values) == 2
    with pytest.raises(SystemExit):
        played(monkeypatch, "agents=[]")
    assert "agents is empty; it must name at least one" in capsys.readouterr().err


def committed() -> list[Row]:
    rows = read_rows(find_folder("results") / "table1.json")
    assert rows is not None
    return rows


def test_a_custom_method_stands_beside_the_committed_rows() -> None:
    """Also where it is evaluated in two of four columns only, here on the first 40 cases."""
    rows = committed()
    columns = list(dict.fromkeys(map(column_of, rows)))
    wide = [row for row in rows if row["method"] == "samarl_circle"]
    custom_rows = [first_cases(row, 40) | {"method": "mine"} for row in wide]
    shown = beside_committed(custom_rows, [*rows, *custom_rows], columns)
    assert len(shown) == len(rows) + len(custom_rows)
    assert {row["episodes"] for row in shown if row["fov_degrees"] == 360.0} == {40}
    orca = next(row for row in rows if row["method"] == "orca" and column_of(row) == columns[2])
    same = next(row for row in shown if row["method"] == "orca" and column_of(row) == columns[2])
    assert same["success_rate"] == 100 * case_successes(orca)[:40].mean()
    header, _, first, *others = grids_as_markdown(shown, columns).splitlines()
    names = [cell.strip() for cell in header.split("|")[2:6]]
    assert names == ["90° 10h 3r", "90° 10h 5r", "360° 10h 5r", "360° 10h 3r"]
    cells = [cell.strip() for cell in first.split("|")[1:6]]
    assert cells[:3] == ["mine (this run)", "", ""]
    assert all(" / " in cell for cell in cells[3:])
    assert sum("this run" in line for line in others) == 0
    assert any(line.startswith("| samarl ") for line in others)
    assert any(line.startswith("| paper: SAMARL ") for line in others)
    # No committed rows of these columns: nothing to stand beside.
    assert beside_committed(custom_rows, rows, []) == custom_rows


def test_a_policy_with_damaged_weights_differs(tmp_path: Path) -> None:
    """On the number of cases that continuous integration uses for policies."""
    policy, card = load_policy(find_policy("samarl_circle"))
    with torch.no_grad():
        for parameter in policy.networks[0].encoder.humans.parameters():
            parameter.zero_()  # it ignores people
    save_policy(tmp_path / "damaged.safetensors", policy, card.policy, {})
    agent, cases = load_agent_config("samarl_circle"), Evaluation(cases=25)
    whole = compare(row_of("samarl_circle", [agent], Scenario(), cases), committed())
    assert whole.startswith(("same ", "close "))
    agent["checkpoint"] = str(tmp_path / "damaged.safetensors")
    damaged = compare(row_of("samarl_circle", [agent], Scenario(), cases), committed())
    assert damaged.startswith("DIFFERS ")


def test_a_planner_that_is_five_points_worse_differs() -> None:
    agent = load_agent_config("perimeter")
    good = row_of("perimeter", [agent], Scenario(), Evaluation())
    assert compare(good, committed()).startswith(("same ", "close "))
    worse = row_of("perimeter", [{**agent, "radius": 7.0}], Scenario(), Evaluation())
    assert 4.0 < good["success_rate"] - worse["success_rate"] < 6.0
    assert compare(worse, committed()).startswith("DIFFERS ")


def test_methods_have_settings_and_labels(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    entries = "[straight, straight shield=true, {agent: straight, shield: true, label: safe}]"
    with pytest.raises(SystemExit):
        played(monkeypatch, f"agents={entries}", "evaluation.cases=1")  # one is there twice
    entries = "[straight, {agent: straight, shield: true, label: safe}]"
    columns = "columns=[{humans: 0, robots: 1}]"
    played(monkeypatch, f"agents={entries}", columns, "evaluation.cases=1", "merge=false")
    rows = read_rows(tmp_path / "mine/table1.json") or []
    assert [row["method"] for row in rows] == ["straight", "safe"]
    assert "agent=straight agent.shield=true scenario=samarl" in rows[1]["command"]
