"""Workflows of users: commands run in a folder of their own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

import mrsan
from mrsan import Outcome
from samarl.evaluation.summary import row_fields
from samarl.training.sweep import summary
from tests.commands import run_module


def run(
    command: str, *arguments: str, cwd: Path, code: int = 0, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Run `python -m samarl.commands.<command> <arguments>` and check its exit code."""
    done = run_module(f"samarl.commands.{command}", *arguments, cwd=cwd, COLUMNS="200", **variables)
    assert done.returncode == code, done.stderr
    return done


def test_one_evaluation_writes_its_row_and_its_episodes(tmp_path: Path) -> None:
    done = run(
        "evaluate",
        "agent=straight",
        "evaluation.cases=6",
        "scenario.robots=2",
        "hydra.run.dir=here",
        cwd=tmp_path,
    )
    saved = json.loads((tmp_path / "here/row.json").read_text())
    row = saved["row"]
    assert list(row) == row_fields()
    assert (row["method"], row["episodes"], row["robots"], row["seed"]) == ("straight", 6, 2, 2**41)
    assert saved["config"]["scenario"]["robots"] == 2
    records = [json.loads(line) for line in (tmp_path / "here/episodes.jsonl").open()]
    assert [record["case"] - 2**41 for record in records] == list(range(6))
    successes = sum(set(record["outcome"]) == {Outcome.arrived.name} for record in records)
    assert sum(record["success"] for record in records) == successes
    assert row["success_rate"] == round(100 * successes / 6, 2)
    scores = [score for record in records for score in record["social_score"]]
    assert row["social_score"] == pytest.approx(sum(scores) / 12, abs=0.01)
    assert "| straight | 360° |" in done.stdout

    # The command in the row reproduces it.
    words = row["command"].split()
    assert words[0] == "samarl-evaluate"
    run("evaluate", *words[1:], "hydra.run.dir=again", cwd=tmp_path)
    again = json.loads((tmp_path / "again/row.json").read_text())["row"]
    assert {**again, "command": ""} == {**row, "command": ""}
    assert (tmp_path / "again/episodes.jsonl").read_text() == (
        tmp_path / "here/episodes.jsonl"
    ).read_text()


def test_a_sweep_writes_a_table_and_resumes(tmp_path: Path) -> None:
    sweep = [
        "-m",
        "agent=straight",
        "scenario.fov_degrees=90,360",
        "scenario.robots=2,3",
        "evaluation.cases=4",
    ]
    first = run("evaluate", *sweep, cwd=tmp_path)
    (folder,) = (tmp_path / "outputs/sweep").iterdir()
    assert folder.name.startswith("fov_degrees-robots-")
    cells = sorted(folder.glob("**/row.json"))
    assert len(cells) == 4
    assert "already finished" not in first.stdout
    rows = json.loads((folder / "table.json").read_text())
    columns = [(row["fov_degrees"], row["robots"]) for row in rows]
    assert columns == [(90.0, 2), (90.0, 3), (360.0, 2), (360.0, 3)]
    table = (folder / "table.md").read_text()
    assert len(table.splitlines()) == 2 + 4

    again = run("evaluate", *sweep, cwd=tmp_path)
    assert again.stdout.count("already finished") == 4
    assert (folder / "table.md").read_text() == table

    cells[2].unlink()
    last = run("evaluate", *sweep, cwd=tmp_path)
    assert last.stdout.count("already finished") == 3
    assert cells[2].exists()
    assert json.loads((folder / "table.json").read_text()) == rows

    # Other cases belong to another sweep.
    other = run("evaluate", *sweep[:-1], "evaluation.cases=5", cwd=tmp_path)
    assert "already finished" not in other.stdout
    assert len(list((tmp_path / "outputs/sweep").iterdir())) == 2  # with its own table
    assert (folder / "table.md").read_text() == table


