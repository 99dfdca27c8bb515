"""Files for the leaderboard: what agrees is accepted, what was edited is refused."""

import copy
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrsan import TASKS, ConfigurationError, Split
from samarl.commands import verify
from samarl.configuration import load_agent_config
from samarl.report.leaderboard import ranked, task_of
from samarl.report.marl_eval import marl_eval_json
from samarl.submission import (
    _checksum,
    _decoded,
    _row,
    check_submission,
    create_submission,
    replay,
    submission_rows,
)

SCENARIO = TASKS["samarl-360-3"].scenario
CASES = Split.test.case(0) + np.arange(5)
PATH = Path("mine.json")


@pytest.fixture(scope="module")
def submission() -> dict[str, Any]:
    settings = load_agent_config("perimeter")
    content = create_submission(
        "table1", "perimeter", settings, [SCENARIO], CASES, "samarl-submit", privileged=False
    )
    return json.loads(json.dumps(content))


def verified(content: dict[str, Any]) -> str:
    ((scenario, episodes),) = check_submission(content, PATH, [SCENARIO])
    return replay(content, PATH, 0, scenario, episodes, np.arange(len(CASES)))


def edit(*path: Any, to: Any) -> Callable[[dict[str, Any]], None]:
    """Return an edit of the value at a path; a function of the old value gives the new one."""

    def apply(content: dict[str, Any]) -> None:
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = to(content[path[-1]]) if callable(to) else to

    return apply


def with_rows(change: Callable[[dict[str, Any]], None]) -> Callable[[dict[str, Any]], None]:
    """Return an edit of records that computes the row again, as a careful cheat would."""

    def apply(content: dict[str, Any]) -> None:
        change(content)
        entry = content["columns"][0]
        episodes = _decoded(entry["records"], SCENARIO)
        row = entry["row"]
        entry["row"] = _row(episodes, SCENARIO, content["method"], row["command"], row["commit"])

    return apply


def drop_a_case(content: dict[str, Any]) -> None:
    records = content["columns"][0]["records"]
    for name in records:
        records[name] = records[name][:-1]


ROW, RECORDS = ("columns", 0, "row"), ("columns", 0, "records")
EDITS = {
    "success": edit(*ROW, "success_rate", to=99.0),
    "interval": edit(*ROW, "success_low", to=50.0),
    "social score": edit(*ROW, "social_score", to=80.0),
    "collisions": edit(*ROW, "collision_rate", to=0.0),
    "path": edit(*ROW, "path_length", to=10.0),
    "jerk": edit(*ROW, "jerk", to=0.1),
    "number of episodes": edit(*ROW, "episodes", to=500),
    "first case": edit(*ROW, "seed", to=0),
    "people": edit(*ROW, "humans", to=11),
    "robots": edit(*ROW, "robots", to=5),
    "view": edit(*ROW, "fov_degrees", to=90.0),
    "successes of cases": edit(*ROW, "case_success", to="f8"),
    "scores of cases": edit(*ROW, "case_social_score", to="6464646464"),
    "seeds": edit(*ROW, "training_seeds", to=5),
    "outcome": with_rows(edit(*RECORDS, "outcome", to=lambda old: [[0] * 3 for _ in old])),
    "one duration": with_rows(edit(*RECORDS, "duration", 0, to=lambda old: old + 0.25)),
    "one time": with_rows(edit(*RECORDS, "time", 2, 0, to=lambda old: old - 0.25)),
    "one distance": with_rows(edit(*RECORDS, "closest_human", 0, 0, to=lambda old: old + 0.01)),
    "contacts": with_rows(edit(*RECORDS, "contacts", to=lambda old: [[0.0] * 3 for _ in old])),
    "other cases": with_rows(edit(*RECORDS, "case", to=lambda old: [c + 100 for c in old])),
    "a case less": drop_a_case,
    "a gap": with_rows(edit(*RECORDS, "case", 4, to=lambda old: old + 1)),
    "actions": edit("columns", 0, "actions", to="0" * 64),
    "agent": edit("agent", "radius", to=7.0),
    "method": edit("method", to="samarl"),
    "no columns": edit("columns", to=[]),
}


def test_an_untouched_file_is_accepted(submission: dict[str, Any]) -> None:
    assert verified(submission) == "360° 10h 3r: 5 of 5 replayed cases are the same, same actions"


def test_edited_files_are_refused(submission: dict[str, Any]) -> None:
    assert len(EDITS) >= 20
    for name, change in EDITS.items():
        edited = copy.deepcopy(submission)
        change(edited)
        assert edited != submission, name
        with pytest.raises(ConfigurationError, match="its checksum is not that of"):
            verified(edited)
        edited["checksum"] = _checksum(edited)
        try:
            verified(edited)
        except ConfigurationError as error:
            assert str(error).startswith("mine.json "), name  # noqa: PT017
        else:
            raise AssertionError(f"{name} was not noticed")


def test_the_command_verifies_a_file(
    submission: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "mine.json"
    path.write_text(json.dumps(submission))
    monkeypatch.setattr(sys, "argv", ["samarl-verify", str(path), "--all"])
    verify.main()
    out = capsys.readouterr().out
    assert "1 of 4 columns of table table1" in out
    assert "5 of 500 cases" in out
    assert "5 of 5 replayed cases are the same" in out
    submission = submission | {"agent": {"_target_": "os.system"}}
    path.write_text(json.dumps(submission | {"checksum": _checksum(submission)}))
    with pytest.raises(SystemExit):
        verify.main()
    assert "os.system" in capsys.readouterr().err


def test_a_submission_is_on_the_leaderboard(submission: dict[str, Any]) -> None:
    rows = submission_rows(submission | {"description": "Mine.", "privileged": True})
    (line,) = ranked(rows, task_of)
    assert (line.name, line.group, line.description) == ("perimeter", "planner", "Mine.")
    assert line.is_privileged
    assert not line.communicates
    tasks = json.loads(marl_eval_json(rows))["mrsan"]
    seeds = tasks["samarl-360-3"]["perimeter"]
    assert seeds["seed_0"]["absolute_metrics"]["success_rate"] == [rows[0]["success_rate"]]
