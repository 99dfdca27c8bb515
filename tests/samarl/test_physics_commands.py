"""MuJoCo on the command line."""

import json
import subprocess
from pathlib import Path

import pytest
from PIL import Image

from tests.commands import run_module


def run(command: str, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return run_module(f"samarl.commands.{command}", *words, cwd=cwd, timeout=500)


def test_a_row_names_its_engine_and_how_well_robots_follow_their_commands(tmp_path: Path) -> None:
    words = ["agent=straight", "engine=mujoco", "engine.latency=0.1", "scenario.humans=0"]
    done = run("evaluate", *words, "evaluation.cases=2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "cm from where it leads" in done.stdout
    folder = next((tmp_path / "outputs/evaluate").iterdir())
    row = json.loads((folder / "row.json").read_text())["row"]
    assert row["changes"] == "engine=mujoco engine.latency=0.1"
    assert 0.001 < row["tracking_error"] < 0.1
    assert len((folder / "episodes.jsonl").read_text().splitlines()) == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["engine.latency=0.05"], "engine.latency is not known"),
        (["engine=mujoco", "engine.latency=0.3"], "engine.latency is 0.3; it must lie in [0, 0.2]"),
        (["engine=bullet"], "engine is 'bullet'"),
        (["-m", "engine=mujoco", "scenario.arena_radius=8,9"], "scenario.arena_radius is 8.0"),
    ],
    ids=["without", "range", "unknown", "sweep"],
)
def test_mistakes_are_reported_in_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    done = run("evaluate", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_film_has_a_picture_per_decision_where_the_machine_can_render(tmp_path: Path) -> None:
    words = ["agent=orca", "engine=mujoco", "scenario.time_limit=1", "scenario.humans=2"]
    done = run("render", *words, "output=film.gif", cwd=tmp_path)
    if done.returncode:  # no OpenGL here
        assert "MUJOCO_GL" in done.stderr
        assert "Traceback" not in done.stderr
        assert not (tmp_path / "film.gif").exists()
        return
    film = Image.open(tmp_path / "film.gif")
    assert film.n_frames == 5  # the start and four decisions
    assert len(film.convert("RGB").getcolors(2**16) or []) > 8  # not an empty picture
