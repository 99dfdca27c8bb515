"""Training runs that are interrupted, and checkpoints that are not what they should be."""

import gc
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from mrsan import ConfigurationError, Scenario
from samarl.agents import build_agent
from samarl.algorithms.ppo import PPO
from samarl.commands.train import main
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.policies.card import FORMAT
from samarl.policies.checkpoint import load_policy, save_policy
from samarl.policies.policy import LOCAL
from samarl.training.setup import load_initial_weights
from samarl.training.trainer import Trainer
from tests.commands import run_module
from tests.learning import policy

SMALL = [
    "curriculum.stages=[{worlds: 8, scenario: {humans: 3, humans_min: 0, robots: 2}, end: 0.5},"
    "{worlds: 8, scenario: {humans: 3, robots: 3, fov_degrees: 90}, begin: 0.5,"
    "midway_start_probability: 0.5, failure_restart_probability: 0.5, noise_correlation: 0.5}]",
    "encoder.width=8",
    "encoder=spatio_temporal",
    "encoder.heads=1",
    "encoder.history=3",
    "encoder.features=8",
    "policy.hidden=8",
    "trainer.steps=1024",
    "trainer.rollout=16",
    "trainer.save_every=128",
    "trainer.validate_every=512",
    "trainer.validation_cases=4",
    "trainer.threads=1",
    "run_dir=run",
]


def train(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    return run_module("samarl.commands.train", *overrides, cwd=folder)


def start(folder: Path, *overrides: str) -> subprocess.Popen[str]:
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "samarl.commands.train", *overrides],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heed_ctrl_c,
    )


