"""Commands with options that need no configuration: samarl-curves, samarl-examples, samarl-map."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from samarl.files import find_folder
from samarl.report.curves import read_run_folders
from tests.commands import run_module

MAPS = Path(__file__).parents[1] / "data/maps"
HEADER = "steps,seconds,charts/success,losses/critic"


def write_run(folder: Path, *success: float) -> None:
    folder.mkdir(parents=True)
    lines = [f"{1000 * k},{k},{value},0.5" for k, value in enumerate(success)]
    (folder / "progress.csv").write_text("\n".join([HEADER, *lines]))


def test_curves_of_a_sweep_and_of_a_run(tmp_path: Path) -> None:
    for seed in range(2):
        write_run(tmp_path / f"sweep/policy-flat_trainer.seed-{seed}", 0.0, 0.5 + 0.2 * seed)
    write_run(tmp_path / "mine_seed3", 0.1, 0.2)
    write_run(tmp_path / "sweep/started")
    done = run_module("samarl.commands.curves", "sweep", "mine_seed3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "outputs/curves/index.html").is_file()
    with Image.open(tmp_path / "outputs/curves/curves.png") as picture:
        assert picture.width > 300
    runs = read_run_folders([tmp_path / "sweep", tmp_path / "mine_seed3"])
    assert {name: len(curves) for name, curves in runs.items()} == {
        "sweep/policy-flat": 2,
        "mine": 1,
    }
    (one,) = read_run_folders([tmp_path / "mine_seed3"])
    assert one == "mine"


def test_the_examples_are_copied_once(tmp_path: Path) -> None:
    done = run_module("samarl.commands.examples", "copy/here", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ("README.md", "first_ten_minutes.ipynb", "maps/office.yaml", "ros2/driver_node.py"):
        copy = tmp_path / "copy/here" / name
        assert copy.read_bytes() == (find_folder("examples") / name).read_bytes()
    (tmp_path / "copy/here/README.md").write_text("mine")
    done = run_module("samarl.commands.examples", "copy/here", cwd=tmp_path)
    assert done.returncode == 2
    assert (tmp_path / "copy/here/README.md").read_text() == "mine"


@pytest.mark.parametrize("command", ["curves", "examples"])
def test_mistakes_are_one_line(command: str, tmp_path: Path) -> None:
    write_run(tmp_path / "started")
    write_run(tmp_path / "mine", 0.5)
    (tmp_path / "file").write_text("")
    mistakes: dict[str, dict[tuple[str, ...], str]] = {
        "curves": {
            (): "FOLDER",
            ("nowhere",): "'nowhere'",
            ("started",): "no values yet",
            ("mine", "--output", "mine"): "'mine'",
            ("mine", "--ouput", "new"): "--ouput",
        },
        "examples": {(): "FOLDER", ("mine",): "'mine'", ("file",): "'file'", ("a", "b"): "b"},
    }
    for words, value in mistakes[command].items():
        done = run_module(f"samarl.commands.{command}", *words, cwd=tmp_path)
        assert done.returncode == 2, words
        assert done.stderr.startswith("error: "), words
        assert value in done.stderr, words
        assert len(done.stderr.splitlines()) == 1, words
    assert "FOLDER" in run_module(f"samarl.commands.{command}", "--help", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    ("name", "file_format", "area"),
    [("open_0.196.yaml", "ROS", "96."), ("z.geojson", "GeoJSON", "94.")],
)
def test_what_is_understood_of_a_map(
    name: str, file_format: str, area: str, tmp_path: Path
) -> None:
    words = [str(MAPS / name), "--figure", "map.png"]
    done = run_module("samarl.commands.map", *words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    rows = dict(line.split(maxsplit=1) for line in done.stdout.splitlines() if line[0] != " ")
    assert file_format in rows["format"]
    assert rows["floor"].startswith(area)
    assert ("cells" in rows) == (file_format == "ROS")
    with Image.open(tmp_path / "map.png") as picture:
        assert picture.width > 300


def test_paths_outside_of_the_locale(tmp_path: Path) -> None:
    shutil.copy(MAPS / "metres.geojson", tmp_path / "Zürich.geojson")
    variables = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0"}

    def start(*words: str | bytes) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", "from samarl.main import main; main()", *words]
        return subprocess.run(
            command, cwd=tmp_path, env=variables, capture_output=True, encoding="utf-8"
        )

    done = start("map", "Zürich.geojson")
    assert (done.returncode, done.stderr) == (0, "")
    assert "m²" in done.stdout
    done = start("evaluate", b"scenario.map=Z\xfcrich.yaml")  # Latin-1
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: 'scenario.map=Z")
    assert "UTF-8" in line
