"""The kinds of malformed inputs, each derived from a valid one."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import logging
import os
import random
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from benchmarks.damage import (
    damaged_bytes,
    damaged_json,
    damaged_yaml,
    hostile_header,
    invalid_tensors,
)
from mrsan import ConfigurationError, Scenario, World
from mrsan.prediction import SHIPPED, find_predictor
from mrsan.recording import SAMPLE, load_recording
from samarl.agents import build_agent
from samarl.commands import bench, evaluate, export, predictor, render, report, train
from samarl.configuration import register_schemas
from samarl.evaluation.page import page
from samarl.evaluation.regression import compare
from samarl.evaluation.seeds import improvements
from samarl.evaluation.summary import read_rows
from samarl.evaluation.sweep import read_cell
from samarl.files import find_folder
from samarl.policies.checkpoint import make_policy, save_policy
from samarl.prediction.learner import Learner
from samarl.prediction.training import Training
from samarl.report.figures import read_curve
from samarl.report.leaderboard import ranked
from samarl.training.run import build_trainer

COMMANDS = {
    "evaluate": evaluate,
    "train": train,
    "predictor": predictor,
    "render": render,
    "report": report,
    "bench": bench,
    "export": export,
}
PRIMARY = {"evaluate": "config"}  # files in conf/ whose names differ from those of their commands
MINIMAL = {  # so that accidentally valid command lines are accepted quickly
    "bench": ["agents=[orca]", "output=out"],
    "report": ["agents=[orca]", "output=out"],
    "render": ["output=out.png"],
    "export": ["output=out.onnx", "agent=learned", "checkpoint=policy.safetensors"],
    "predictor": ["output=out"],
    "train": [
        "run_dir=out",
        "encoder.width=8",
        "encoder=spatio_temporal",
        "encoder.heads=1",
        "encoder.features=8",
        "policy.hidden=8",
        "curriculum.stages=[{worlds: 1}]",
        "trainer.threads=1",
    ],
}
RUN = [
    "run_dir=run",
    "encoder.width=8",
    "encoder=spatio_temporal",
    "encoder.heads=1",
    "encoder.history=2",
    "encoder.features=8",
    "policy.hidden=8",
    "trainer.threads=1",
    "trainer.rollout=4",
    "algorithm.critic_width=8",
    "algorithm.critic_features=8",
    "curriculum.stages=[{worlds: 1, scenario: {humans: 2, robots: 2}}]",
]
ENCODER = {"name": "gru", "width": 8, "features": 8}
POLICY = {
    "num_parameter_sets": 1,
    "hidden": 8,
    "track_time": 1.0,
    "round_below": 180.0,
    "round_radius": 7.0,
    "encoder": ENCODER,
}
VALUES = [
    "1000000000",
    "-1",
    "0",
    "1e308",
    "nan",
    "inf",
    "-inf",
    "abc",
    "''",
    "[1,2]",
    "[]",
    "{a: 1}",
    "null",
    "???",
    "true",
    "2.5",
    "../x",
    "${nowhere}",
    "'${'",
    "${oc.env:NOWHERE}",
    "1" + "0" * 400,
    "9" * 5000,
    "a" * 5000,
    "[[1,2],[3]]",
    "'a b'",
    "é",
    "0x10",
    "[{}]",
    "{}",
    "{worlds: 1000000000}",
    "[{worlds: 1000000000}]",
    "[{scenario: {humans: 1000000000}}]",
    "[{humans: 1000000000}]",
]


@dataclass
class MalformedInput:
    """A malformed input and how to load it."""

    kind: str
    load: Callable[[], object]
    command: list[str] = field(default_factory=list)  # a command line that loads it
    names: tuple[str, ...] = ()  # the error must contain one of them


class AcceptedByCommand(BaseException):
    """A command has accepted its input and would start to work."""


class ValidInputs:
    """Valid inputs in a folder, from which the malformed inputs are derived."""

    def __init__(self, folder: Path) -> None:
        """Create all of them and change to the folder."""
        self.folder = folder / "far" / "down" / "below"  # `../x` stays inside
        self.folder.mkdir(parents=True)
        os.chdir(self.folder)
        self.policy = Path("policy.safetensors")
        save_policy(self.policy, make_policy("flat", POLICY, 3), "flat", {"command": "test"})
        self.predictor = Path("predictor.safetensors")
        for suffix in (".safetensors", ".json"):
            shutil.copy(SHIPPED / f"recurrent{suffix}", self.predictor.with_suffix(suffix))
        rows = json.loads((find_folder("results") / "table1.json").read_text())
        self.rows = [*rows[:2], next(row for row in rows if "training_seeds" in row)]
        self.cell = {"row": rows[0], "config": {}, "commit": "x", "agent": "y"}
        self.scenario = Scenario(humans=2, robots=2)
        world = World(self.scenario)
        self.observation = world.reset([0])
        with composed("train", RUN) as config:
            self.trainer = build_trainer(train.settings_in(config), "test")
        self.trainer.save()
        training = Training(4, 2, 1, 1, 1, 3, 1, 0.1, 1.0, 0.0, 0)
        self.learner = Learner(training, {"orca": Scenario()}, Path("training.safetensors"))
        self.learner.save()
        self.bytes = {
            path: path.read_bytes()
            for path in (self.policy, self.predictor, self.learner.path, self.state)
        }
        self.metadata = {
            path: json.loads(path.with_suffix(".json").read_text())
            | {"provenance": {"command": "test"}}
            for path in (self.policy, self.predictor)
        }
        self.agent = (find_folder("conf") / "agent/orca.yaml").read_text()
        for path in ("conf/agent", "conf/scenario", "tables"):
            Path(path).mkdir(parents=True)
        (Path("conf/agent") / "learned.yaml").write_text(
            "_target_: samarl.agents.learned.Learned\ncheckpoint: policy.safetensors\n"
        )
        self.fields = {
            name: [key for key in fields_of(name) if not key.startswith("plugins")]
            for name in COMMANDS
        }

    @property
    def state(self) -> Path:
        """The file with the state of the training."""
        return self.trainer.run_dir.folder / "state.safetensors"


def damaged_weights(r: random.Random, valid: ValidInputs, path: Path) -> bytes:
    """Return a damaged version of a valid file of tensors."""
    damage = r.choice([damaged_bytes, hostile_header, hostile_header, invalid_tensors])
    return damage(r, valid.bytes[path])


def write_damaged_pair(r: random.Random, valid: ValidInputs, path: Path) -> None:
    """Write weights and their metadata, one of them damaged; the digest usually matches."""
    content, metadata = valid.bytes[path], dict(valid.metadata[path])
    if r.random() < 0.5:
        content = damaged_weights(r, valid, path)
        if r.random() < 0.8:
            metadata["sha256"] = hashlib.sha256(content).hexdigest()
        text = json.dumps(metadata).encode()
    else:
        text = damaged_json(r, metadata)
    path.write_bytes(content)
    path.with_suffix(".json").write_bytes(text)


def policy(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a policy that is damaged or has damaged metadata."""
    write_damaged_pair(r, valid, valid.policy)
    agent = {"_target_": "samarl.agents.learned.Learned", "checkpoint": str(valid.policy)}

    def load() -> None:
        policy = build_agent(agent, valid.scenario)
        policy.scope_warning(), policy.version()
        policy.reset(np.ones(1, np.bool_))
        policy.act(valid.observation)

    command = ["evaluate", "agent=samarl_flat", f"checkpoint={valid.policy}", "evaluation.cases=1"]
    return MalformedInput("policy", load, command, (str(valid.policy.stem),))


