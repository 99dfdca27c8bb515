"""Parsing of command lines, of paths above all."""

from __future__ import annotations

import dataclasses
import json
import shlex
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hypothesis import given
from hypothesis import strategies as st

from mrsan import ConfigurationError, Reward, Scenario
from mrsan.recording import SAMPLE
from samarl.agents.learned import Learned
from samarl.agents.planners.model_predictive import ModelPredictive
from samarl.commands import evaluate
from samarl.commands.bench import Bench
from samarl.commands.export import Export
from samarl.commands.overrides import PATH_FIELDS, CommandLine
from samarl.commands.predictor import Predictor
from samarl.commands.record import Record
from samarl.commands.recordings import recordings_in
from samarl.commands.render import Render
from samarl.commands.report import Report
from samarl.commands.train import Train
from samarl.configuration import Config
from samarl.evaluation.table import row_settings
from samarl.messages import choice_hint, closest_names
from samarl.planning.shield import Shield
from samarl.training.config import TrainerConfig

ODD = [
    "my data (1)",
    "Zürich",
    "a=b",
    "it's",
    "x,y",
    "[a]",
    "{a: 1}",
    "1e3",
    "true",
    "~/x",
    "a\\,b",
    "choice(a,b)",
    "ends in \\",
    '"',
    "a 'b' c",
    "100 % #1 & co; <x> | y!",
    "a:b@c",
    " a",
]


def value_of(word: str) -> Any:
    """What Hydra reads."""
    return OverridesParser.create().parse_override(word).value()


@pytest.mark.parametrize("field", ["scenario.recording", "agent.checkpoint", "+hydra.run.dir"])
@pytest.mark.parametrize("text", ODD)
def test_a_path_is_everything_after_the_equals_sign(field: str, text: str) -> None:
    (word,) = CommandLine.parse([f"{field}={text}"]).quoted().words()
    assert value_of(word) == text
    sweep = CommandLine.parse(["-m", f"{field}={text}" if "," not in text else f'{field}="{text}"'])
    (cell,) = sweep.quoted().cells(None)  # type: ignore[arg-type]
    assert value_of(cell[0]) == text.strip()


@given(st.text(min_size=1).filter(lambda text: text[0] not in "'\"" and "${" not in text))
def test_any_text_is_a_path(text: str) -> None:
    (word,) = CommandLine.parse([f"output={text}"]).quoted().words()
    assert value_of(word) == (None if text.lower() == "null" else text)


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("output='a (1), b'", "a (1), b"),
        ('output="a (1), b"', "a (1), b"),
        ("checkpoint=null", None),
        ("checkpoint='null'", "null"),
        ("output=plain/x.png", "plain/x.png"),
        ("hydra.run.dir=${now:%Y} (1)", "${now:%Y} (1)"),
    ],
)
def test_quotes_null_and_interpolations_keep_their_meaning(word: str, value: Any) -> None:
    (quoted,) = CommandLine.parse([word]).quoted().words()
    assert value_of(quoted) == value


def test_a_sweep_accepts_paths_separated_by_commas() -> None:
    words = ["checkpoint=a (1).x, it's,'b,c'", "-m", "agent=orca,straight"]
    command = CommandLine.parse(words).quoted()
    cells = [[value_of(word) for word in cell] for cell in command.cells(None)]  # type: ignore[arg-type]
    expected = [
        [path, agent] for path in ("a (1).x", "it's", "b,c") for agent in ("orca", "straight")
    ]
    assert cells == expected
    (word,) = CommandLine.parse(["checkpoint=a,b"]).quoted().words()
    assert value_of(word) == "a,b"


def test_every_path_field_is_known() -> None:
    """A new string field must be added to PATH_FIELDS or to the exceptions here."""
    owners = [
        Config,
        Bench,
        Export,
        Predictor,
        Record,
        Render,
        Report,
        Train,
        Scenario,
        Reward,
        Learned,
        ModelPredictive,
        Shield,
        TrainerConfig,
    ]
    texts = {
        field.name
        for owner in owners
        for field in dataclasses.fields(owner)
        if field.type in ("str", "str | None", str)
    }
    assert texts - PATH_FIELDS == {"name", "about", "against", "crowd", "device", "wandb"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--agent=orca"], "'--agent=orca' is not an option"),
        (["--config-dir"], "--config-dir has no value"),
        (["orca"], "'orca' is not a setting"),
        (["=3"], "'=3' is not a setting"),
        (["agent=orca,straight"], "agent is 'orca,straight'; it must be a single value"),
        (["agents=[orca"], "agents is '[orca'; it must be a list [a,b]"),
    ],
)
def test_invalid_words_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(ConfigurationError) as error:
        CommandLine.parse(words).quoted()
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


def test_options_may_stand_anywhere() -> None:
    command = CommandLine.parse(
        ["agent=orca", "--config-dir", "a=b (1)", "-m", "scenario.robots=1,2"]
    )
    assert command.folder == Path("a=b (1)")
    assert command.is_sweep
    assert command.quoted().words() == [
        "--config-dir",
        "a=b (1)",
        "-m",
        "agent=orca",
        "scenario.robots=1,2",
    ]


def test_recordings_may_have_an_extension_in_capitals(tmp_path: Path) -> None:
    for name in ("b.TXT", "a.txt", "notes.md"):
        (tmp_path / name).touch()
    default = Scenario().frame_seconds
    expected = {tmp_path / "a.txt": default, tmp_path / "b.TXT": 0.1}
    assert recordings_in(str(tmp_path), {"b": 0.1}) == expected
    assert recordings_in(None, {}) == {}
    with pytest.raises(ConfigurationError, match="recordings is 'nowhere'"):
        recordings_in("nowhere", {})


@pytest.mark.parametrize(
    ("name", "names", "closest"),
    [
        ("human", ["human_radius_max", "humans", "humans_min"], "humans"),
        ("dt", ["time_limit", "time_step", "team_delay"], "time_step"),
        ("fov", ["force_range", "fov_degrees"], "fov_degrees"),
        ("lr", ["layers", "learning_rate"], "learning_rate"),
        ("robotz", ["robots", "robot_radius"], "robots"),
    ],
)
def test_the_closest_name_is_suggested_first(name: str, names: list[str], closest: str) -> None:
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
    saved = json.loads(Path("rows (1), here/row.json").read_text())
    assert saved["config"]["scenario"]["recording"] == str(recording)
    # The row's command is all it takes to play it again, and is shown as it was written.
    program, *words = shlex.split(saved["row"]["command"])
    monkeypatch.setattr(sys, "argv", [program, *words, "hydra.run.dir=again"])
    evaluate.main()
    again = json.loads(Path("again/row.json").read_text())
    assert again["config"] == saved["config"]
    assert row_settings(again["row"])[-1].startswith("scenario.recording=")
