"""Parsing of command lines, of paths above all."""

from __future__ import annotations

import itertools
import json
import shlex
import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st

import samarl
from mrsan.recording import SAMPLE
from mrsan.suggestions import choice_hint, closest_names
from samarl import main
from samarl.commands import bench, evaluate
from samarl.commands.overrides import CommandLine
from samarl.evaluation.table import row_settings

ODD = [
    "my data (1)",
    "Zürich",
    "a=b",
    "it's",
    "x,y",
    "~/x",
    "choice(a,b)",
    "ends in \\",
    '"',
    "a 'b' c",
    "100 % #1 & co; <x> | y!",
    "a:b@c",
    "[a",
]


def value_of(word: str) -> Any:
    """What Hydra reads."""
    return OverridesParser.create().parse_override(word).value()


def test_a_path_is_everything_after_the_equals_sign() -> None:
    for field, text in itertools.product(("scenario.recording", "hydra.run.dir"), ODD):
        (word,) = CommandLine.parse([f"{field}={text}"]).words()
        assert value_of(word) == text
        quoted = f"{field}={text}" if "," not in text else f'{field}="{text}"'
        (cell,) = CommandLine.parse(["-m", quoted]).cells(None)  # type: ignore[arg-type]
        assert value_of(cell[0]) == text.strip()


@given(st.text(min_size=1).filter(lambda text: text == text.strip() and text.isprintable()))
def test_any_text_is_a_value(text: str) -> None:
    (word,) = CommandLine.parse([f"output={text}"]).words()
    value = value_of(word)
    assert not isinstance(value, str) or value in (text, text[1:-1]) or "\\" in text


def test_a_sweep_accepts_paths_separated_by_commas() -> None:
    words = ["checkpoint=a (1).x, it's,'b,c'", "-m", "agent=orca,straight"]
    command = CommandLine.parse(words)
    cells = [[value_of(word) for word in cell[:2]] for cell in command.cells(None)]  # type: ignore[arg-type]
    expected = [
        [path, agent] for path in ("a (1).x", "it's", "b,c") for agent in ("orca", "straight")
    ]
    assert cells == expected
    (word,) = CommandLine.parse(["checkpoint=a,b"]).words()
    assert value_of(word) == "a,b"


def test_the_closest_name_is_suggested_first() -> None:
    for name, names, closest in (
        ("human", ["human_radius_max", "humans", "humans_min"], "humans"),
        ("dt", ["time_limit", "time_step", "team_delay"], "time_step"),
        ("lr", ["layers", "learning_rate"], "learning_rate"),
        ("robotz", ["robots", "robot_radius"], "robots"),
    ):
        assert closest_names(name, names)[0] == closest
        assert closest_names("qqq", names) == []
    many = [f"policy_{index}" for index in range(40)]
    assert choice_hint("policy_", many).count("policy") == 3


def test_recordings_in_folders_with_special_characters_are_played(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    recording = Path("it's (1)/Zürich, a=b/people.TXT")
    recording.parent.mkdir(parents=True)
    shutil.copy(SAMPLE, recording)
    words = ["agent=straight", "evaluation.cases=1", "scenario=recorded", "scenario.time_limit=1"]
    words += [f"scenario.recording={recording}", "hydra.run.dir=rows (1), here"]
    monkeypatch.setattr(sys, "argv", ["samarl-evaluate", *words])
    evaluate.main()
    saved = json.loads(Path("rows (1), here/row.json").read_text(encoding="utf-8"))
    assert saved["config"]["scenario"]["recording"] == str(recording)
    # The row's command is all it takes to play it again, and is shown as it was written.
    program, *words = shlex.split(saved["row"]["command"])
    monkeypatch.setattr(sys, "argv", [program, *words, "hydra.run.dir=again"])
    evaluate.main()
    again = json.loads(Path("again/row.json").read_text(encoding="utf-8"))
    assert again["config"] == saved["config"]
    assert row_settings(again["row"])[-1].startswith("scenario.recording=")


def test_the_command_samarl_lists_and_runs_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    scripts = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"][
        "scripts"
    ]
    assert set(scripts) == {"samarl", *(f"samarl-{name}" for name in main.COMMANDS)}
    monkeypatch.setattr(sys, "argv", ["samarl"])
    main.main()
    overview = capsys.readouterr().out
    assert all(f"  samarl {name} " in overview for name in main.COMMANDS)
    monkeypatch.setattr(sys, "argv", ["samarl", "--version"])
    main.main()
    assert capsys.readouterr().out == f"samarl {samarl.__version__}\n"
    monkeypatch.setattr(sys, "argv", ["samarl", "evalute", "agent=orca"])
    with pytest.raises(SystemExit) as stopped:
        main.main()
    assert stopped.value.code == 2
    assert "'evalute' is not a command; did you mean evaluate?" in capsys.readouterr().err
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    words = ["agent=straight", "evaluation.cases=2", "hydra.run.dir=here"]
    for argv, run in ((["samarl", "evaluate"], main.main), (["samarl-evaluate"], main.evaluate)):
        monkeypatch.setattr(sys, "argv", [*argv, *words])
        run()
        row = json.loads(Path("here/row.json").read_text(encoding="utf-8"))["row"]
        assert row["command"] == "samarl-evaluate agent=straight evaluation.cases=2"


def test_files_that_a_running_command_composes_are_named_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "own/agent").mkdir(parents=True)
    for content, message in (
        ("defaults: [nobody]\n", "agent/mine.yaml: agent is 'nobody', which does not exist"),
        ("5\n", "int"),
        ("a: [\n", 'mine.yaml", line 2'),
    ):
        (tmp_path / "own/agent/mine.yaml").write_text(content)
        monkeypatch.setattr(sys, "argv", ["samarl-bench", "--config-dir=own", "agents=[mine]"])
        with pytest.raises(SystemExit) as stopped:
            bench.main()
        error = capsys.readouterr().err
        assert (stopped.value.code, error.count("\n")) == (2, 1)
        assert message in error