def predictor_file(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a predictor that is damaged or has damaged metadata."""
    write_damaged_pair(r, valid, valid.predictor)

    def load() -> None:
        model = find_predictor(str(valid.predictor), 0.25)
        past = np.zeros((1, 2, model.history, 2), np.float32)
        model.predict(past, np.ones(past.shape[:-1], np.bool_), past[..., -1, :], 2)

    command = ["predictor", f"predictor={valid.predictor}", "validation_cases=1"]
    return MalformedInput("predictor", load, command, (str(valid.predictor.stem),))


def training_state(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged state of an interrupted training."""
    valid.state.write_bytes(damaged_weights(r, valid, valid.state))
    return MalformedInput(
        "training state", valid.trainer.load, ["train", "resume=run"], ("state.safe",)
    )


def predictor_state(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged state of an interrupted training of the predictor."""
    path = valid.learner.path
    path.write_bytes(damaged_weights(r, valid, path))
    return MalformedInput("predictor state", valid.learner.restore, names=(path.name,))


def table(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged table of results."""
    path = Path("tables/table.json")
    path.write_bytes(damaged_json(r, valid.rows))

    def load() -> None:
        if rows := read_rows(path):
            page("table", "", rows, improvements(rows, [rows[0]["method"]]))
            ranked(rows)
            compare(valid.rows[0], rows)

    command = ["report", "results=tables", "agents=[orca]", "cases=[]", "output=pages"]
    return MalformedInput("table", load, command, (path.name,))


def cell(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged cell of a sweep, which must count as unfinished."""
    path = Path("row.json")
    path.write_bytes(damaged_json(r, valid.cell))

    def load() -> None:
        if read_cell(path) is None:
            raise ConfigurationError("the cell is evaluated again")

    return MalformedInput("cell of a sweep", load)


def recording(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a recording in one of many formats, with invalid cells or damaged bytes."""
    rows = [line.split() for line in SAMPLE.read_text().splitlines()]
    header, separator, lines = r.choice(RECORDINGS)(rows[: r.choice([1, 2, 30, 300, len(rows)])])
    invalid = [
        "nan",
        "inf",
        "-1",
        "1e308",
        "1e12",
        "abc",
        "",
        "1e-320",
        "99999999999",
        "{",
        "\x00",
        "?",
        "'",
        '"',
        "#",
        "1,5",
        "1;5",
        "9" * 5000,
    ]
    for _ in range(r.randint(0, 3)):
        number = r.randrange(len(lines))
        cells = lines[number].split(separator)
        cells[r.randrange(len(cells))] = r.choice(invalid)
        lines[number] = separator.join(cells)
    content = "\n".join([*header, *lines]).encode(r.choice(["utf-8", "utf-8-sig", "utf-16"]))
    path = Path("people.txt")
    path.write_bytes(damaged_bytes(r, content) if r.random() < 0.4 else content)
    words = ["evaluate", "scenario=recorded", f"scenario.recording={path}", "evaluation.cases=1"]
    command = r.choice([words, ["recording", str(path)]])
    return MalformedInput(
        "recording", lambda: load_recording(path, None, 0.25), command, (path.name,)
    )


Rows = list[list[str]]  # frame, id, x, y
RECORDINGS: list[Callable[[Rows], tuple[list[str], str, list[str]]]] = [  # header, separator, lines
    lambda rows: ([], " ", [" ".join(row) for row in rows]),
    lambda rows: (["frame,id,x,y"], ",", [",".join(row) for row in rows]),
    lambda rows: ([], ";", [";".join(row).replace(".", ",") for row in rows]),
    lambda rows: (
        ["# framerate: 25", "# id frame x/m y/m"],
        "\t",
        [f"{p}\t{f}\t{x}\t{y}" for f, p, x, y in rows],
    ),
    lambda rows: ([], " ", [f"{f} {p} {x} 0 {y} 1 0 1" for f, p, x, y in rows]),
    lambda rows: ([], " ", [f'{p} {x} {y} {x} {y} {f} 0 0 0 "Pedestrian"' for f, p, x, y in rows]),
    lambda rows: ([], ",", [",".join(row) for row in zip(*rows, strict=True)]),
    lambda rows: (
        ['{"scene": {"id": 0, "fps": 2.5}}'],
        ": ",
        [f'{{"track": {{"f": {f}, "p": {p}, "x": {x}, "y": {y}}}}}' for f, p, x, y in rows],
    ),
]


def curve(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged learning curve."""
    text = b"steps,seconds,charts/success\n" + b"1,2,0.5\n" * r.randint(1, 5)
    path = Path("curve.csv")
    wide = b"steps," + b"a" * 200_000 + b"\n1,2\n"
    path.write_bytes(
        r.choice([damaged_bytes(r, text), damaged_bytes(r, text), wide, text + b"1," * 9])
    )
    return MalformedInput("curve", lambda: read_curve(path), names=(path.name,))


def custom_yaml(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged YAML file of a custom agent or scenario."""
    group = r.choice(["agent", "scenario"])
    text = valid.agent if group == "agent" else "defaults: [samarl]\nhumans: 4\nfov_degrees: 90.0\n"
    (Path("conf") / group / "custom.yaml").write_bytes(damaged_yaml(r, text))
    return command_item("YAML", "evaluate", ["--config-dir=conf", f"{group}=custom"])


def overrides(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a command line with random values."""
    name = r.choice(list(COMMANDS))
    words = [
        f"{r.choice(valid.fields[name])}={r.choice(VALUES)}" for _ in range(r.choice([1, 1, 2]))
    ]
    search_path = []
    if name == "export":
        search_path = ["--config-dir=conf"]
        valid.policy.write_bytes(valid.bytes[valid.policy])
        valid.policy.with_suffix(".json").write_text(json.dumps(valid.metadata[valid.policy]))
    return command_item("command line", name, search_path + MINIMAL.get(name, []) + words)


def resumed(r: random.Random, valid: ValidInputs) -> MalformedInput:
    """Return a damaged state of an interrupted training, loaded by the command."""
    valid.state.write_bytes(damaged_weights(r, valid, valid.state))
    valid.trainer.run_dir.release()
    return command_item("resume", "train", ["resume=run"])


COMMAND_KINDS = ("YAML", "command line", "resume")  # slower, because a command loads them
KINDS: dict[str, Callable[[random.Random, ValidInputs], MalformedInput]] = {
    "policy": policy,
    "predictor": predictor_file,
    "training state": training_state,
    "predictor state": predictor_state,
    "table": table,
    "cell of a sweep": cell,
    "recording": recording,
    "curve": curve,
    "YAML": custom_yaml,
    "command line": overrides,
    "resume": resumed,
}


def command_item(kind: str, name: str, words: list[str]) -> MalformedInput:
    """Return a command line that this process runs until the command would start to work."""
    return MalformedInput(kind, lambda: call(name, words), [name, *words])


def call(name: str, words: list[str]) -> None:
    """Run a command up to the start of its work.

    Raises:
        ConfigurationError: the command reported an error in one line.
        RuntimeError: the command failed in any other way.
    """

    def accept(*_: Any, **__: Any) -> None:
        raise AcceptedByCommand

    work = [
        "samarl.commands.evaluate.run_cases",
        "samarl.training.trainer.Trainer.run",
        "samarl.prediction.windows.simulate_windows",
        "samarl.commands.render.record_episode",
        "samarl.commands.report.record_episode",
        "samarl.report.build.build_site",
        "samarl.commands.bench.Parallel",
        "samarl.export.export_agent",
    ]
    stderr = io.StringIO()
    root = logging.getLogger()
    GlobalHydra.instance().clear()
    with contextlib.ExitStack() as stack:
        for target in work:
            stack.enter_context(mock.patch(target, accept))
        stack.enter_context(mock.patch.object(sys, "argv", [f"samarl-{name}", *words]))
        stack.enter_context(mock.patch.object(sys, "path", list(sys.path)))
        stack.enter_context(mock.patch.object(root, "handlers", []))
        stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
        stack.enter_context(contextlib.redirect_stderr(stderr))
        try:
            COMMANDS[name].main()
        except AcceptedByCommand:
            return
        except SystemExit as end:
            lines = stderr.getvalue().splitlines()
            if end.code == 2 and len(lines) == 1 and lines[0].startswith("error: "):
                raise ConfigurationError(lines[0]) from None
            raise RuntimeError(f"exit code {end.code}: {stderr.getvalue()}") from None


@contextlib.contextmanager
def composed(name: str, words: list[str]) -> Iterator[DictConfig]:
    """Compose the configuration of a command."""
    register_schemas()
    schema = getattr(COMMANDS[name], name.capitalize(), None)
    if schema is not None:
        ConfigStore.instance().store(name=f"{name}_schema", node=schema)
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        yield compose(PRIMARY.get(name, name), words)


def fields_of(name: str) -> list[str]:
    """Return the paths of all settings of a command."""

    def leaves(node: Any, path: str) -> Iterator[str]:
        if path:
            yield path
        if isinstance(node, dict):
            for key, value in node.items():
                yield from leaves(value, f"{path}.{key}" if path else str(key))

    with composed(name, []) as config:
        return list(leaves(OmegaConf.to_container(config), ""))