@pytest.mark.slow
def test_a_sweep_of_training_runs_has_a_folder_for_each_and_resumes(tmp_path: Path) -> None:
    small = ["scenario.humans=2", "worlds=4", "encoder.width=16", "policy=flat"]
    small += ["trainer.rollout=4", "trainer.validation_cases=2", "trainer.threads=1"]
    sweep = ["-m", "trainer.seed=0,1", *small]
    run("train", *sweep, "trainer.steps=32", cwd=tmp_path)
    (folder,) = (tmp_path / "outputs/sweep").iterdir()
    assert sorted(path.name for path in folder.glob("*/")) == ["trainer.seed-0", "trainer.seed-1"]
    more = run("train", *sweep, "trainer.steps=64", cwd=tmp_path)
    assert more.stdout.count("resuming at step 32 of 64") == 2
    assert [path.name for path in (tmp_path / "outputs/sweep").iterdir()] == [folder.name]
    assert "| all |     2 |    64 |" in (folder / "summary.md").read_text()
    # Refused before the first run starts: one folder for all, and the folder of another run.
    done = run("train", *sweep, "trainer.steps=64", "run_dir=one", cwd=tmp_path, code=2)
    assert done.stderr.startswith("error: run_dir is 'one' in several cells of the sweep; it must")
    done = run("train", *sweep, "trainer.steps=32", cwd=tmp_path, code=2)
    assert done.stderr.startswith("error: trainer.steps is 32; it must be at least 64")
    assert not (tmp_path / "one").exists()


def test_the_summary_of_a_sweep_is_the_mean_over_seeds(tmp_path: Path) -> None:
    for name, rate in (("policy-flat", 0.9), ("policy-hierarchical", 0.6)):
        for seed in (0, 1):
            lines = ["steps,seconds,validation/success_360_10h_3r", "100,1,0.1"]
            lines += [f"200,2,{rate + 0.1 * seed}", "300,3,"]
            folder = tmp_path / f"{name}_trainer.seed-{seed}"
            folder.mkdir()
            (folder / "progress.csv").write_text("\n".join(lines))
    assert summary(tmp_path).splitlines()[2:] == [
        "| policy-flat         |     2 |   200 |   95.0 [90.0, 100.0] |",
        "| policy-hierarchical |     2 |   200 |    65.0 [60.0, 70.0] |",
    ]


def test_the_bench_writes_table_1_in_the_documented_form(tmp_path: Path) -> None:
    done = run(
        "bench", "evaluation.cases=2", "agents=[orca,perimeter]", "output=mine", cwd=tmp_path
    )
    rows = json.loads((tmp_path / "mine/table1.json").read_text())
    assert [list(row) for row in rows] == [row_fields()] * len(rows)
    columns = [(90.0, 10, 3), (90.0, 10, 5), (360.0, 10, 5), (360.0, 10, 3)]
    expected = [(method, *column) for column in columns for method in ("orca", "perimeter")]
    actual = [(r["method"], r["fov_degrees"], r["humans"], r["robots"]) for r in rows]
    assert sorted(actual) == sorted(expected)
    assert {row["episodes"] for row in rows} == {2}
    page = (tmp_path / "mine/table1.md").read_text()
    assert "paper: SAMARL" in page
    verdicts = [
        line
        for line in done.stdout.splitlines()
        if line.split(" ")[0] in ("same", "close", "DIFFERS", "new", "other")
    ]
    assert len(verdicts) == len(rows)


def test_the_bench_evaluates_other_layouts_and_recordings(tmp_path: Path) -> None:
    shipped = Path(mrsan.__file__).parent / "recording"
    words = ["table=transfer", "agents=[orca,straight]", "evaluation.cases=2", "output=mine"]
    columns = "columns=[{layout: square}, {fov_degrees: 90, team_perception: tracks}]"
    done = run("bench", *words, columns, f"recordings={shipped}", cwd=tmp_path)
    rows = json.loads((tmp_path / "mine/transfer.json").read_text())
    settings = {(r["layout"], r["team_perception"], r["recording"]) for r in rows}
    assert settings == {
        ("square", "none", None),
        ("circle", "tracks", None),
        ("circle", "none", "synthetic.txt"),
    }
    assert len(rows) == 6
    page = (tmp_path / "mine/transfer.md").read_text()
    assert "Cases that no agent solves: 360° 3r synthetic " in page
    assert str(tmp_path) not in page
    assert str(shipped) not in json.dumps(rows)
    assert done.stdout.count("new ") >= 6


