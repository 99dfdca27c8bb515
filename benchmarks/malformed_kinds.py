"""The kinds of malformed things, and good ones to begin with."""

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
    strange_numbers,
)
from mrsan import ConfigurationError, Scenario, World
from mrsan.prediction import SHIPPED, find_predictor
from mrsan.recording import SAMPLE, load_recording
from samarl.agents import build_agent
from samarl.commands import bench, evaluate, export, predictor, render, report, train
from samarl.configuration import first, register_schemas
from samarl.evaluation.page import page
from samarl.evaluation.regression import compare
from samarl.evaluation.summary import read_rows
from samarl.evaluation.sweep import read_cell
from samarl.files import find_folder
from samarl.policies.checkpoint import make_policy, save_policy
from samarl.prediction.learner import Learner
from samarl.prediction.training import Training
from samarl.report.figures import read_curve
from samarl.report.leaderboard import ranked

COMMANDS = {
    "evaluate": evaluate, "train": train, "predictor": predictor, "render": render,
    "report": report, "bench": bench, "export": export,
}  # fmt: skip
PRIMARY = {"evaluate": "config"}  # files in conf/ that are not named as their commands
LIGHT = {  # so that what is right by accident is soon found to be so
    "bench": ["agents=[orca]", "output=mine"],
    "report": ["agents=[orca]", "output=mine"],
    "render": ["output=mine.png"],
    "export": ["output=mine.onnx", "agent=learned", "checkpoint=policy.safetensors"],
    "predictor": ["output=mine"],
    "train": ["run_dir=mine", "encoder.width=8", "encoder.heads=1", "encoder.features=8",
              "policy.hidden=8", "curriculum.stages=[{worlds: 1}]", "trainer.threads=1"],
}  # fmt: skip
RUN = [
    "run_dir=run", "encoder.width=8", "encoder.heads=1", "encoder.history=2", "encoder.features=8",
    "policy.hidden=8", "trainer.threads=1", "trainer.rollout=4", "algorithm.critic_width=8",
    "algorithm.critic_heads=1", "algorithm.critic_features=8",
    "curriculum.stages=[{worlds: 1, scenario: {humans: 2, robots: 2}}]",
]  # fmt: skip
ENCODER = {"name": "gru", "width": 8, "features": 8}
POLICY = {
    "actors": 1, "hidden": 8, "track_time": 1.0, "round_below": 180.0, "round_radius": 7.0,
    "encoder": ENCODER,
}  # fmt: skip
VALUES = [
    "1000000000", "-1", "0", "1e308", "nan", "inf", "-inf", "abc", "''", "[1,2]", "[]", "{a: 1}",
    "null", "???", "true", "2.5", "../x", "${nowhere}", "'${'", "${oc.env:NOWHERE}",
    "1" + "0" * 400,
    "9" * 5000, "a" * 5000, "[[1,2],[3]]", "'a b'", "é", "0x10", "[{}]", "{}",
    "{worlds: 1000000000}",
    "[{worlds: 1000000000}]", "[{scenario: {humans: 1000000000}}]", "[{humans: 1000000000}]",
]  # fmt: skip


@dataclass
class Item:
    """Something malformed."""

    kind: str
    load: Callable[[], object]
    command: list[str] = field(default_factory=list)  # that loads the same
    names: tuple[str, ...] = ()  # one of which its error must name


class Accepted(BaseException):
    """A command has found nothing wrong and would begin to work."""


