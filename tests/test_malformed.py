"""Malformed files and settings are read, or refused in one line that names the file.

Hypothesis damages valid ones. `make malformed` tries 10,000, `make test` a few.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import gzip
import hashlib
import io
import json
import logging
import pickle
import re
import resource
import shutil
import signal
import struct
import sys
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import onnx
import pytest
from hydra.core.global_hydra import GlobalHydra
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy
from PIL import Image

from mrsan import ConfigurationError, Scenario
from mrsan.maps import MapError, read_map
from mrsan.prediction import SHIPPED, find_predictor
from mrsan.recording import RecordingError, load_recording
from samarl.commands import bench, evaluate, report, train
from samarl.configuration import composed, hydra_tree, register_schemas
from samarl.evaluation.page import page
from samarl.evaluation.runner import Evaluation
from samarl.evaluation.seeds import improvements
from samarl.evaluation.summary import read_rows
from samarl.evaluation.sweep import read_cell
from samarl.files import find_folder, write_json
from samarl.policies.checkpoint import load_policy, save_policy
from samarl.prediction.learner import Learner
from samarl.prediction.training import Training
from samarl.report.curves import group_runs, read_run_folders
from samarl.report.leaderboard import ranked
from samarl.report.replays import ReplayFolder
from samarl.runtime import Driver
from samarl.training.config import TrainerConfig
from samarl.training.run import build_trainer
from samarl.training.sweep import summary
from tests.driving import driver_without_walls
from tests.learning import policy

SHARE = settings(max_examples=settings().max_examples // 8)  # of each test and kind
DATA = Path(__file__).parent / "data"
SECONDS, MEMORY = 60, 2 * 2**30  # limits of one input
WORDS = [
    *("", "null", "true", "-1", "0", "2.5", "1000000000", "1e12", "1e308", "-1e308", "1e400", "é"),
    *("1" + "0" * 400, "9" * 5000, "nan", ".nan", "inf", "-.inf", "abc", "a" * 10_000, "\x00"),
    *("'", '"', "#", "{", "}", "[1, 2]", "[[]]", "{}", "{a: 1}", "[" * 500, "[{}]", "1,5"),
    *("0x10", "1_0", "1:30", "2020-01-01", "???", "${nowhere}", "${", "${oc.env:NOWHERE}", "*a"),
    *("!!python/object/apply:os.system ['true']", "!!binary aGVsbG8=", "&a [*a]", "../x", "\t- "),
    *("(", "1,2", "range(1", "x y", "a(1)", "[1", "{a:", "1;5"),
]
VALUES = [
    *(None, True, -1, 0, 1, 2.5, 10**9, 2**63, 10**400, -(10**400), 1e308, float("nan"), "", "abc"),
    *("10", "nan", "../x", "os.system", "${nowhere}", "???", "a" * 10_000, "\U0001f600", "\udc80"),
    *([], [1, 2], [[]], {}, {"a": 1}, [-1, 0], [2**63, 2], [1.5], "F64", "I32"),
]
FOREIGN = [
    *(b"", b"\n", b"{}", b"[]", b"null", b"3", b"hello\n" * 100, bytes(1000), b"[" * 10**5),
    *(b'{"a":' * 10**5, b"9" * 5000, b"a" * 10**6, b"1 2 3 4\n" * 10**5, b"\xff\xfe\0", b"a\xfc"),
    *(pickle.dumps([1.0]), gzip.compress(b"1 2 3 4"), b"P5 15000 15000 255\n"),
    bytes.fromhex("89504e470d0a1a0a0000000d4948445200003a9800003a980800000000"),  # PNG
]
TRAINING = [
    *("policy.hidden=8", "encoder.width=8", "encoder.features=8", "trainer.threads=1"),
    *("algorithm.critic_width=8", "algorithm.critic_features=8", "trainer.rollout=4"),
    "curriculum.stages=[{worlds: 1, scenario: {humans: 2}}]",
]
COMMANDS = {  # where the work of each begins, and harmless settings
    "evaluate": (evaluate, "samarl.api.run_cases", ["agent=straight"]),
    "train": (train, "samarl.training.run.compile_ahead", [*TRAINING, "run_dir=new"]),
    "bench": (bench, "samarl.commands.bench.Parallel", ["agents=[orca]", "output=new"]),
    "report": (report, "samarl.report.build.build_site", ["agents=[orca]", "output=new"]),
}
FIELDS = [
    *(f"scenario.{field.name}" for field in dataclasses.fields(Scenario)),
    *(f"evaluation.{field.name}" for field in dataclasses.fields(Evaluation)),
    *(f"trainer.{field.name}" for field in dataclasses.fields(TrainerConfig)),
    *(
        "agent",
        "scenario",
        "plugins",
        "checkpoint",
        "agents",
        "cases",
        "curriculum.stages",
        "x",
        "",
    ),
    *("agent._target_", "agent.shield", "agent.shield.horizon", "policy", "policy.name", "encoder"),
    *("scenario.reward.arrival", "scenario.humanz", "algorithm.discount", "hydra.run.dir"),
]
ENCODINGS = ["utf-8-sig", "utf-16", "utf-16-le", "utf-32", "latin-1", "cp037"]


def damaged(content: bytes) -> SearchStrategy[bytes]:
    """A file that ends early, has wrong bytes, is of another kind or much too large."""
    index = st.integers(0, len(content) - 1)
    near = st.one_of(st.integers(0, min(100, len(content) - 1)), index)
    changes = st.dictionaries(near, st.integers(0, 255), min_size=1, max_size=8)
    return st.one_of(
        near.map(lambda end: content[:end]),
        changes.map(lambda c: bytes(c.get(k, byte) for k, byte in enumerate(content))),
        st.sampled_from([*FOREIGN, content * 2, content[::-1], content * (10**6 // len(content))]),
        st.binary(max_size=2000),
    )


def damaged_text(text: str) -> SearchStrategy[bytes]:
    """Text with wrong words or lines, in another encoding, or `damaged`."""
    pieces = re.split(r"""("[^"\n]*"|'[^'\n]*'|[\w.+-]+|\n)""", text)
    index = st.integers(0, len(pieces) - 1)
    changed = st.dictionaries(index, st.sampled_from(WORDS), max_size=3).map(
        lambda words: "".join(words.get(k, piece) for k, piece in enumerate(pieces))
    )
    return st.one_of(
        changed.map(str.encode),
        st.tuples(changed, st.sampled_from(ENCODINGS)).map(
            lambda pair: f"{pair[0]}# é".encode(pair[1], "replace")
        ),
        damaged(text.encode()),
    )