def heed_ctrl_c() -> None:
    """Shells let what they start in the background ignore it, and its children would as well."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.slow
def test_a_killed_run_goes_on_bit_for_bit(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    whole.mkdir()
    cut.mkdir()
    done = train(whole, *SMALL)
    assert done.returncode == 0, done.stderr
    process = start(cut, *SMALL)
    deadline = time.monotonic() + 240
    while not (cut / "run/state.safetensors").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    copy = tmp_path / "copy"
    shutil.copytree(cut, copy)
    for folder, words in ((cut, SMALL), (copy, ["resume=run"])):
        done = train(folder, *words)
        assert done.returncode == 0, done.stderr
        assert re.search(r"at step \d+ of \d+", done.stdout)
        for which in ("last", "best"):
            name = f"run/{which}.safetensors"
            assert (whole / name).read_bytes() == (folder / name).read_bytes()
            cards = [(run_folder / name).with_suffix(".json") for run_folder in (whole, folder)]
            provenance = [json.loads(card.read_text())["provenance"] for card in cards]
            assert provenance[0]["command"] == provenance[1]["command"]
            assert provenance[0]["configuration"] == provenance[1]["configuration"]
        assert [path.name for path in folder.iterdir()] == ["run"]
    header = (cut / "run/progress.csv").read_text().splitlines()[0].split(",")
    # The curves agree in everything but the time it took.
    curves = [
        [line.split(",")[:1] + line.split(",")[4:] for line in file.read_text().splitlines()]
        for file in (whole / "run/progress.csv", cut / "run/progress.csv")
    ]
    assert curves[0] == curves[1]
    assert len(curves[0]) == 1 + 1024 // 128
    assert not list((cut / "run").glob("*.part"))
    # Validation is on what the curriculum ends with; TensorBoard has every point of the curve once.
    assert [name for name in header if "success_" in name] == ["validation/success_90_3h_3r"]
    events = EventAccumulator(str(cut / "run/tensorboard")).Reload()
    assert [event.step for event in events.Scalars("charts/success")] == list(range(128, 1025, 128))

    done = train(whole, "resume=run", "trainer.steps=1152")  # a finished run may go on
    assert done.returncode == 0, done.stderr
    assert "at step 1024 of 1152" in done.stdout

    done = train(cut, *SMALL, "algorithm.epochs=3")  # another run may not go on in this folder
    assert done.returncode == 2
    assert re.match(r"error: algorithm\.epochs .*3", done.stderr)
    assert "resume=run" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_saves_and_says_so_in_one_line(how: signal.Signals, tmp_path: Path) -> None:
    process = start(tmp_path, *SMALL, "trainer.steps=1000000", "trainer.save_every=1000000")
    curve = tmp_path / "run/tensorboard"
    deadline = time.monotonic() + 240
    while not curve.exists() or not list(curve.iterdir()):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    time.sleep(1.0)  # some rounds
    process.send_signal(how)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.splitlines()[-1] == "interrupted; resume with: samarl-train resume=run"
    assert (tmp_path / "run/state.safetensors").exists()
    assert (tmp_path / "run/last.safetensors").exists()


def test_a_run_stopped_within_a_round_goes_on_bit_for_bit(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    prepare, calls = PPO.prepare, []

    def stopped(self: PPO, *arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return prepare(self, *arguments)

    for name, replacement in (("whole", prepare), ("cut", stopped)):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        monkeypatch.setattr(PPO, "prepare", replacement)
        monkeypatch.setattr(sys, "argv", ["samarl-train", *SMALL, "trainer.steps=512"])
        if name == "cut":
            with pytest.raises(SystemExit) as left:
                main()
            assert left.value.code == 130
            assert Path("run/progress.csv").read_text(encoding="utf-8").count("\n") == 1 + 3
            del left  # and with it the trainer, which has the folder to itself
            gc.collect()
        main()
    weights = [tmp_path / name / "run/last.safetensors" for name in ("whole", "cut")]
    assert weights[0].read_bytes() == weights[1].read_bytes()


def test_a_loss_that_is_not_finite_stops_the_run_and_names_the_last_good_state(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    prepare, calls = PPO.prepare, []

    def poisoned(self: PPO, *arguments: Any) -> Any:
        calls.append(arguments)
        (data,) = prepare(self, *arguments)
        if len(calls) == 3:
            data.levels[LOCAL]["advantage"] *= float("nan")
        return [data]

    monkeypatch.setattr(PPO, "prepare", poisoned)
    monkeypatch.setattr(sys, "argv", ["samarl-train", *SMALL])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert re.match(r"error: .*step 256.*gradient.*actor", last)
    saved_policy, _ = load_policy(Path("run/last.safetensors"))
    assert all(torch.isfinite(value).all() for value in saved_policy.state_dict().values())


def saved(tmp_path: Path) -> Path:
    path = tmp_path / "policy.safetensors"
    save_policy(path, policy(), "hierarchical", {"command": "test"})
    return path


def learned(path: Path) -> dict[str, str]:
    return {"_target_": "samarl.agents.learned.Learned", "checkpoint": str(path)}


def test_a_saved_policy_drives_as_the_one_that_was_saved(tmp_path: Path) -> None:
    path = saved(tmp_path)
    loaded_policy, card = load_policy(path)
    original = policy().state_dict()
    assert all(
        torch.equal(value, original[key]) for key, value in loaded_policy.state_dict().items()
    )
    assert card.provenance == {"command": "test"}
    scenario, cases = Scenario(humans=2), Evaluation(cases=5).case_numbers()
    first = run_cases(build_agent(learned(path), scenario), scenario, cases, 5)
    again = run_cases(build_agent(learned(path), scenario), scenario, cases, 2)
    assert first.outcome.tolist() == again.outcome.tolist()


def test_a_run_begins_with_the_weights_of_a_policy_but_explores_anew(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    numbers = {"name": "spatio_temporal", "width": 8, "heads": 1, "history": 3, "features": 8}
    initial = policy(hidden=8, encoder_numbers=numbers)
    with torch.no_grad():
        initial.networks[0].heads[LOCAL].log_std.fill_(-5.0)
    save_policy(tmp_path / "first.safetensors", initial, "hierarchical", {"command": "test"})
    trainers: list[Trainer] = []
    monkeypatch.setattr(Trainer, "run", lambda trainer: trainers.append(trainer))
    monkeypatch.setattr(sys, "argv", ["samarl-train", *SMALL, "init_from=first.safetensors"])
    main()
    begins, weights = trainers[0].policy.state_dict(), initial.state_dict()
    anew = {f"networks.0.heads.{level}.log_std" for level in initial.levels}
    assert all(torch.equal(begins[key], weights[key]) for key in weights.keys() - anew)
    assert begins["networks.0.heads.local.log_std"].min() > -3.0
    assert trainers[0].provenance["init_from"]["command"] == "test"

    flat = policy("flat", hidden=8, encoder_numbers=numbers)
    save_policy(tmp_path / "flat.safetensors", flat, "flat", {})
    for overrides, value in {
        "init_from=flat.safetensors policy=flat policy.num_parameter_sets=3": "flat.safetensors",
        "init_from=first.safetensors policy=flat": "first.safetensors",
        "init_from=first.safetensors encoder.width=16": "first.safetensors",
        "init_from=none.safetensors": "none.safetensors",
    }.items():
        monkeypatch.setattr(
            sys, "argv", ["samarl-train", *SMALL, *overrides.split(), "run_dir=other"]
        )
        with pytest.raises(SystemExit) as stopped:
            main()
        assert stopped.value.code == 2
        errors = capsys.readouterr().err
        assert "init_from" in errors
        assert value in errors
        assert errors.count("\n") == 1


def test_a_policy_of_one_level_initialises_one_of_two_and_what_is_new_has_no_effect(
    tmp_path: Path,
) -> None:
    flat = policy("flat")
    save_policy(tmp_path / "flat.safetensors", flat, "flat", {})
    begins = policy("hierarchical")
    new = {name: value.clone() for name, value in begins.state_dict().items()}
    load_initial_weights(begins, tmp_path / "flat.safetensors")
    loaded, weights = begins.state_dict(), flat.state_dict()
    for name, value in loaded.items():
        if name not in weights or "log_std" in name:
            assert torch.equal(value, new[name])
        elif value.shape == weights[name].shape:
            assert torch.equal(value, weights[name])
        else:  # inputs of the waypoint
            known = weights[name].shape[-1]
            assert torch.equal(value[..., :known], weights[name])
            assert not value[..., known:].any()


def test_a_foreign_or_damaged_checkpoint_is_refused_in_words(tmp_path: Path) -> None:
    path = saved(tmp_path)
    card = path.with_suffix(".json")
    good, weights = card.read_text(), path.read_bytes()
    wrong_size = json.loads(good)
    wrong_size["config"]["encoder"]["width"] = 32
    for text, message in (
        (good.replace("hierarchical", "os.system"), r"policy\.name.*os\.system.*flat, hierarch"),
        (good[: len(good) // 2], r"policy\.json"),
        (json.dumps({**json.loads(good), "format": 99}), rf"format.* 99\b.* {FORMAT}\b"),
        (json.dumps(wrong_size), r"policy\.safetensors"),
    ):
        card.write_text(text)
        with pytest.raises(ConfigurationError, match=message):
            build_agent(learned(path), Scenario())
    card.write_text(good)
    path.write_bytes(weights[:-1] + b"x")
    with pytest.raises(ConfigurationError, match=r"policy\.safetensors"):
        build_agent(learned(path), Scenario())


def test_a_mistake_is_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    for words, message in (
        ("curriculum.stages=[]", r"curriculum\.stages .* 0 "),
        ("curriculum.stages=[{worlds: 1, begin: 0.7, end: 0.5}]", r"stages\[0\]\.begin .*0\.7"),
        ("policy=flat algorithm.macro_std=0.4", r"algorithm\.macro_std .*0\.4.*\bflat\b"),
        ("algorithm.local_discount=0.9", r"algorithm\.local_discount .*algorithm\.discount\b"),
        ("resume=nowhere algorithm.epochs=3", r"resume .*algorithm\.epochs"),
    ):
        arguments = [words] if words.startswith("curriculum") else words.split()
        monkeypatch.setattr(sys, "argv", ["samarl-train", *arguments])
        with pytest.raises(SystemExit) as stopped:
            main()
        errors = capsys.readouterr().err
        assert stopped.value.code == 2
        assert re.search(message, errors)
        assert errors.count("\n") == 1


def test_without_its_waypoints_it_drives_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    save_policy(path, policy(gain=100.0), "hierarchical", {})
    scenario, cases = Scenario(humans=2), Evaluation(cases=3).case_numbers()
    with_waypoints = run_cases(build_agent(learned(path), scenario), scenario, cases, 3)
    for plan in ("first", "random", "shuffled"):
        agent = build_agent({**learned(path), "waypoints": plan}, scenario)
        without = run_cases(agent, scenario, cases, 3)
        assert (without.path_length != with_waypoints.path_length).any()
