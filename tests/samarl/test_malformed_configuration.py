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

from samarl import api
from samarl.commands import evaluate


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


def test_the_message_names_the_field_the_value_and_the_range(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    moved = "scenario.robots_visible is not known; it is now scenario.crowd_reaction=reciprocal"
    for words, message in (
        ("scenario.fov_degrees=400", "scenario.fov_degrees is 400.0; it must lie in (0, 360]"),
        ("scenario.robots=0", "scenario.robots is 0; it must be a whole number in [1, 16]"),
        ("agent=samrl", "agent is 'samrl', which does not exist; did you mean samarl, "),
        ("scenario.robots=null", "scenario.robots: "),
        ("scenario.robots=???", "scenario.robots has no value"),
        ("scenario.occlusion=maybe", "scenario.occlusion: Value 'maybe'"),
        ("+scenario.robots=3", "'+scenario.robots=3' is not a setting"),
        ("agent.shield.horizn=1", "horizn is not known; did you mean agent.shield.horizon?"),
        ("robots=3", "robots is not known; did you mean scenario.robots?"),
        ("scenario.robots_visible=true", moved),
        ("scenario.dt=0.1", "scenario.dt is not known; did you mean scenario.time_step?"),
        ("agent=samarl checkpoint=nobody", "checkpoint is 'nobody', which does not exist"),
        ("agent=cadrl checkpoint=samarl_flat", "checkpoint is 'samarl_flat', a flat policy; it"),
        ("scenario.reward.progres=1", "did you mean scenario.reward.progress?"),
        ("agnt=orca", "agnt is not known; did you mean agent?"),
        ("scenario.crowd=orcas", "scenario.crowd is 'orcas'; it must be one of orca, social_forc"),
    ):
        assert run(words.split(), monkeypatch) == 2, words
        assert message in capsys.readouterr().err


def test_the_message_names_the_file_of_the_user(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, content, message in (
        ("agent/a.yaml", "# Zürich\n".encode("latin-1"), "agent/a.yaml is not UTF-8 text ("),
        ("agent/b.yaml", b"a: [1", 'agent/b.yaml", line 1'),
        ("scenario/c.yaml", b"robotz: 3", "scenario/c.yaml: scenario.robotz is not known; did"),
    ):  # the others are malformed as well, but not read
        path = Path("my conf (1)", name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"defaults: [samarl]\n" * (path.stem == "c") + content)
        choice = f"{path.parent.name}={path.stem}"
        assert run(["--config-dir", "my conf (1)", choice], monkeypatch) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1
    assert run(["agent=my conf (1)/agent/a.yaml"], monkeypatch) == 2
    assert "agent/a.yaml is not UTF-8 text (" in capsys.readouterr().err


def test_every_cell_of_a_sweep_is_checked_before_the_first_is_run(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(api, "run_cases", lambda *_: pytest.fail("played", pytrace=False))
    for swept, message in (
        (["scenario.robots=1,99"], "scenario.robots is 99; it must be a whole number in [1, 16]"),
        (["agent=straight,nobody"], "agent is 'nobody', which does not exist"),
        (["scenario=recorded", "scenario.recording=null,no (1).txt"], "no (1).txt"),
        (
            ["agent=samarl_waypoints", "checkpoint=samarl_ppo,cadrl"],
            "checkpoint is 'cadrl', a lookahead",
        ),
    ):
        assert run(["-m", "agent=straight", *swept], monkeypatch) == 2
        said = capsys.readouterr().err.splitlines()
        assert message in said[-1]
        assert not [line for line in said[:-1] if not line.startswith("Compiling")]
    assert list(Path().iterdir()) == []


def test_files_whose_aliases_would_fill_the_memory_are_rejected(
    bare: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ten lines that expand to 10^9 values would exhaust the memory."""
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    for above, below in zip("abcdefgh", "bcdefghi", strict=True):
        lines.append(f"{below}: &{below} [{', '.join([f'*{above}'] * 10)}]")
    Path("mine/agent").mkdir(parents=True)
    for text in ("&a [*a]", "\n".join(lines)):
        Path("mine/agent/bomb.yaml").write_text(text, encoding="utf-8")
        assert run(["--config-dir=mine", "agent=bomb"], monkeypatch) == 2
        assert "agent/bomb.yaml has more than 100000 values" in capsys.readouterr().err