@st.composite
def damaged_tree(draw: st.DrawFn, tree: Any) -> bytes:
    """JSON with missing, unexpected or additional entries, or `damaged_text`."""
    if draw(st.integers(0, 3)) == 0:
        return draw(damaged_text(json.dumps(tree)))
    root = [json.loads(json.dumps(tree))]
    for _ in range(draw(st.integers(1, 2))):
        node, key = draw(st.sampled_from(list(_entries(root))))
        if isinstance(node, dict) and draw(st.integers(0, 5)) == 0:
            del node[key]
            key = draw(st.sampled_from(["", "stranger", "format", "name"]))
        node[key] = copy.deepcopy(draw(st.sampled_from(VALUES)))
    return json.dumps(root[0]).encode()


def _entries(tree: Any) -> Iterator[tuple[Any, Any]]:
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _entries(tree[key])


def damaged_weights(content: bytes) -> SearchStrategy[bytes]:
    """A safetensors file with a wrong header, numbers that are not finite, or `damaged`."""
    end = 8 + struct.unpack("<Q", content[:8])[0]
    header, numbers = json.loads(content[8:end]), content[end:]
    cut, number = st.integers(0, len(numbers) - 4), st.sampled_from([np.nan, np.inf, 1e38])
    return st.one_of(
        damaged_tree(header).map(lambda text: struct.pack("<Q", len(text)) + text + numbers),
        st.tuples(cut, number).map(
            lambda c: content[: end + c[0]] + struct.pack("<f", c[1]) + numbers[c[0] + 4 :]
        ),
        damaged(content),
    )


def damaged_file(path: Path, content: bytes) -> SearchStrategy[bytes]:
    """A malformed file, damaged as its kind suggests."""
    if path.suffix == ".safetensors":
        return damaged_weights(content)
    if path.suffix == ".json":
        return damaged_tree(json.loads(content))
    with contextlib.suppress(UnicodeDecodeError):
        return damaged_text(content.decode())
    return damaged(content)


