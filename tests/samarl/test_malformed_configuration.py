"""Malformed configurations are reported with the field, the value and what would be right."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hydra.core.global_hydra import GlobalHydra

from mrsan import ConfigurationError
from samarl import api
from samarl.commands import evaluate
from samarl.configuration import scenario_of
from samarl.files import find_folder
from samarl.user_files import reject_alias_bomb


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A place of its own, and no traces."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setattr(sys, "path", list(sys.path))
    gc.disable()  # composing leaves many small objects; collecting them takes half of the time
    yield
    gc.enable()
    GlobalHydra.instance().clear()


def run(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    """The exit code of the command, or what escaped from it."""
    monkeypatch.setattr(sys, "argv", ["samarl-evaluate", *arguments])
    # As in a shell: no log handler of pytest that would swallow a second line.
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    GlobalHydra.instance().clear()
    try:
        evaluate.main()
    except SystemExit as end:
        return end.code
    except Exception as error:
        return error
    return "no complaint"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scenario.fov_degrees=400"], "scenario.fov_degrees is 400.0; it must lie in (0, 360]"),
        (["scenario.robots=0"], "scenario.robots is 0; it must be a whole number in [1, 16]"),
        (
            ["scenario.humans_min=11"],
            "scenario.humans_min is 11; it must not exceed scenario.humans",
        ),
        (
            ["agent.max_neighbors=0"],
            "agent.max_neighbors is 0; it must be a whole number in [1, 80]",
        ),
        (
            ["agent=nobody"],
            "error: agent is 'nobody', which does not exist; ",
        ),
        (["agent=samrl"], "agent is 'samrl', which does not exist; did you mean samarl, "),
        (["agent=null"], "agent is 'null', which does not exist"),
        (["scenario.robots=[1,2]"], "scenario.robots: Value '[1, 2]'"),
        (["scenario.robots=(1"], "scenario.robots: Value '(1'"),
        (["scenario.robots=null"], "scenario.robots: field 'scenario.robots' is not Optional"),
        (["scenario.robots=???"], "scenario.robots has no value"),
        (["scenario.robots.x=1"], "scenario.robots: Value"),
        (["scenario.occlusion=maybe"], "scenario.occlusion: Value 'maybe' is not a valid bool"),
        (["agent.max_neighbors=2.5"], "agent.max_neighbors: Value '2.5'"),
        (["plugins=abc"], "plugins: Invalid value assigned: str is not a ListConfig"),
        (["+scenario.robots=3"], "'+scenario.robots=3' is not a setting"),
        (
            ["agent.shield.horizn=1"],
            "horizn is not known; did you mean agent.shield.horizon?",
        ),
        (["agent.shild=false"], "agent.shild is not known; did you mean agent.shield?"),
        (["robots=3"], "robots is not known; did you mean scenario.robots?"),
        (
            ["scenario.robots_visible=true"],
            "scenario.robots_visible is not known; it is now scenario.crowd_reaction=reciprocal",
        ),
        (["robots_visible=true"], "it is now scenario.crowd_reaction=reciprocal"),
        (["scenario.human=5"], "scenario.human is not known; did you mean scenario.humans?"),
        (["scenario.dt=0.1"], "scenario.dt is not known; did you mean scenario.time_step?"),
        (["agent=samarl", "checkpoint=nobody"], "checkpoint is 'nobody', which does not exist"),
        (["agent=samarl", "checkpoint=nobody"], "results/checkpoints, such as samarl\n"),
        (["agent=samarl", "checkpoint=samarl_fla"], "; did you mean samarl_flat, "),
        (["scenario.robotz=3"], "scenario.robotz is not known; did you mean scenario.robots?"),
        (["scenario.fov=90"], "scenario.fov is not known; did you mean scenario.fov_degrees?"),
        (["scenario.reward.progres=1"], "did you mean scenario.reward.progress?"),
        (["agent.max_neighbours=3"], "did you mean agent.max_neighbors?"),
        (["evaluation.case=1"], "evaluation.case is not known; did you mean evaluation.cases?"),
        (["agnt=orca"], "agnt is not known; did you mean agent?"),
        (
            ["scenario.crowd=orcas"],
            "scenario.crowd is 'orcas'; it must be one of orca, social_force, still, recorded",
        ),
        (["scenario.reward.progress=inf"], "scenario.reward.progress is inf; it must lie in"),
    ],
)
def test_the_message_names_the_field_the_value_and_the_range(
    arguments: list[str],
    message: str,
    bare: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(arguments, monkeypatch) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("agent/a.yaml", "# Zürich\n".encode("latin-1"), "agent/a.yaml is not UTF-8 text"),
        ("agent/a.yaml", "_target_: x".encode("utf-16"), "agent/a.yaml is not UTF-8 text"),
        ("agent/a.yaml", b"a: [1", "agent/a.yaml is not YAML: line 1: expected ',' or ']'"),
        (
            "scenario/a.yaml",
            b"defaults: [samarl]\nrobots: [1, 2]",
            "scenario/a.yaml: scenario.robots: Value '[1, 2]'",
        ),
        (
            "scenario/a.yaml",
            b"defaults: [samarl]\nrobotz: 3",
            "scenario/a.yaml: scenario.robotz is not known; did you mean scenario.robots?",
        ),
        (
            "agent/a.yaml",
            b"_target_: samarl.agents.planners.perimeter.Perimeter\nradius: [1]\n",
            "agent.radius: Value '[1]'",
        ),
    ],
)
def test_the_message_names_the_file_of_the_user(
    name: str,
    content: bytes,
    message: str,
    bare: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = Path("my conf (1)", name)
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    other = Path("my conf (1)/agent/unused.yaml")  # malformed as well, but not read
    other.parent.mkdir(exist_ok=True)
    other.write_bytes(b"\xff")
    group = path.parent.name
    assert run(["--config-dir", "my conf (1)", f"{group}=a"], monkeypatch) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("swept", "message"),
    [
        (["scenario.robots=1,99"], "scenario.robots is 99; it must be a whole number in [1, 16]"),
        (["agent=straight,nobody"], "agent is 'nobody', which does not exist"),
        (["agent=orca", "agent.max_neighbors=3,0"], "agent.max_neighbors is 0; it must be"),
        (["scenario=recorded", "scenario.recording=null,no (1).txt"], "no (1).txt"),
        (["scenario.time_limit=10,0.1"], "time_step is 0.25; it must not exceed"),
        (["evaluation.cases=1,0"], "evaluation.cases is 0; it must be a whole number in"),
        (["agent=samarl", "checkpoint=samarl_ppo,cadrl"], "checkpoint is 'cadrl', a lookahead"),
    ],
)
def test_every_cell_of_a_sweep_is_checked_before_the_first_is_run(
    swept: list[str],
    message: str,
    bare: None,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(api, "run_cases", lambda *_: pytest.fail("played", pytrace=False))
    assert run(["-m", "agent=straight", *swept], monkeypatch) == 2
    said = capsys.readouterr().err.splitlines()
    assert message in said[-1]
    assert not [line for line in said[:-1] if not line.startswith("Compiling")]
    assert list(Path().iterdir()) == []


def test_a_checkpoint_of_another_kind_of_policy_is_refused(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for setting in ("checkpoint=samarl_flat", "agent.checkpoint=samarl_flat"):
        assert run(["agent=cadrl", setting], monkeypatch) == 2
        said = capsys.readouterr().err
        assert "checkpoint is 'samarl_flat', a flat policy; it must be a lookahead policy" in said
        assert "agent=samarl_flat" in said


@pytest.mark.parametrize("bomb", ["billion laughs", "recursive"])
def test_files_whose_aliases_would_fill_the_memory_are_rejected(
    bomb: str, bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten lines that expand to 10^9 values would exhaust the memory."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    for above, below in zip("abcdefgh", "bcdefghi", strict=True):
        lines.append(f"{below}: &{below} [{', '.join([f'*{above}'] * 10)}]")
    Path("mine/agent").mkdir(parents=True)
    Path("mine/agent/bomb.yaml").write_text(
        "&a [*a]" if bomb == "recursive" else "\n".join(lines), encoding="utf-8"
    )
    for extra in ([], ["--help"]):
        assert run(["--config-dir=mine", "agent=bomb", *extra], monkeypatch) == 2
        assert "agent/bomb.yaml has more than 100000 values" in capsys.readouterr().err


def test_common_uses_of_aliases_are_accepted(tmp_path: Path) -> None:
    (tmp_path / "few.yaml").write_text("a: &a {x: 1}\nb: [*a, *a]\nc: {<<: *a}\n")
    for file in (tmp_path / "few.yaml", *find_folder("conf").rglob("*.yaml")):
        reject_alias_bomb(file)


def test_invalid_columns_are_refused() -> None:
    for column, message in (
        (float("inf"), "crowds has inf"),
        ("0x10", "crowds: .*'0x10'"),
        ({"sensing_range": 10**400}, "crowds contains .*too large"),
        ({"scenario": [1]}, r"crowds: .*'\[1\]'.*10p3r"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            scenario_of(column, "crowds")
