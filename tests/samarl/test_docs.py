"""Commands, code and facts in the documentation are correct."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from mrsan import Layout
from samarl.configuration import available_agents
from samarl.evaluation.metrics import metric_fields
from samarl.evaluation.summary import read_rows
from tests.commands import run_module

DOCS = Path(__file__).parents[2] / "docs"
SMALL = {
    "samarl-evaluate": ["evaluation.cases=2"],
    "samarl-bench": ["evaluation.cases=2"],
    "samarl-predictor": ["validation_cases=2"],
    "samarl-train": [
        "trainer.steps=200",
        "trainer.rollout=10",
        "trainer.validation_cases=2",
        "trainer.threads=1",
        "encoder.width=8",
        "encoder.features=8",
        "policy.hidden=8",
        "curriculum.stages=[{worlds: 10, scenario: {humans: 2, robots: 2, time_limit: 2.0}}]",
    ],
}


def section(title: str) -> str:
    text = (DOCS / "extending.md").read_text()
    return re.split(r"\n##+ ", text.split(f"# {title}\n")[1])[0]


def block(text: str, language: str) -> str:
    return text.split(f"```{language}\n")[1].split("```")[0]


def run(text: str, folder: Path) -> str:
    """Run the console block of a section in `folder`; return its output."""
    output = ""
    for line in block(text, "console").splitlines():
        program, *arguments = shlex.split(line.removeprefix("$ "))
        argument_names = {argument.partition("=")[0] for argument in arguments}
        small = [s for s in SMALL.get(program, []) if s.partition("=")[0] not in argument_names]
        if program == "python":
            command = [sys.executable, *arguments]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240)
        else:
            module = program.replace("samarl-", "samarl.commands.")
            done = run_module(module, *arguments, *small, cwd=folder)
        assert done.returncode == 0, done.stderr
        output += done.stdout
    return output


def test_a_scenario_of_your_own(tmp_path: Path) -> None:
    text = section("A scenario")
    (tmp_path / "my_conf/scenario").mkdir(parents=True)
    (tmp_path / "my_conf/scenario/plaza.yaml").write_text(block(text, "yaml"))
    output = run(text, tmp_path)
    assert re.search(r"\| model_predictive +\| +360° +\| +20 \| +2 \|", output)


def test_a_table_of_your_own(tmp_path: Path) -> None:
    text = section("A table")
    (tmp_path / "my_conf/table").mkdir(parents=True)
    (tmp_path / "my_conf/table/plaza.yaml").write_text(block(text, "yaml"))
    run(text, tmp_path)
    rows = read_rows(tmp_path / "outputs/bench/plaza.json")
    assert sorted((row["method"], row["humans"]) for row in rows) == [
        ("model_predictive", 5),
        ("model_predictive", 15),
        ("orca", 5),
        ("orca", 15),
    ]


# Section of the page: the files that it uses (of another section), and what its commands print.
OWN: dict[str, tuple[dict[str, str], str]] = {
    "A predictor": ({"my_predictor.py": ""}, r"\| model_predictive "),
    "A crowd model": ({"my_crowd.py": ""}, r"crowd stroll crowd settings\.pace 0\.8"),
    "A term of the reward": ({"my_terms.py": ""}, "written to outputs/calm"),
    "A sensor": (
        {
            "my_conf/encoder/deep_sets.yaml": "An encoder",
            "my_encoder.py": "An encoder",
            "my_sensor.py": "",
        },
        r"\| samarl_flat ",
    ),
    "An encoder": ({"my_conf/encoder/deep_sets.yaml": "", "my_encoder.py": ""}, r"\| samarl "),
    "In samarl-train": (
        {"my_conf/algorithm/happo.yaml": "", "my_happo.py": ""},
        r"\| samarl_flat ",
    ),
    "A separate program": ({"my_conf/agent/my_ppo.yaml": "", "my_ppo.py": ""}, r"\| my_ppo "),
}


@pytest.mark.slow
@pytest.mark.parametrize("title", OWN)
def test_a_part_of_your_own(title: str, tmp_path: Path) -> None:
    files, printed = OWN[title]
    for name, other in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        language = "yaml" if path.suffix == ".yaml" else "python"
        text = block(section(other or title), language)
        path.write_text(text.replace("300000", "4096"))  # steps of the separate program
    assert re.search(printed, run(section(title).replace("300000", "4096"), tmp_path))


def test_an_exported_policy_drives(exported: Path) -> None:
    code = block((DOCS / "runtime.md").read_text().split("## Drive\n")[1], "python")
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=exported, capture_output=True, text=True, timeout=240
    )
    assert done.returncode == 0, done.stderr
    speed, turn_rate = map(float, re.findall(r"-?\d+\.\d+(?:e-?\d+)?", done.stdout))
    assert 0.0 <= speed <= 1.0
    assert abs(turn_rate) <= 1.05  # 15 degrees in 0.25 s


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the file written by the command of the page."""
    folder = tmp_path_factory.mktemp("exported")
    run((DOCS / "runtime.md").read_text(), folder)
    assert [path.name for path in folder.iterdir()] == ["policy.onnx"]
    return folder


