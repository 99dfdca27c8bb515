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
    first_cases,
    read_rows,
    row_fields,
    summarise,
)
from samarl.evaluation.table import (
    rows_as_cells,
    rows_as_markdown,
)
from samarl.files import find_folder


def test_wilson_interval() -> None:
    """Newcombe, "Two-sided confidence intervals for the single proportion", 1998, Table I."""
    for successes, trials, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (20, 20, 0.8389, 1.0),
    ):
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


def test_compare_with_the_committed_row() -> None:
    others = [row(method="elsewhere", success_rate=99.0), row(humans=3, success_rate=99.0)]
    for change, status in (
        ({}, "same "),
        ({"commit": "other", "path_length": 3.0}, "same "),  # provenance does not matter
        ({"success_rate": 69.94}, "close "),
        ({"social_score": 31.0}, "close "),
        ({"success_rate": 70.0}, "DIFFERS "),
        ({"success_rate": 0.0}, "close "),  # one of the four episodes has another outcome
        ({"success_rate": 75.0}, "DIFFERS "),  # two
        ({"method": "other"}, "new "),
        ({"robots": 3}, "new "),
        ({"command": "command evaluation.split=other", "success_rate": 80.0}, "other "),
    ):
        line = compare(row(**change), [*others, row()])
        assert line.startswith(status), change
        assert len(line.splitlines()) == 1


def test_the_first_cases_of_a_row_by_hand() -> None:
    assert case_successes(row()).tolist() == [True, False, False, False]
    first = first_cases(row(), 2)
    low, high = wilson_interval(1, 2)
    assert first["success_rate"] == 50
    assert (first["success_low"], first["success_high"]) == (100 * low, 100 * high)
    assert first["social_score"] == 75 / 2
    assert first["episodes"] == 2
    assert (first["case_success"], first["case_social_score"]) == ("80", "4b00")


def test_fewer_cases_are_compared_with_the_first_cases_of_the_committed_row() -> None:
    other = "command occlusion=True evaluation.cases=3"
    for change, status in (
        ({}, "same     mine 360° 10h 2r: success 33.3 -> 33.3 %, social score 25.0 -> 25.0"),
        ({"case_social_score": "4b0100"}, "close "),
        ({"case_success": "c0"}, "close "),
        ({"case_success": "e0"}, "DIFFERS "),
        ({"seed": 8, "success_rate": 33.3}, "other "),
        ({"command": other, "case_success": "c0"}, "other "),
    ):
        fewer = first_cases(row(), 3) | {"command": "command evaluation.cases=3"} | change
        assert compare(fewer, [row()]).startswith(status), change


def test_merging_keeps_the_other_rows() -> None:
    earlier = [row(), row(method="other"), row(robots=3)]
    rows = merged([row(success_rate=80.0), row(method="a", robots=3)], earlier)
    merged_rows = [(r["method"], r["robots"], r["success_rate"]) for r in rows]
    assert merged_rows == [("mine", 2, 80.0), ("other", 2, 25.0), ("mine", 3, 25.0), ("a", 3, 25.0)]


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