def test_the_bench_evaluates_policies_only_in_their_views(tmp_path: Path) -> None:
    words = ["agents=[samarl_circle]", "evaluation.cases=1", "output=mine"]
    columns = "[{fov_degrees: 90, robots: 1}, {fov_degrees: 360, robots: 1}]"
    done = run("bench", *words, f"columns={columns}", cwd=tmp_path)
    rows = json.loads((tmp_path / "mine/table1.json").read_text())
    assert {row["fov_degrees"] for row in rows} == {360.0}
    assert "samarl_circle: samarl_circle was trained for a view of 360 degrees; here" in done.stdout
    done = run("bench", *words, "columns=[{fov_degrees: 120}]", cwd=tmp_path, code=2)
    assert done.stderr.startswith(
        "error: columns has no column that an agent can play: samarl_circle was trained"
    )


def test_render_draws_a_case(tmp_path: Path) -> None:
    words = ["render", "agent=straight"]
    run(*words, "case=3", "scenario.robots=2", "output=case.png", cwd=tmp_path)
    picture = (tmp_path / "case.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n")
    run(*words, f"case={2**41 + 3}", "scenario.robots=2", "output=same.png", cwd=tmp_path)
    assert (tmp_path / "same.png").read_bytes() == picture  # a case number as in episodes.jsonl
    run(*words, "case=3", "scenario.time_limit=1", "output=case.gif", cwd=tmp_path)
    assert (tmp_path / "case.gif").read_bytes().startswith(b"GIF89a")
    run(*words, "against=straight", "case=3", "output=two.png", cwd=tmp_path)
    with Image.open(tmp_path / "two.png") as two, Image.open(tmp_path / "case.png") as one:
        assert two.width > 1.7 * one.width  # the same agent twice, for example with two checkpoints
    done = run("render", "output=case.txt", cwd=tmp_path, code=2)
    assert done.stderr.startswith("error: output is 'case.txt'; it must end in .png, ")


def test_a_custom_agent_is_one_class_and_one_yaml_file(tmp_path: Path) -> None:
    """The planner of the documentation, its errors, and a class without `@dataclass`."""
    page = Path(__file__).parents[2] / "docs/extending.md"
    text = page.read_text().split("## A planner\n")[1]
    python = text.split("```python\n")[1].split("```")[0]
    (tmp_path / "my_planner.py").write_text(python)
    (tmp_path / "conf/agent").mkdir(parents=True)
    yaml = text.split("```yaml\n")[1].split("```")[0]
    (tmp_path / "conf/agent/mine.yaml").write_text(yaml)
    words = ["--config-dir", "conf", "agent=mine", "evaluation.cases=3", "hydra.run.dir=here"]
    run("evaluate", *words, cwd=tmp_path)
    row = json.loads((tmp_path / "here/row.json").read_text())["row"]
    assert (row["method"], row["episodes"]) == ("mine", 3)
    done = run("evaluate", *words, "agent.patience=9", cwd=tmp_path, code=2)
    assert done.stderr == "error: agent.patience is 9.0; it must lie in [0, 5]\n"
    (tmp_path / "my_planner.py").write_text(python.replace("@dataclass\n", ""))
    done = run("evaluate", *words, cwd=tmp_path, code=2)
    assert "_target_ is 'my_planner.Patient'; it must be a dataclass" in done.stderr


@pytest.mark.parametrize("command", ["evaluate", "bench", "train"])
def test_help_is_fast(command: str, tmp_path: Path) -> None:
    """Help shows ranges and imports nothing slow; some settings of training need torch."""
    code = (
        "import sys\nfrom runpy import run_module\n"
        f"sys.argv = ['samarl-{command}', '--help']\n"
        f"try:\n    run_module('samarl.commands.{command}', run_name='__main__', alter_sys=True)\n"
        "finally:\n"
        "    heavy = {'torch', 'torchrl', 'pettingzoo', 'matplotlib'} & set(sys.modules)\n"
        "    print('heavy:', heavy or 'none')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "heavy: none" in done.stdout or command == "train"
    lines = {line.strip().partition("  ")[0]: line for line in done.stdout.splitlines()}
    setting, meaning = {
        "evaluate": ("fov_degrees: 360.0", "centred on the heading, degrees (0, 360]"),
        "bench": ("cases: 500", "number of cases [1, 1e+06]"),
        "train": ("waypoint_range: 1.5", "may move it from there, m [0.1, 100]"),
    }[command]
    assert lines[setting].endswith(meaning)
    assert list(tmp_path.iterdir()) == []
