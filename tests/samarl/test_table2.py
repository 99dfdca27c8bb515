"""MSA3C's scenarios and its Table 2 with the results of the paper."""

import re
import sys
from pathlib import Path

import pytest
import yaml

from mrsan import TASKS
from samarl.commands.bench import main
from samarl.configuration import load_scenario, scenario_of
from samarl.evaluation.papers import PAPER_CO_PLANNING
from samarl.evaluation.summary import Row, read_rows, scenario_column
from samarl.evaluation.table import column_name, rows_as_cells
from samarl.files import find_folder

CONF = find_folder("conf")
SCENES = {"5p3r": (5, 6.0), "10p3r": (10, 8.0), "20p3r": (20, 10.0)}


def table2() -> list[dict]:
    columns = yaml.safe_load((CONF / "table/table2.yaml").read_text())["columns"]
    assert isinstance(columns, list)
    return columns


def test_a_column_that_is_a_task_says_so() -> None:
    """The numbers of a task stand in `mrsan.TASKS` only."""
    tasks = [task.scenario for task in TASKS.values()]
    for path in (CONF / "table").glob("*.yaml"):
        for column in yaml.safe_load(path.read_text())["columns"]:
            assert scenario_of(column) not in tasks or set(column) == {"scenario"}, (path, column)


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