class Good:
    """What is right, in a folder: each malformed thing is one of them, spoiled."""

    def __init__(self, folder: Path) -> None:
        """Make all of it."""
        self.folder = folder / "far" / "down" / "below"  # `../x` stays inside
        self.folder.mkdir(parents=True)
        os.chdir(self.folder)
        self.policy = Path("policy.safetensors")
        save_policy(self.policy, make_policy("flat", POLICY, 3), "flat", {"command": "mine"})
        self.predictor = Path("predictor.safetensors")
        for ending in (".safetensors", ".json"):
            shutil.copy(SHIPPED / f"recurrent{ending}", self.predictor.with_suffix(ending))
        rows = json.loads((find_folder("results") / "table1.json").read_text())
        self.rows = [*rows[:2], next(row for row in rows if "training_seeds" in row)]
        self.cell = {"row": rows[0], "config": {}, "commit": "x", "agent": "y"}
        self.scenario = Scenario(humans=2, robots=2)
        world = World(self.scenario)
        self.observation = world.reset([0])
        with composed("train", RUN) as config:
            self.trainer = train.build_trainer(config, "mine")
        self.trainer.save()
        training = Training(4, 2, 1, 1, 1, 3, 1, 0.1, 1.0, 0.0, 0)
        self.learner = Learner(training, {"orca": Scenario()}, Path("training.safetensors"))
        self.learner.save()
        self.bytes = {
            path: path.read_bytes()
            for path in (self.policy, self.predictor, self.learner.path, self.state)
        }
        self.cards = {
            path: json.loads(path.with_suffix(".json").read_text())
            | {"provenance": {"command": "mine"}}
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
        """Of the training."""
        return self.trainer.run_dir.folder / "state.safetensors"


def spoiled_weights(r: random.Random, good: Good, path: Path) -> bytes:
    """Bytes in the place of a file of tensors."""
    spoil = r.choice([damaged_bytes, hostile_header, hostile_header, strange_numbers])
    return spoil(r, good.bytes[path])


def with_card(r: random.Random, good: Good, path: Path) -> None:
    """Spoil either a file of weights, most often with the right digest in its card, or the card."""
    content, card = good.bytes[path], dict(good.cards[path])
    if r.random() < 0.5:
        content = spoiled_weights(r, good, path)
        if r.random() < 0.8:
            card["sha256"] = hashlib.sha256(content).hexdigest()
        text = json.dumps(card).encode()
    else:
        text = damaged_json(r, card)
    path.write_bytes(content)
    path.with_suffix(".json").write_bytes(text)


def policy(r: random.Random, good: Good) -> Item:
    """A policy or its card."""
    with_card(r, good, good.policy)
    agent = {"_target_": "samarl.agents.learned.Learned", "checkpoint": str(good.policy)}

    def load() -> None:
        made = build_agent(agent, good.scenario)
        made.scope_warning(), made.version()
        made.reset(np.ones(1, np.bool_))
        made.act(good.observation)

    command = ["evaluate", "agent=samarl_flat", f"checkpoint={good.policy}", "evaluation.cases=1"]
    return Item("policy", load, command, (str(good.policy.stem),))


def predictor_file(r: random.Random, good: Good) -> Item:
    """A predictor of people or its card."""
    with_card(r, good, good.predictor)

    def load() -> None:
        found = find_predictor(str(good.predictor), 0.25)
        past = np.zeros((1, 2, found.history, 2), np.float32)
        found.predict(past, np.ones(past.shape[:-1], np.bool_), past[..., -1, :], 2)

    command = ["predictor", f"predictor={good.predictor}", "validation_cases=1"]
    return Item("predictor", load, command, (str(good.predictor.stem),))


def training_state(r: random.Random, good: Good) -> Item:
    """The state of an interrupted training."""
    good.state.write_bytes(spoiled_weights(r, good, good.state))
    return Item("training state", good.trainer.restore, ["train", "resume=run"], ("state.safe",))


def predictor_state(r: random.Random, good: Good) -> Item:
    """The state of an interrupted training of the predictor."""
    path = good.learner.path
    path.write_bytes(spoiled_weights(r, good, path))
    return Item("predictor state", good.learner.restore, names=(path.name,))


def table(r: random.Random, good: Good) -> Item:
    """A table of results."""
    path = Path("tables/table.json")
    path.write_bytes(damaged_json(r, good.rows))

    def load() -> None:
        if rows := read_rows(path):
            page("table", "", rows, [rows[0]["method"]])
            ranked(rows)
            compare(good.rows[0], rows)

    command = ["report", "results=tables", "agents=[orca]", "cases=[]", "output=pages"]
    return Item("table", load, command, (path.name,))


def cell(r: random.Random, good: Good) -> Item:
    """A finished cell of a sweep; a damaged one is none."""
    path = Path("row.json")
    path.write_bytes(damaged_json(r, good.cell))

    def load() -> None:
        if read_cell(path) is None:
            raise ConfigurationError("it is played again")

    return Item("cell of a sweep", load)


def recording(r: random.Random, good: Good) -> Item:
    """Recorded people in one of many formats, with wrong cells or damaged bytes."""
    rows = [line.split() for line in SAMPLE.read_text().splitlines()]
    header, separator, lines = r.choice(RECORDINGS)(rows[: r.choice([1, 2, 30, 300, len(rows)])])
    strange = ["nan", "inf", "-1", "1e308", "1e12", "abc", "", "1e-320", "99999999999", "{", "\x00",
               "?", "'", '"', "#", "1,5", "1;5", "9" * 5000]  # fmt: skip
    for _ in range(r.randint(0, 3)):
        number = r.randrange(len(lines))
        cells = lines[number].split(separator)
        cells[r.randrange(len(cells))] = r.choice(strange)
        lines[number] = separator.join(cells)
    content = "\n".join([*header, *lines]).encode(r.choice(["utf-8", "utf-8-sig", "utf-16"]))
    path = Path("people.txt")
    path.write_bytes(damaged_bytes(r, content) if r.random() < 0.4 else content)
    words = ["evaluate", "scenario=recorded", f"scenario.recording={path}", "evaluation.cases=1"]
    command = r.choice([words, ["recording", str(path)]])
    return Item("recording", lambda: load_recording(path, None, 0.25), command, (path.name,))


Rows = list[list[str]]  # frame, id, x and y
RECORDINGS: list[Callable[[Rows], tuple[list[str], str, list[str]]]] = [  # header, separator, lines
    lambda rows: ([], " ", [" ".join(row) for row in rows]),
    lambda rows: (["frame,id,x,y"], ",", [",".join(row) for row in rows]),
    lambda rows: ([], ";", [";".join(row).replace(".", ",") for row in rows]),
    lambda rows: (
        ["# framerate: 25", "# id frame x/m y/m"], "\t",
        [f"{p}\t{f}\t{x}\t{y}" for f, p, x, y in rows],
    ),
    lambda rows: ([], " ", [f"{f} {p} {x} 0 {y} 1 0 1" for f, p, x, y in rows]),
    lambda rows: ([], " ", [f'{p} {x} {y} {x} {y} {f} 0 0 0 "Pedestrian"' for f, p, x, y in rows]),
    lambda rows: ([], ",", [",".join(row) for row in zip(*rows, strict=True)]),
    lambda rows: (
        ['{"scene": {"id": 0, "fps": 2.5}}'], ": ",
        [f'{{"track": {{"f": {f}, "p": {p}, "x": {x}, "y": {y}}}}}' for f, p, x, y in rows],
    ),
]  # fmt: skip


def curve(r: random.Random, good: Good) -> Item:
    """A learning curve."""
    text = b"steps,seconds,charts/success\n" + b"1,2,0.5\n" * r.randint(1, 5)
    path = Path("curve.csv")
    wide = b"steps," + b"a" * 200_000 + b"\n1,2\n"
    path.write_bytes(
        r.choice([damaged_bytes(r, text), damaged_bytes(r, text), wide, text + b"1," * 9])
    )
    return Item("curve", lambda: read_curve(path), names=(path.name,))


def own_yaml(r: random.Random, good: Good) -> Item:
    """An agent's or a scenario's YAML file of one's own."""
    group = r.choice(["agent", "scenario"])
    text = good.agent if group == "agent" else "defaults: [samarl]\nhumans: 4\nfov_degrees: 90.0\n"
    (Path("conf") / group / "mine.yaml").write_bytes(damaged_yaml(r, text))
    return command_item("YAML", "evaluate", ["--config-dir=conf", f"{group}=mine"])


def overrides(r: random.Random, good: Good) -> Item:
    """A command line."""
    name = r.choice(list(COMMANDS))
    words = [
        f"{r.choice(good.fields[name])}={r.choice(VALUES)}" for _ in range(r.choice([1, 1, 2]))
    ]
    own = []
    if name == "export":
        own = ["--config-dir=conf"]
        good.policy.write_bytes(good.bytes[good.policy])
        good.policy.with_suffix(".json").write_text(json.dumps(good.cards[good.policy]))
    return command_item("command line", name, own + LIGHT.get(name, []) + words)


def resumed(r: random.Random, good: Good) -> Item:
    """The state of an interrupted training, through the command."""
    good.state.write_bytes(spoiled_weights(r, good, good.state))
    good.trainer.run_dir.release()
    return command_item("resume", "train", ["resume=run"])


THROUGH_COMMANDS = ("YAML", "command line", "resume")  # kinds that take longer
KINDS: dict[str, Callable[[random.Random, Good], Item]] = {
    "policy": policy, "predictor": predictor_file, "training state": training_state,
    "predictor state": predictor_state, "table": table, "cell of a sweep": cell,
    "recording": recording, "curve": curve, "YAML": own_yaml, "command line": overrides,
    "resume": resumed,
}  # fmt: skip


def command_item(kind: str, name: str, words: list[str]) -> Item:
    """A command line that goes through the command in this process, up to where it would work."""
    return Item(kind, lambda: call(name, words), [name, *words])


def call(name: str, words: list[str]) -> None:
    """Run a command without its work.

    Raises:
        ConfigurationError: it said so in one line.
        RuntimeError: it said anything else.
    """

    def accept(*_: Any, **__: Any) -> None:
        raise Accepted

    work = [
        "samarl.commands.evaluate.run_cases", "samarl.training.trainer.Trainer.run",
        "samarl.prediction.windows.simulate_windows", "samarl.commands.render.record_episode",
        "samarl.commands.report.record_episode", "samarl.report.build.build_site",
        "samarl.commands.bench.Parallel", "samarl.export.export_agent",
    ]  # fmt: skip
    said = io.StringIO()
    root = logging.getLogger()
    GlobalHydra.instance().clear()
    with contextlib.ExitStack() as stack:
        for target in work:
            stack.enter_context(mock.patch(target, accept))
        stack.enter_context(mock.patch.object(sys, "argv", [f"samarl-{name}", *words]))
        stack.enter_context(mock.patch.object(sys, "path", list(sys.path)))
        stack.enter_context(mock.patch.object(root, "handlers", []))
        stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
        stack.enter_context(contextlib.redirect_stderr(said))
        try:
            COMMANDS[name].main()
        except Accepted:
            return
        except SystemExit as end:
            lines = said.getvalue().splitlines()
            if end.code == 2 and len(lines) == 1 and lines[0].startswith("error: "):
                raise ConfigurationError(lines[0]) from None
            raise RuntimeError(f"exit code {end.code}: {said.getvalue()}") from None


@contextlib.contextmanager
def composed(name: str, words: list[str]) -> Iterator[DictConfig]:
    """The configuration of a command."""
    register_schemas()
    OmegaConf.register_new_resolver("first", first, replace=True)
    schema = getattr(COMMANDS[name], name.capitalize(), None)
    if schema is not None:
        ConfigStore.instance().store(name=f"{name}_schema", node=schema)
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        yield compose(PRIMARY.get(name, name), words)


def fields_of(name: str) -> list[str]:
    """The settings of a command, by their paths."""

    def leaves(node: Any, path: str) -> Iterator[str]:
        if path:
            yield path
        if isinstance(node, dict):
            for key, value in node.items():
                yield from leaves(value, f"{path}.{key}" if path else str(key))

    with composed(name, []) as config:
        return list(leaves(OmegaConf.to_container(config), ""))