def demand_one_line(load: Callable[[], Any], name: str) -> None:
    """Demand that an input is read, or refused in one line that contains `name`."""

    def stop(*_: Any) -> None:
        pytest.fail(f"it took more than {SECONDS} s")

    handler = signal.signal(signal.SIGALRM, stop)
    limits = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (used * resource.getpagesize() + MEMORY, limits[1]))
    signal.alarm(SECONDS)
    message = name
    try:
        with warnings.catch_warnings(action="ignore", category=UserWarning):
            load()
    except (ConfigurationError, MapError, RecordingError) as error:
        message = str(error)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)
        resource.setrlimit(resource.RLIMIT_AS, limits)
    assert name in message
    assert len(message.splitlines()) <= 1
    assert len(message) < 2000


Readers = dict[str, Callable[[], Any]]  # what reads each file of the current folder


def maps() -> Readers:
    room = np.full((40, 60), 205, np.uint8)
    room[5:35, 5:55] = 254
    room[10:20, 10:30] = 0
    readers: Readers = {}
    for kind in ("png", "ppm", "bmp", "tiff"):
        Image.fromarray(room).save(f"map.{kind}")
        text = (DATA / "maps/plain.yaml").read_text(encoding="utf-8")
        Path(f"{kind}.yaml").write_text(text.replace("tri.png", f"map.{kind}"), encoding="utf-8")
        readers |= dict.fromkeys((f"map.{kind}", f"{kind}.yaml"), partial(read_map, f"{kind}.yaml"))
    for name in ("metres.geojson", "z.geojson", "plan.svg", "irsim.yaml", "arena.map"):
        shutil.copy(DATA / "maps" / name, name)
        readers[name] = partial(read_map, name)
    shutil.copy(find_folder("examples") / "maps/office.yaml", "office.yaml")
    return readers | {"office.yaml": partial(read_map, "office.yaml")}


def recordings() -> Readers:
    readers: Readers = {}
    for path in sorted((DATA / "recordings").iterdir()):
        encoding = "utf-16" if path.name == "utf16.txt" else "utf-8-sig"
        lines = path.read_text(encoding=encoding).splitlines(keepends=True)
        for size in (1, 30, 300):
            copy = Path(f"{size}_{path.name}")
            copy.write_text("".join(lines[:size]), encoding="utf-8")
            readers[copy.name] = partial(load_recording, copy, None, 0.25)
    return readers


def checkpoints() -> Readers:
    save_policy(Path("policy.safetensors"), policy(encoder="gru"), "hierarchical", {})
    for ending in ("safetensors", "json"):
        shutil.copy(SHIPPED / f"recurrent.{ending}", f"predictor.{ending}")

    def predict() -> None:
        model = find_predictor("predictor.safetensors", 0.25)
        past = np.zeros((1, 2, model.history, 2), np.float32)
        model.predict(past, np.ones(past.shape[:-1], np.bool_), past[..., -1, :], 2)

    def read_weights(name: str, read: Callable[[], Any]) -> None:
        """Read weights whose card has their digest."""
        card = Path(f"{name}.json")
        content = json.loads(card.read_bytes())
        content["sha256"] = hashlib.sha256(Path(f"{name}.safetensors").read_bytes()).hexdigest()
        card.write_text(json.dumps(content), encoding="utf-8")
        read()

    read_policy = partial(load_policy, Path("policy.safetensors"))
    return {
        "policy.json": read_policy,
        "policy.safetensors": partial(read_weights, "policy", read_policy),
        "predictor.json": predict,
        "predictor.safetensors": partial(read_weights, "predictor", predict),
    }


def exported_policies() -> Readers:
    driver_without_walls(Path(), None)
    model = onnx.load("policy.onnx")
    Path("metadata.json").write_text(model.metadata_props[0].value, encoding="utf-8")

    def read_metadata() -> None:
        text = Path("metadata.json").read_text(encoding="utf-8", errors="replace")
        model.metadata_props[0].value = text
        onnx.save(model, "metadata.onnx")
        Driver.load("metadata.onnx")

    return {"policy.onnx": partial(Driver.load, "policy.onnx"), "metadata.json": read_metadata}


def training_runs() -> Readers:
    register_schemas(train_schema=train.train_schema())
    with hydra_tree():
        values = train.settings_in(composed("train", TRAINING))
    trainer = build_trainer(dataclasses.replace(values, folder=Path()), "test")
    trainer.save()
    numbers = Training(4, 2, 1, 1, 1, 3, 1, 0.1, 1.0, 0.0, 0)
    learner = Learner(numbers, {"orca": Scenario()}, Path("learner.safetensors"))
    learner.save()
    header = "steps,seconds,charts/success,validation/success_90\n"
    Path("progress.csv").write_text(header + "1000,2,0.5,0.25\n" * 5, encoding="utf-8")
    return {
        "state.safetensors": trainer.load,
        "learner.safetensors": learner.restore,
        "progress.csv": lambda: (read_run_folders([Path()]), summary(Path())),
    }


