"""Every example runs, in a short form; what it claims to learn in little time it learns."""

import ast
import os
import re
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import nbformat
import pytest
import torch
from nbclient import NotebookClient

from mrsan.torchrl_env import TorchRLEnv

EXAMPLES = Path(__file__).parents[2] / "examples"
SHORT = {  # of the notebook's words, so that it takes a minute
    '{"steps": 200_000}': '{"steps": 4608, "validation_cases": 2}, encoder={"width": 16}',
    "cases=200": "cases=2",
    "robots=2)": "robots=2, time_limit=3.0)",
}


def run(name: str, *arguments: str, cwd: Path) -> str:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_stable_baselines_learns_to_arrive_alone(tmp_path: Path) -> None:
    said = run("sb3_ppo.py", "--humans", "0", "--steps", "24576", "--cases", "20", cwd=tmp_path)
    assert ast.literal_eval(said.splitlines()[-1])["arrived"] > 50
    assert "sb3_ppo in samarl (people: 0, robots: 1, view: 360°), 20 cases" in said


@pytest.mark.slow
def test_torchrl_trains_by_its_own_parts(tmp_path: Path) -> None:
    said = run("torchrl_mappo.py", "--steps", "8192", cwd=tmp_path)
    assert said.startswith("success rate by tenths of the training, %: ")


def test_torchrl_actors_explore(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example = import_module("torchrl_mappo")
    actor, _ = example.make_networks(TorchRLEnv(worlds=2, humans=0, robots=2))
    seen, done = [], []
    for _ in range(2):
        env = TorchRLEnv(worlds=2, humans=0, robots=2, seed=0)
        with torch.no_grad():
            batch = example.explore(env, actor, env.reset())
        seen.append(batch["agents", "observation", "ego"][:, 0])
        done.append(batch["agents", "action"][:, 0])
    assert torch.equal(*seen)
    assert (done[0] - done[1]).abs().min() > 0


@pytest.mark.slow
def test_a_crowd_of_ones_own(tmp_path: Path) -> None:
    said = run("custom_crowd.py", "--cases", "3", "--agents", "straight", cwd=tmp_path)
    assert said.startswith("straight           success ")
    assert (tmp_path / "outputs/station.png").stat().st_size > 10_000


@pytest.mark.slow
def test_two_robots_agree_over_udp(tmp_path: Path) -> None:
    said = run("two_robots_udp.py", "--loss", "0.2", "--delay", "0.25", cwd=tmp_path)
    assert said.splitlines()[0] == "arrived: ada, bob"
    assert 0.0 < float(said.split()[-2]) < 3.0  # m between them


@pytest.mark.slow
@pytest.mark.skipif(
    find_spec("benchmarl") is None,
    reason=f"BenchMARL needs torchrl below 0.12; this is {version('torchrl')}",
)
def test_benchmarl_trains_on_the_task(tmp_path: Path) -> None:
    run("benchmarl_task.py", "--steps", "4096", cwd=tmp_path)


@pytest.mark.slow
def test_the_notebook_trains_evaluates_and_looks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    notebook = nbformat.read(EXAMPLES / "first_ten_minutes.ipynb", as_version=4)
    for cell in notebook.cells:
        for long, short in SHORT.items():
            cell.source = cell.source.replace(long, short)
    source = "".join(cell.source for cell in notebook.cells)
    assert all(short in source for short in SHORT.values())
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": tmp_path}}).execute()
    said = "".join(o.get("text", "") for c in notebook.cells for o in c.get("outputs", []))
    assert "error" not in said
    assert re.findall(r"(\S+) in samarl", said) == ["orca", "model_predictive", "shield", "first"]
    assert {p.name for p in (tmp_path / "outputs").iterdir()} >= {"orca.png", "first.png", "first"}
