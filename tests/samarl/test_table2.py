"""MSA3C's scenarios and its Table 2 with the results of the paper."""

import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from mrsan import Kinematics, Scenario
from samarl.commands.bench import _command, main
from samarl.configuration import load_scenario, scenario_of
from samarl.evaluation.papers import PAPER_CO_PLANNING
from samarl.evaluation.runner import Evaluation
from samarl.evaluation.summary import Row, read_rows, scenario_column
from samarl.evaluation.table import column_name, rows_as_cells
from samarl.files import find_folder

CONF = find_folder("conf")
SCENES = {"5p3r": (5, 6.0), "10p3r": (10, 8.0), "20p3r": (20, 10.0)}


def table2() -> list[dict]:
    columns = yaml.safe_load((CONF / "table/table2.yaml").read_text())["columns"]
    assert isinstance(columns, list)
    return columns


@pytest.mark.parametrize("name", SCENES)
def test_the_scenarios_are_those_of_msa3c(name: str) -> None:
    s = load_scenario(name)
    assert (s.humans, s.circle_radius) == SCENES[name]
    assert (s.robots, s.time_step, s.time_limit_steps, s.terminate_on_collision) == (
        3,
        0.25,
        150,
        False,
    )
    assert (s.kinematics, s.robot_speed, s.sensing_range, s.fov_degrees) == (
        Kinematics.holonomic,
        1.0,
        10.0,
        360.0,
    )
    # Its radii of 0.6 and 0.5 to 1.3 m are taken for diameters.
    assert (2 * s.robot_radius, 2 * s.human_radius_min, 2 * s.human_radius_max) == (0.6, 0.5, 1.3)
    assert (s.human_speed_min, s.human_speed_max) == (0.5, 1.5)
    assert (s.goal_change_probability, s.goal_change_probability_max) == (0.2, 0.3)
    assert (s.crowd, s.crowd_reaction.name, s.radius_noise > 0) == ("social_force", "blind", True)
    r = s.reward
    assert (r.collision, r.time, r.goal_distance, r.arrival, r.team, r.progress) == (
        -1.0,
        -0.001,
        1.0,
        0.0,
        0.0,
        0.0,
    )
    assert (r.discomfort_limit, r.discomfort_distance) == (-0.5, 0.25)
    assert -r.discomfort / r.discomfort_distance <= r.discomfort_limit  # the same everywhere


def test_msa3c_is_trained_in_10p3r() -> None:
    """In its second stage a collision costs more, and what lies ahead is paid (MSA3C, 4.1.1)."""
    stages = yaml.safe_load((CONF / "curriculum/10p3r.yaml").read_text())["stages"]
    first, second = (replace(scenario_of(s["scenario"]), name="10p3r") for s in stages)
    assert first == load_scenario("10p3r")
    changed = {"collision": -5.0, "lookahead": 1.0, "lookahead_predictor": "recurrent"}
    assert second == replace(first, reward=replace(first.reward, **changed))


def test_samarl_is_trained_in_10p3r_too() -> None:
    """As its recipe has it: fewer people now and then, its own reward, collisions end episodes."""
    stages = yaml.safe_load((CONF / "curriculum/10p3r_samarl.yaml").read_text())["stages"]
    own = {"terminate_on_collision": True, "reward": Scenario().reward}
    for stage, least in zip(stages, (0, 5), strict=True):
        played = replace(scenario_of(stage["scenario"]), name="10p3r")
        assert played == replace(load_scenario("10p3r"), humans_min=least, **own)


def test_scenario_files_have_their_own_name() -> None:
    for path in (CONF / "scenario").glob("*.yaml"):
        assert load_scenario(path.stem).name in (path.stem, Scenario.name)