def anchors(page: Path) -> set[str]:
    """The anchors of the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", text.lower()).strip().replace(" ", "-") for text in headings}


def test_links_have_targets() -> None:
    for page in (DOCS.parent / "README.md", *DOCS.glob("*.md")):
        for target, _, anchor in re.findall(r"\]\(([^)#\s]*)(#?)([^)\s]*)\)", page.read_text()):
            if "://" in target:
                continue
            path = page.parent / target if target else page
            assert path.exists(), f"{page.name}: {target}"
            assert not anchor or anchor in anchors(path), f"{page.name}: {target}#{anchor}"


@pytest.mark.slow
def test_the_environment_is_made_as_printed() -> None:
    """The quick starts of the four libraries run, on the page and in the README."""
    page = (DOCS / "quickstart.md").read_text().split("## Make the environment\n")[1]
    readme = (DOCS.parent / "README.md").read_text()
    codes = [part.split("```")[0] for part in page.split("## ")[0].split("```python\n")[1:]]
    assert len(codes) == 4
    for code in (*codes, block(readme, "python")):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_the_python_interface_evaluates_as_printed() -> None:
    """The block of the quick start; that of training takes minutes, see `test_api.py`."""
    text = (DOCS / "quickstart.md").read_text().split("## From Python\n")[1]
    values: dict[str, Any] = {}
    exec(block(text, "python"), values)
    assert values["result"].row["episodes"] == 20
    assert {"step", "x", "y"} <= set(values["steps"].columns)


def test_every_agent_and_layout_is_described() -> None:
    pages = "".join((DOCS / name).read_text() for name in ("agents.md", "models.md"))
    assert [name for name in available_agents() if f"`{name}`" not in pages] == []
    environment = (DOCS / "environment.md").read_text()
    assert [layout.name for layout in Layout if f"`{layout.name}`" not in environment] == []


def test_every_metric_is_defined() -> None:
    text = "".join((DOCS / page).read_text() for page in ("metrics.md", "people.md"))
    assert [name for name in metric_fields() if f"`{name}`" not in text] == []


def test_a_metric_of_your_own(tmp_path: Path) -> None:
    text = section("A metric")
    (tmp_path / "my_metric.py").write_text(block(text, "python"))
    header, _, row = re.findall(r"^\|.*\|$", run(text, tmp_path), re.MULTILINE)
    column = [cell.strip() for cell in header.split("|")].index("longest s")
    assert re.fullmatch(r"\d+\.\d", row.split("|")[column].strip())
    written = json.loads(next((tmp_path / "outputs").rglob("row.json")).read_text())["row"]
    assert written["longest_time"] > 0
