"""Intervals, rows, tables and the comparison with committed results, by hand."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrsan import (
    ConfigurationError,
    Episodes,
    Outcome,
    Scenario,
)
from samarl.commands.bench import merged
from samarl.evaluation.metrics import (
    METRICS,
    Metric,
    Tables,
    metric,
    metric_fields,
    wilson_interval,
)
from samarl.evaluation.page import page
from samarl.evaluation.regression import compare
from samarl.evaluation.seeds import across_seeds, improvements
from samarl.evaluation.summary import (
    REQUIRED_FIELDS,
    Row,
    case_successes,
    column_of,
    first_cases,
    read_rows,
    row_fields,
    summarise,
)
from samarl.evaluation.table import (
    column_name,
    grids_as_markdown,
    rows_as_cells,
    rows_as_markdown,
)
from samarl.files import find_folder


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe, "Two-sided confidence intervals for the single proportion", 1998, Table I.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (5, 10, 0.2366, 0.7634),
        (20, 20, 0.8389, 1.0),
    ],
)
def test_wilson_interval(successes: int, trials: int, low: float, high: float) -> None:
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


def four_episodes() -> Episodes:
    arrived, human, robot = Outcome.arrived, Outcome.hit_human, Outcome.hit_robot
    late, stopped = Outcome.timeout, Outcome.interrupted
    outcome = [[arrived, arrived], [human, stopped], [robot, robot], [arrived, late]]
    return Episodes(
        case=np.arange(4),
        episode=np.zeros(4, int),
        duration=np.array([10.0, 2, 3, 50]),
        outcome=np.array(outcome, np.int8),
        path_length=np.array([[10.0, 20], [1, 1], [2, 2], [12, 30]]),
        straight_line=np.full((4, 2), 10.0),
        shortest_path=np.full((4, 2), 10.0),
        time=np.array([[9.0, 10], [2, 2], [3, 3], [14, 50]]),
        closest_human=np.array([[0.9, 0.225], [-0.1, 2], [1, 1], [0.45, np.inf]]),
        close_share=np.array([[0.0, 0.5], [0.5, 0], [0, 0], [0, 0]]),
        personal_share=np.array([[0.25, 0.5], [0.5, 0], [0, 0], [0.75, 0]]),
        social_share=np.full((4, 2), 0.25),
        standing_share=np.array([[0.0, 0.1], [0.1, 0], [0, 0], [0.2, 0]]),
        jerk=np.full((4, 2), 2.0),
        heading_change=np.array([[1.0, 2], [9, 9], [9, 9], [3, 9]]),
        min_time_to_collision=np.array([[2.0, 3], [0, 4], [6, 5], [12, np.inf]]),
        robot_at_fault=np.array([[False, False], [True, False], [False, False], [False, False]]),
        steps=np.array([40, 8, 12, 200]),
        arrived=np.array([[True, True], [False, False], [False, False], [True, False]]),
        contacts=np.array([[0.0, 0], [1, 0], [0.5, 0.5], [0, 0]]),
        comfort_share=np.array([[0.0, 0.3], [0.5, 0], [0, 0], [0, 0.1]]),
        deadlock=np.array([False, False, False, True]),
        intrusion_share=np.array([[0.0, 0.25], [0, 0], [0, 0], [0, 0]]),
    )


def test_a_row_by_hand() -> None:
    row = summarise(four_episodes(), Scenario(robots=2), "mine", "command", "abc", 7)
    expected: dict[str, Any] = {
        "method": "mine",
        "fov_degrees": 360.0,
        "humans": 10,
        "robots": 2,
        "layout": "circle",
        "goal_turn_degrees": 0.0,
        "team_perception": "none",
        "recording": None,
        "changes": "",
        "scenario": "samarl",
        "terminate_on_collision": True,
        "episodes": 4,
        "success_rate": 25.0,
        "success_low": 4.56,
        "success_high": 69.94,
        "robot_success_rate": 37.5,  # three of eight
        # 100, 100 (1/4 + 1/2 (1/4 + 1/4)) = 50, 100 (5/12 + 1/2) = 91.67 and five zeros;
        # means of 75, 45.83, 0 and 0 per episode, so 30.21 -+ 1.96 * 31.92 / 2, cut off at 0.
        "social_score": 30.21,
        "social_low": 0.0,
        "social_high": 61.49,
        "collision_rate": 50.0,
        "human_collision_rate": 25.0,
        "robot_on_person_rate": 25.0,
        "person_on_robot_rate": 0.0,
        "robot_collision_rate": 25.0,
        "wall_collision_rate": 0.0,
        "deadlock_rate": 25.0,
        "makespan": 10.0,
        "flow_rate": 12.0,  # two robots in 10 s
        "path_ratio": 1.4,  # of 10, 20 and 12 m instead of 10
        "timeout_rate": 25.0,
        "path_length": 14.0,
        "time_to_goal": 11.0,
        "closest_human": 0.9,
        # One of four, two collisions in four; of the one 10 + 20 m in 40 steps; of 93 s driven
        # 0.3 of 10, 0.5 of 2 and 0.1 of 50.
        "csr": 25.0,
        "cr": 50.0,
        "apl": 30.0,
        "ntc": 40.0,
        "cir": 9.68,
        "close_share": 12.5,
        "personal_share": 25.0,
        "social_share": 25.0,
        "min_time_to_collision": 4.0,  # the median of 0, 2, 3, 4, 5, 6 and 10
        "group_intrusion_rate": 25.0,
        "group_intrusion_share": 3.12,
        "jerk": 2.0,
        "standing_share": 5.0,
        "heading_change": 2.0,
        "path_irregularity": 0.15,  # of 1 rad on 10 m, 2 on 20 and 3 on 12
        "command": "command",
        "commit": "abc",
        "seed": 7,
        "case_success": "80",  # 1000 0000
        "case_social_score": "4b00002e",  # 75, 0, 0, 46
    }
    assert row == expected
    assert list(row) == row_fields()


def test_a_row_of_failures_has_no_lengths() -> None:
    episodes = four_episodes()
    nobody = episodes._replace(
        outcome=np.full((4, 2), Outcome.hit_robot, np.int8),
        closest_human=np.full((4, 2), np.inf),
    )
    row = summarise(nobody, Scenario(robots=2, humans=0), "m", "c", "a", 0)
    assert (row["path_length"], row["time_to_goal"], row["closest_human"]) == (None, None, None)
    assert row["success_rate"] == row["social_score"] == 0
    cells = [cell.strip() for cell in rows_as_markdown([row]).splitlines()[-1].split("|")]
    assert cells.count("-") == 2


def row(**fields: Any) -> Row:
    return summarise(four_episodes(), Scenario(robots=2), "mine", "command", "abc", 7) | fields


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({}, "same "),
        ({"commit": "other", "path_length": 3.0}, "same "),  # provenance does not matter
        ({"success_rate": 30.0}, "close "),
        ({"social_score": 31.0}, "close "),
        ({"success_rate": 69.94}, "close "),
        ({"success_rate": 70.0}, "DIFFERS "),
        ({"success_rate": 4.0}, "DIFFERS "),
        ({"success_rate": 0.0}, "close "),  # one of the four episodes has another outcome
        ({"success_rate": 75.0}, "DIFFERS "),  # two
        ({"method": "other"}, "new "),
        ({"fov_degrees": 90.0}, "new "),
        ({"robots": 3}, "new "),
    ],
)
def test_compare_with_the_committed_row(change: dict[str, Any], status: str) -> None:
    others = [row(method="elsewhere", success_rate=99.0), row(humans=3, success_rate=99.0)]
    line = compare(row(**change), [*others, row()])
    assert line.startswith(status)
    assert len(line.splitlines()) == 1


def test_a_table_of_several_kinds_of_columns() -> None:
    rows = [
        row(),
        row(layout="square", success_rate=50.0),
        row(goal_turn_degrees=-30.0, success_rate=60.0),
        row(team_perception="tracks", fov_degrees=90.0, success_rate=70.0),
        row(recording="zara.txt", humans=64, success_rate=80.0),
        row(changes="occlusion=True position_noise=0.1"),
    ]
    headings = [line for line in grids_as_markdown(rows).splitlines() if line.startswith("|")][::3]
    names = [heading.split("|")[2:-1] for heading in headings]
    assert [[name.strip() for name in some] for some in names] == [
        ["360° 10h 2r"],
        ["360° 10h 2r square", "360° 10h 2r -30°"],
        ["90° 10h 2r team"],
        ["360° 2r zara"],
        ["360° 10h 2r occlusion position noise 0.1"],
    ]
    header, lines = rows_as_cells(rows)
    setting = header.index("setting")
    assert [line[setting] for line in lines] == [
        "",
        "square",
        "-30°",
        "team",
        "zara",
        "occlusion position noise 0.1",
    ]
    assert "setting" not in rows_as_cells(rows[:1])[0]
    many = column_of(row(changes="a=1 b=2 c=3 d=4"))
    assert column_name(many) == "360° 10h 2r a 1 b 2 ..."
    assert compare(row(layout="square"), rows).startswith(
        "close    mine 360° 10h 2r square: success 50.0 -> 25.0 %"
    )


def test_tables_are_aligned_and_show_the_results_of_the_papers() -> None:
    rows = [row(method="orca", fov_degrees=90.0, robots=3), row(method="perimeter")]
    for table in (rows_as_markdown(rows), grids_as_markdown(rows)):
        lines = table.splitlines()
        assert len({len(line) for line in lines}) == 1
        assert len({line.count("|") for line in lines}) == 1
    detailed = rows_as_markdown(rows).splitlines()
    assert detailed[2].split("|")[-2].strip() == "25"  # the paper's ORCA, 90°, 10 humans, 3 robots
    assert detailed[3].split("|")[-2].strip() == ""
    first = grids_as_markdown(rows).splitlines()
    cells = {line.split("|")[1].strip(): line.split("|")[2].strip() for line in first}
    assert cells["orca"] == "25.0 / 30.2"
    assert cells["perimeter"] == ""
    assert cells["paper: SAMARL"] == "93 / -"


def test_the_first_cases_of_a_row_by_hand() -> None:
    assert case_successes(row()).tolist() == [True, False, False, False]
    first = first_cases(row(), 2)
    low, high = wilson_interval(1, 2)
    assert first["success_rate"] == 50
    assert (first["success_low"], first["success_high"]) == (100 * low, 100 * high)
    assert first["social_score"] == 75 / 2
    assert first["episodes"] == 2
    assert (first["case_success"], first["case_social_score"]) == ("80", "4b00")


@pytest.mark.parametrize(
    ("change", "status"),
    [
        ({}, "same     mine 360° 10h 2r: success 33.3 -> 33.3 %, social score 25.0 -> 25.0"),
        ({"case_social_score": "4b0100"}, "close "),
        ({"case_success": "c0"}, "close "),
        ({"case_success": "e0"}, "DIFFERS "),
        ({"seed": 8, "success_rate": 33.3}, "other "),
        ({"command": "command occlusion=True evaluation.cases=3", "case_success": "c0"}, "other "),
    ],
)
def test_fewer_cases_are_compared_with_the_first_cases_of_the_committed_row(
    change: dict[str, Any], status: str
) -> None:
    fewer = first_cases(row(), 3) | {"command": "command evaluation.cases=3"} | change
    assert compare(fewer, [row()]).startswith(status)


def test_merging_keeps_the_other_rows() -> None:
    earlier = [row(), row(method="other"), row(robots=3)]
    rows = merged([row(success_rate=80.0), row(method="a", robots=3)], earlier)
    merged_rows = [(r["method"], r["robots"], r["success_rate"]) for r in rows]
    assert merged_rows == [("mine", 2, 80.0), ("other", 2, 25.0), ("mine", 3, 25.0), ("a", 3, 25.0)]


def test_the_page_gives_the_share_of_unsolved_cases() -> None:
    recorded = {"recording": "zara.txt", "humans": 64}
    rows = [row(**recorded), row(method="other", case_success="c0", **recorded)]
    assert "solves: 360° 2r zara 50.0 %." in page("transfer", "Title", rows)
    for change in ({"seed": 8}, {"episodes": 3}):  # other cases
        assert "solves" not in page("transfer", "Title", [rows[0], rows[1] | change])
    older = {name: value for name, value in rows[1].items() if name != "case_success"}
    assert "solves" not in page("transfer", "Title", [rows[0], older])


def test_the_page_compares_training_seeds() -> None:
    def seeds(method: str, *rates: float) -> Row:
        rows = [row(method=method, success_rate=rate) for rate in rates]
        return rows[0] | across_seeds(rows)

    rows = [seeds("samarl", 90.0, 80.0), seeds("ppo", 70.0, 85.0), row(method="one")]
    text = page("table1", "Title", rows, improvements(rows, ["samarl"]))
    assert "| better than   | samarl, 360° 10h 2r |" in text
    lines = [line for line in text.splitlines() if line.startswith("| ppo (2 seeds)")]
    assert [[cell.strip() for cell in line.split("|")][1:-1] for line in lines] == [
        ["ppo (2 seeds)", "0.75 [0.00, 1.00]"],  # success
        ["ppo (2 seeds)", "0.50 [0.50, 0.50]"],  # social score: the same
    ]
    assert "improvement" not in page("table1", "Title", rows)


COMMITTED = find_folder("results") / "table1.json"


def test_every_metric_returns_its_fields() -> None:
    """Rounded numbers; None is allowed if all robots fail and there are no humans."""
    one, episodes = row(), four_episodes()
    failed = episodes._replace(
        outcome=np.full((4, 2), Outcome.timeout, np.int8),
        closest_human=np.full((4, 2), np.inf),
    )
    cells = {table: rows_as_cells([one], table=table) for table in Tables}
    for m in METRICS.values():
        fields = m.row_fields(episodes)
        assert tuple(fields) == m.fields
        for value in fields.values():
            assert isinstance(value, float)
            assert value == round(value, m.decimals)
        assert all(v is None or np.isfinite(v) for v in m.row_fields(failed).values())
        assert m.cell(one)[0].isdigit()
        assert m.cell({**one, **dict.fromkeys(m.fields)}) == "-"
        assert m.cell({}) == ""
        for table, (header, lines) in cells.items():
            assert (m.heading in header) == (bool(m.heading) and table in m.tables)
            if m.heading in header:
                assert lines[0][header.index(m.heading)] == m.cell(one)


@pytest.fixture
def longest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Register another metric during a test."""
    monkeypatch.setitem(
        METRICS,
        "longest",
        Metric(("longest",), "longest s", "{:.1f}", 2, lambda episodes: episodes.duration.max()),
    )


