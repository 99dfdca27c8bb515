"""A full disk or an unwritable folder is reported in one line and leaves no partial files."""

import contextlib
import importlib
import json
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numba.core.caching
import pytest
from hydra.core.global_hydra import GlobalHydra

# joblib looks once, when it is imported, whether it can make semaphores, which are files.
import samarl.commands.bench  # noqa: F401
from samarl.files import find_folder

ONE = ["evaluation.cases=1", "scenario.humans=0", "scenario.robots=1"]
TINY = [
    "encoder.width=8",
    "encoder=spatio_temporal",
    "encoder.heads=1",
    "encoder.history=2",
    "encoder.features=8",
    "policy.hidden=8",
    "trainer.threads=1",
    "trainer.rollout=4",
    "trainer.steps=8",
    "trainer.validation_cases=1",
    "curriculum.stages=[{worlds: 1, scenario: {humans: 2}}]",
]
BENCH = ["agents=[straight]", "evaluation.cases=1", "columns=[{robots: 1, humans: 0}]", "jobs=1"]
PREDICTOR = ["predictor=recurrent", "validation_cases=1", "shown_steps=1"]


@contextlib.contextmanager
def longest_file(size: int) -> Iterator[None]:
    """No file may be longer, whoever asks: it is refused to root, too."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Path]:
    """A folder with a table in it, in which one is; kernels are kept on another disk."""
    monkeypatch.chdir(tmp_path)
    keep = numba.core.caching.Cache.save_overload

    def elsewhere(*arguments: Any) -> None:
        with longest_file(resource.RLIM_INFINITY):
            keep(*arguments)

    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(numba.core.caching.Cache, "save_overload", elsewhere)
    (tmp_path / "results").mkdir()
    rows = json.loads((find_folder("results") / "table1.json").read_text())[:1]
    (tmp_path / "results/table1.json").write_text(json.dumps(rows))
    (tmp_path / "taken").write_text("a file")
    yield tmp_path
    GlobalHydra.instance().clear()


def said(
    command: str,
    words: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> str:
    """The one line of a command that ends with exit code 2."""
    GlobalHydra.instance().clear()
    monkeypatch.setattr(sys, "argv", [f"samarl-{command}", *words])
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        importlib.import_module(f"samarl.commands.{command}").main()
    lines = [x for x in capsys.readouterr().err.splitlines() if not x.startswith("Compiling ")]
    assert stopped.value.code == 2, lines
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize(
    ("command", "words", "path"),
    [
        ("train", [*TINY, "run_dir=run"], "run/"),
        ("evaluate", [*ONE, "agent=straight", "hydra.run.dir=played"], "played/episodes.jsonl"),
        ("evaluate", ["-m", *ONE, "agent=straight,orca", "hydra.sweep.dir=swept"], "swept"),
        ("bench", [*BENCH, "output=mine"], "mine/table1.json"),
        ("render", ["agent=straight", "scenario.time_limit=1", "output=a.png"], "a.png"),
        ("report", ["results=results", "cases=[]", "agents=[straight]", "output=site"], "site"),
        ("predictor", [*PREDICTOR, "output=there"], "there/prediction.json"),
    ],
)
def test_a_full_disk(
    command: str,
    words: list[str],
    path: str,
    place: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = {file for file in place.rglob("*") if file.is_file()}
    with longest_file(1):
        line = said(command, words, monkeypatch, capsys)
    assert line.startswith("error: ")
    assert path in line or str(place) in line
    assert "cannot be written (File too large)" in line
    left = {file for file in place.rglob("*") if file.is_file() and file.stat().st_size}
    prefixes = ("multirun.yaml", "events.out")  # Hydra's own, and TensorBoard's log
    assert [file for file in left - before if not file.name.startswith(prefixes)] == []
    assert not list(place.rglob("*.part"))
