"""Every command line in the documentation can be composed."""

import gc
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hydra.core.config_store import ConfigStore

from samarl.commands.bench import Bench
from samarl.commands.cli import compose_cells
from samarl.commands.export import Export
from samarl.commands.macro import Macro
from samarl.commands.overrides import CommandLine
from samarl.commands.play import Play
from samarl.commands.predictor import Predictor
from samarl.commands.record import Record
from samarl.commands.render import Render
from samarl.commands.report import Report
from samarl.commands.submit import Submit
from samarl.configuration import register_schemas
from samarl.training.settings import train_schema

ROOT = Path(__file__).parents[2]
# `test_docs.py` runs those of extending.md.
PAGES = [ROOT / "README.md", *(p for p in (ROOT / "docs").glob("*.md") if p.stem != "extending")]
SCHEMAS = {
    "bench": Bench,
    "export": Export,
    "macro": Macro,
    "play": Play,
    "predictor": Predictor,
    "record": Record,
    "render": Render,
    "report": Report,
    "submit": Submit,
    "train": train_schema(),
}
# Placeholders; options instead of settings.
OTHER_SYNTAX = r"\.\.\.|NAME|--help|samarl-(?:verify|recording|map|curves|examples)"


def command_lines() -> Iterator[tuple[str, str]]:
    """Page and command line, also of tables and running text."""
    for page in PAGES:
        text = page.read_text().replace("\\\n", " ")
        text = re.sub(r"^\$ [^\n]*\nerror: .*$", "", text, flags=re.MULTILINE)
        for line in re.findall(r"(?:^\$ |`)(samarl-\w+ [^`\n]+)", text, re.MULTILINE):
            if not re.search(OTHER_SYNTAX, line):
                yield page.name, line.partition("  #")[0].strip()


@pytest.fixture(scope="module")
def my_conf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folders of own_scenario.md and other_policies.md; schemas are registered."""
    folder = tmp_path_factory.mktemp("own")
    text = (ROOT / "docs/own_scenario.md").read_text()
    (folder / "my_conf/scenario").mkdir(parents=True)
    scenario = text.split("```yaml\n")[1].split("```")[0]
    (folder / "my_conf/scenario/mine.yaml").write_text(scenario)
    other_policies = (ROOT / "docs/other_policies.md").read_text()
    shutil.copytree(ROOT / "examples/other_policies/agent", folder / "agent")
    agent = other_policies.split("```yaml\n")[1].split("```")[0]
    (folder / "agent/sarl_transfer.yaml").write_text(agent)
    (folder / "outputs/mine").mkdir(parents=True)
    for suffix in (".json", ".safetensors"):
        policy = (ROOT / "results/checkpoints/samarl_flat").with_suffix(suffix)
        shutil.copy(policy, folder / f"outputs/mine/best{suffix}")
    register_schemas()
    for name, schema in SCHEMAS.items():
        ConfigStore.instance().store(name=f"{name}_schema", node=schema)
    return folder


@pytest.mark.slow
def test_every_command_line_is_valid(my_conf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(my_conf)
    monkeypatch.setenv("SAMARL_SWEEP", "sweep")
    lines, invalid = set(command_lines()), []
    assert len(lines) > 80
    gc.disable()  # composing leaves many small objects; collecting them takes half of the time
    for page, line in sorted(lines):
        program, *words = shlex.split(line)
        name = program.removeprefix("samarl-").replace("evaluate", "config")
        try:  # it fails if a group, a choice or a key is unknown
            assert list(compose_cells(name, CommandLine.parse(words)))
        except Exception as error:
            invalid.append(f"{page}: {line}: {error}")
    gc.enable()
    assert invalid == []