@pytest.mark.usefixtures("longest")
def test_a_new_metric_is_in_the_row_and_in_the_table() -> None:
    assert row()["longest"] == 50.0
    old = {name: value for name, value in row().items() if name != "longest"}
    header, lines = rows_as_cells([row(), old])
    assert [line[header.index("longest s")] for line in lines] == ["50.0", ""]
    assert compare(row(), [old]).startswith("same ")


def test_invalid_metrics_are_refused() -> None:
    with pytest.raises(ValueError, match="metric field 'success_low' is already registered"):
        metric("mine", "success_low", heading="mine")(lambda episodes: (0.0, 0.0))
    assert "mine" not in metric_fields()
    wrong = Metric(("a", "b"), "", "", 2, lambda episodes: 1.0)
    with pytest.raises(ValueError, match=r"metric a returns 1 values; .* 2: a, b"):
        wrong.row_fields(four_episodes())


def test_a_row_without_a_required_field_is_refused(tmp_path: Path) -> None:
    rows, path = json.loads(COMMITTED.read_text())[:4], tmp_path / "table.json"
    for name in REQUIRED_FIELDS:
        path.write_text(json.dumps([*rows[:3], {k: v for k, v in rows[3].items() if k != name}]))
        with pytest.raises(ConfigurationError, match=f"has no {name} in row 3; every") as caught:
            read_rows(path)
        assert len(str(caught.value).splitlines()) == 1