def results() -> Readers:
    table = json.loads((find_folder("results") / "table1.json").read_bytes())
    rows = [*table[:2], next(row for row in table if "training_seeds" in row)]
    stage = {"scenario": {"fov_degrees": 90.0, "layout": "circle", "crowd": "orca"}}
    card = {"provenance": {"configuration": {"curriculum": {"stages": [stage]}}}}
    write_json(Path("table.json"), rows)
    write_json(Path("row.json"), {"row": rows[0], "config": {}, "commit": "x", "agent": "y"})
    write_json(Path("card.json"), card)
    ReplayFolder(Path(), [])

    def read_table() -> None:
        if rows := read_rows(Path("table.json")):
            page("table", "", rows, improvements(rows, [rows[0]["method"]]))
            ranked(rows)

    return {
        "table.json": read_table,
        "row.json": lambda: read_cell(Path("row.json")),
        "card.json": lambda: group_runs({"card": []}, Path()),
        "index.js": lambda: ReplayFolder(Path(), ["key"]),
    }


def configurations() -> Readers:
    readers: Readers = {}
    for name in ("agent/orca", "agent/samarl", "scenario/mixed"):
        group, _, choice = name.partition("/")
        Path(group).mkdir(exist_ok=True)
        shutil.copy(find_folder("conf") / f"{name}.yaml", f"{group}/my_{choice}.yaml")
        file = f"{group}/my_{choice}.yaml"
        words = (
            [f"{group}={file}"]
            if choice == "samarl"
            else ["--config-dir=.", f"{group}=my_{choice}"]
        )
        readers[file] = partial(run_command, "evaluate", words)
    return readers


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The current folder; `../x` stays inside of pytest's."""
    folder = tmp_path_factory.mktemp("malformed") / "far" / "below"
    folder.mkdir(parents=True)
    with contextlib.chdir(folder):
        yield


@pytest.fixture(
    scope="module",
    params=[
        maps, recordings, checkpoints, exported_policies, training_runs, results, configurations
    ],
)  # fmt: skip
def readers(request: pytest.FixtureRequest, folder: None) -> Readers:
    return request.param()


@SHARE
@given(data=st.data())
def test_files(data: st.DataObject, readers: Readers) -> None:
    path = Path(data.draw(st.sampled_from(sorted(readers))))
    valid = path.read_bytes()
    companions = [(p, p.read_bytes()) for p in [path.with_suffix(".json")] if p.is_file()]
    path.write_bytes(data.draw(damaged_file(path, valid)))
    try:
        is_choice = path.parent != Path()  # its errors name settings instead
        demand_one_line(readers[path.as_posix()], "" if is_choice else path.stem)
    finally:
        for file, content in [*companions, (path, valid)]:
            file.write_bytes(content)


class Accepted(BaseException):
    """A command has accepted its input and would begin to work."""


def run_command(name: str, words: list[str]) -> None:
    """Run a command until its work begins.

    Raises:
        ConfigurationError: the command ended with an error in one line.
    """
    module, work, harmless = COMMANDS[name]
    errors = io.StringIO()
    GlobalHydra.instance().clear()
    with (
        mock.patch(work, mock.Mock(side_effect=Accepted)),
        mock.patch.object(sys, "argv", [f"samarl-{name}", *harmless, *words]),
        mock.patch.object(sys, "path", [*sys.path]),
        mock.patch.object(logging.getLogger(), "handlers", []),
        contextlib.redirect_stdout(io.StringIO()),
        contextlib.redirect_stderr(errors),
        contextlib.suppress(Accepted),
    ):
        try:
            module.main()
        except SystemExit as end:
            if end.code == 2 and errors.getvalue().startswith("error: "):
                raise ConfigurationError(errors.getvalue()) from None
            raise


@SHARE
@given(data=st.data())
def test_settings(data: st.DataObject, folder: None) -> None:
    name = data.draw(st.sampled_from(list(COMMANDS)))
    prefixes, signs = st.sampled_from(["", "", "+", "++", "~"]), st.sampled_from("=== :")
    setting = st.tuples(prefixes, st.sampled_from(FIELDS), signs, st.sampled_from(WORDS))
    words = data.draw(st.lists(setting.map("".join), min_size=1, max_size=2))
    demand_one_line(lambda: run_command(name, words), "")