def test_every_column_has_results_of_the_paper() -> None:
    places = [
        scenario_column(scenario_of(column), load_scenario(column["scenario"]))
        for column in table2()
    ]
    assert {(place.scenario, place.changes) for place in places} == set(PAPER_CO_PLANNING)
    assert [column_name(place) for place in places] == [
        *SCENES,
        *(f"{name} sensing range 5.0" for name in SCENES),
    ]
    assert len({place.kind for place in places}) == 1


def test_the_command_of_a_named_scenario_has_only_its_changes() -> None:
    named = load_scenario("10p3r")
    stage_two = replace(named, humans=7, reward=replace(named.reward, collision=-5.0))
    words = shlex.split(_command("orca", stage_two, named, Evaluation()))
    assert words == [
        "samarl-evaluate",
        "agent=orca",
        "scenario=10p3r",
        "scenario.fov_degrees=360",
        "scenario.humans=7",
        "scenario.robots=3",
        "scenario.reward.collision=-5.0",
    ]
    assert scenario_column(stage_two, named).changes == "humans=7"


@pytest.mark.parametrize(
    ("column", "message"),
    [
        (
            "{scenario: 7p3r}",
            "columns: scenario is '7p3r', which does not exist; did you mean 5p3r, 20p3r or 10p3r?",
        ),
        ("{scenario: 5p3r, humens: 3}", "humens is not known; did you mean humans?"),
    ],
)
def test_invalid_columns_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], column: str, message: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["samarl-bench", "agents=[straight]", f"columns=[{column}]"])
    with pytest.raises(SystemExit):
        main()
    assert message in capsys.readouterr().err


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[Row]]:
    folder = tmp_path_factory.mktemp("table2")
    with pytest.MonkeyPatch.context() as patch:
        words = [
            "agents=[straight,orca]",
            "evaluation.cases=4",
            "jobs=1",
            f"output={folder}",
            "columns=[{scenario: 5p3r},{scenario: 20p3r, sensing_range: 5.0}]",
        ]
        patch.setattr(sys, "argv", ["samarl-bench", "table=table2", *words])
        main()
    rows = read_rows(Path(folder) / "table2.json")
    assert rows is not None
    return (Path(folder) / "table2.md").read_text(), rows


def test_the_results_of_the_paper_are_below_ours(played: tuple[str, list[Row]]) -> None:
    text, rows = played
    grid = text.split("## All rows")[0]
    lines = [re.split(r" *\| *", line)[1:-1] for line in grid.splitlines() if line[:1] == "|"]
    header, _, *cells = lines
    assert header == [
        "scenario",
        "method",
        "success % [95 %]",
        "CSR %",
        "CR %",
        "APL m",
        "NTC",
        "CIR %",
    ]
    far = "20p3r sensing range 5.0"
    assert [line[:2] for line in cells] == [
        ["5p3r", "Straight"],
        ["5p3r", "ORCA"],
        *(["5p3r", f"paper: {name}"] for name in PAPER_CO_PLANNING["5p3r", ""]),
        [far, "Straight"],
        [far, "ORCA"],
        [far, "paper: MSA3CPred"],
    ]
    assert cells[-1][2:] == ["", "89.5", "16.6", "43.6", "84.3", "3.8"]
    assert cells[0][3] == f"{rows[0]['csr']:.1f}" == "100.0"  # nothing stops who drives straight
    assert rows[0]["cr"] > 100  # more than one collision in an episode
    assert rows[0]["success_rate"] < rows[0]["csr"]
    assert [row["scenario"] for row in rows] == ["5p3r", "5p3r", "20p3r", "20p3r"]


def test_rows_have_these_metrics_only_if_collisions_do_not_end_the_episode(
    played: tuple[str, list[Row]],
) -> None:
    _, rows = played
    counted = {"CSR %", "CR %", "APL m", "NTC", "CIR %"}
    assert counted <= set(rows_as_cells(rows)[0])
    usual = [{**row, "terminate_on_collision": True} for row in rows]
    assert not counted & set(rows_as_cells(usual)[0])
