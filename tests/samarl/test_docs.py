"""What the documentation prints runs as it is printed."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from samarl.evaluation.metrics import metric_fields

DOCS = Path(__file__).parents[2] / "docs"
SMALL = {
    "samarl-evaluate": ["evaluation.cases=2"],
    "samarl-predictor": ["validation_cases=2"],
    "samarl-train": [
        "trainer.steps=200", "trainer.rollout=10", "trainer.validation_cases=2",
        "trainer.threads=1", "encoder.width=8", "encoder.features=8", "policy.hidden=8",
        "curriculum.stages=[{worlds: 10, scenario: {humans: 2, robots: 2, time_limit: 2.0}}]",
    ],
}  # fmt: skip


def section(title: str) -> str:
    text = (DOCS / "extending.md").read_text()
    return re.split(r"\n##+ ", text.split(f"# {title}\n")[1])[0]


def block(text: str, language: str) -> str:
    return text.split(f"```{language}\n")[1].split("```")[0]


def run(text: str, folder: Path) -> str:
    """Run the console block of a section in `folder`; returns what it said."""
    said = ""
    for line in block(text, "console").splitlines():
        program, *arguments = shlex.split(line.removeprefix("$ "))
        command = [sys.executable, "-m", program.replace("samarl-", "samarl.commands.")]
        if program == "python":
            command = [sys.executable]
        done = subprocess.run(
            [*command, *arguments, *SMALL.get(program, [])],
            cwd=folder, capture_output=True, text=True, timeout=240,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said += done.stdout
    return said


def test_a_scenario_of_ones_own(tmp_path: Path) -> None:
    text = section("A scenario")
    (tmp_path / "my_conf/scenario").mkdir(parents=True)
    (tmp_path / "my_conf/scenario/plaza.yaml").write_text(block(text, "yaml"))
    said = run(text, tmp_path)
    assert re.search(r"\| model_predictive +\| +360° +\| +20 \| +2 \|", said)


def test_a_predictor_of_ones_own(tmp_path: Path) -> None:
    text = section("A predictor")
    (tmp_path / "my_predictor.py").write_text(block(text, "python"))
    said = run(text, tmp_path)
    assert re.search(r"\| orca +\| +\d+ \| +predictor \|", said)
    assert "| samarl " in said


def test_an_encoder_of_ones_own(tmp_path: Path) -> None:
    text = section("An encoder")
    (tmp_path / "my_conf/encoder").mkdir(parents=True)
    (tmp_path / "my_conf/encoder/deep_sets.yaml").write_text(block(text, "yaml"))
    (tmp_path / "my_encoder.py").write_text(block(text, "python"))
    assert "| samarl " in run(text, tmp_path)
    checkpoint = "checkpoint=outputs/deep_sets/last.safetensors"
    done = subprocess.run(
        [sys.executable, "-m", "samarl.commands.evaluate", "agent=samarl", checkpoint],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2  # nothing of mine is imported unless I say so
    assert (
        "encoder.name is 'deep_sets'; it must be one of gru, pairwise, social_attention"
        in done.stderr
    )


def test_an_algorithm_in_samarl_train(tmp_path: Path) -> None:
    text = section("In samarl-train")
    (tmp_path / "my_conf/algorithm").mkdir(parents=True)
    (tmp_path / "my_conf/algorithm/sharing.yaml").write_text(block(text, "yaml"))
    (tmp_path / "my_mappo.py").write_text(block(text, "python"))
    assert "| samarl " in run(text, tmp_path)
    made = json.loads((tmp_path / "outputs/sharing/last.json").read_text())["provenance"]
    assert made["configuration"]["algorithm"]["name"] == "sharing"


def test_an_algorithm_of_ones_own(tmp_path: Path) -> None:
    text = section("A program of one's own").replace("2000000", "4096")
    (tmp_path / "my_conf/agent").mkdir(parents=True)
    (tmp_path / "my_conf/agent/my_ppo.yaml").write_text(block(text, "yaml"))
    (tmp_path / "my_ppo.py").write_text(block(text, "python"))
    said = run(text, tmp_path)
    assert len(re.findall(r"mean reward -?\d", said)) == 2
    assert "| my_ppo " in said


@pytest.mark.parametrize("page", ["docs/runtime.md", "README.md"])
def test_an_exported_policy_drives(page: str, exported: Path) -> None:
    text = (DOCS.parent / page).read_text().split("# On a robot\n")[1]
    code = block(text, "python")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=exported, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    speed, turn_rate = map(float, re.findall(r"-?\d+\.\d+(?:e-?\d+)?", done.stdout))
    assert 0.0 <= speed <= 1.0
    assert abs(turn_rate) <= 1.05  # 15 degrees in 0.25 s


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the command of the page has written its file."""
    folder = tmp_path_factory.mktemp("exported")
    run((DOCS / "runtime.md").read_text(), folder)
    assert [path.name for path in folder.iterdir()] == ["policy.onnx"]
    return folder


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.stem)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_every_metric_is_defined() -> None:
    text = (DOCS / "metrics.md").read_text()
    assert [name for name in metric_fields() if f"`{name}`" not in text] == []


def test_a_metric_of_ones_own(tmp_path: Path) -> None:
    text = section("A metric")
    (tmp_path / "my_metric.py").write_text(block(text, "python"))
    header, _, row = re.findall(r"^\|.*\|$", run(text, tmp_path), re.MULTILINE)
    column = [cell.strip() for cell in header.split("|")].index("longest s")
    assert re.fullmatch(r"\d+\.\d", row.split("|")[column].strip())
    written = json.loads(next((tmp_path / "outputs").rglob("row.json")).read_text())["row"]
    assert written["longest_time"] > 0
