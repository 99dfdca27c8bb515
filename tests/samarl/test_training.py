"""Training runs that are interrupted, and checkpoints that are not what they should be."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from samarl.training.loop import Trainer
from samarl.training.rollout import Batch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from mrsan import ConfigurationError, Scenario
from samarl.agents import build_agent
from samarl.algorithms.mappo import Learner
from samarl.commands.train import main
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.policies.checkpoint import load_policy, save_policy
from samarl.policies.hierarchical import Architecture, HierarchicalPolicy

ARCHITECTURE = Architecture(
    actors=1, width=8, heads=1, history=3, features=8, hidden=8, macro_steps=4,
    levels=2, round_below=180.0, round_radius=7.0, waypoint_ahead=2.0, waypoint_range=2.0,
    track_steps=4,
)  # fmt: skip
SMALL = [
    "groups=[{worlds: 8, scenario: {humans: 3, humans_min: 0, robots: 2}, end: 0.5}, {worlds: 8,"
    "scenario: {humans: 3, robots: 3, fov_degrees: 90}, begin: 0.5, begun_share: 0.5,"
    "retried_share: 0.5, noise_correlation: 0.5}]",
    "architecture.width=8", "architecture.heads=1", "architecture.history=3",
    "architecture.features=8", "architecture.hidden=8", "training.steps=1024",
    "training.rollout=16", "training.save_every=128", "training.validate_every=512",
    "training.validation_cases=4", "training.threads=1", "folder=run",
]  # fmt: skip


def start(folder: Path, *more: str) -> subprocess.Popen[str]:
    return start_with(folder, *SMALL, *more)


def start_with(folder: Path, *overrides: str) -> subprocess.Popen[str]:
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "samarl.commands.train", *overrides], cwd=folder, env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed_ctrl_c,
    )  # fmt: skip


def heed_ctrl_c() -> None:
    """Shells let what they start in the background ignore it, and its children would as well."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_a_killed_run_goes_on_bit_for_bit(tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    whole.mkdir()
    cut.mkdir()
    process = start(whole)
    assert process.wait(timeout=240) == 0, process.stderr and process.stderr.read()
    process = start(cut)
    deadline = time.monotonic() + 240
    while not (cut / "run/state.safetensors").exists():
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    copy = tmp_path / "copy"
    shutil.copytree(cut, copy)
    for folder, process in ((cut, start(cut)), (copy, start_with(copy, "resume=run"))):
        said, errors = process.communicate(timeout=240)
        assert process.returncode == 0, errors
        assert "going on at step" in said
        for policy in ("last", "best"):
            name = f"run/{policy}.safetensors"
            assert (whole / name).read_bytes() == (folder / name).read_bytes()
            cards = [(made / name).with_suffix(".json") for made in (whole, folder)]
            commands = [json.loads(card.read_text())["made"]["command"] for card in cards]
            assert commands[0] == commands[1]
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

    process = start(cut, "mappo.epochs=3")  # another run may not go on in this folder
    _, errors = process.communicate(timeout=240)
    assert process.returncode == 2
    assert "another configuration" in errors
    assert "resume=run" in errors
    assert errors.count("\n") == 1


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["resume=nowhere"], "resume is 'nowhere'; it must be the folder of a run, which holds"),
        (["resume=nowhere", "mappo.epochs=3"], "beside mappo.epochs=3; a run goes on with its own"),
    ],
)
def test_what_cannot_be_gone_on_with_is_said(
    overrides: list[str], message: str, tmp_path: Path
) -> None:
    process = start_with(tmp_path, *overrides)
    _, errors = process.communicate(timeout=240)
    assert process.returncode == 2
    assert message in errors
    assert errors.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_saves_and_says_so_in_one_line(how: signal.Signals, tmp_path: Path) -> None:
    process = start(tmp_path, "training.steps=1000000", "training.save_every=1000000")
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
    assert errors == "interrupted\n"
    assert (tmp_path / "run/state.safetensors").exists()
    assert (tmp_path / "run/last.safetensors").exists()


def test_a_loss_that_is_not_finite_stops_the_run_and_names_the_last_good_state(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    prepare, calls = Learner.prepare, []

    def poisoned(self: Learner, batch: Batch) -> dict[str, torch.Tensor]:
        calls.append(batch)
        data = prepare(self, batch)
        if len(calls) == 3:
            data["local_advantage"] = data["local_advantage"] * float("nan")
        return data

    monkeypatch.setattr(Learner, "prepare", poisoned)
    monkeypatch.setattr(sys, "argv", ["samarl-train", *SMALL])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("error: training stopped at step 256: the gradient is not finite")
    assert last.endswith("the last good checkpoint is run/state.safetensors")
    policy, _ = load_policy(Path("run/last.safetensors"))
    assert all(torch.isfinite(value).all() for value in policy.state_dict().values())


def test_the_saved_policy_is_the_mean_of_the_weights_after_each_update(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    update, weights = Learner.update, []

    def watched(self: Learner, batches: list[Batch]) -> dict[str, float]:
        statistics = update(self, batches)
        weights.append({k: v.detach().clone() for k, v in self.policy.state_dict().items()})
        return statistics

    monkeypatch.setattr(Learner, "update", watched)
    small = [*SMALL, "training.steps=512", "training.averaging=0.75"]
    monkeypatch.setattr(sys, "argv", ["samarl-train", *small])
    main()
    policy, _ = load_policy(Path("run/last.safetensors"))
    assert len(weights) == 4
    for name, value in policy.state_dict().items():
        mean = weights[0][name]
        for after in weights[1:]:
            mean = 0.75 * mean + 0.25 * after[name]
        torch.testing.assert_close(value, mean)
    assert not torch.equal(mean, weights[-1][name])


def saved(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    path = tmp_path / "policy.safetensors"
    save_policy(path, HierarchicalPolicy(ARCHITECTURE, 3), "hierarchical", {"command": "test"})
    return path


def learned(path: Path) -> dict[str, str]:
    return {"_target_": "samarl.agents.learned.Learned", "checkpoint": str(path)}


def test_a_saved_policy_drives_as_the_one_that_was_saved(tmp_path: Path) -> None:
    path = saved(tmp_path)
    policy, card = load_policy(path)
    torch.manual_seed(0)
    original = HierarchicalPolicy(ARCHITECTURE, 3).state_dict()
    assert all(torch.equal(value, original[key]) for key, value in policy.state_dict().items())
    assert card.made == {"command": "test"}
    scenario, cases = Scenario(humans=2), Evaluation(cases=5).numbers()
    first = run_cases(build_agent(learned(path), scenario), scenario, cases, 5)
    again = run_cases(build_agent(learned(path), scenario), scenario, cases, 2)
    assert first.outcome.tolist() == again.outcome.tolist()


def test_a_run_begins_with_the_weights_of_a_policy_but_explores_anew(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    initial = HierarchicalPolicy(ARCHITECTURE, 3)
    with torch.no_grad():
        initial.local_actor.log_deviation.fill_(-5.0)
    save_policy(tmp_path / "first.safetensors", initial, "hierarchical", {"command": "test"})
    begun: list[Trainer] = []
    monkeypatch.setattr(Trainer, "run", lambda trainer: begun.append(trainer))
    monkeypatch.setattr(sys, "argv", ["samarl-train", *SMALL, "initial=first.safetensors"])
    main()
    begins, weights = begun[0].policy.state_dict(), initial.state_dict()
    anew = {"local_actor.log_deviation", "macro_actor.log_deviation"}
    assert all(torch.equal(begins[key], weights[key]) for key in weights.keys() - anew)
    assert begins["local_actor.log_deviation"].min() > -3.0
    assert begun[0].made["initial"]["command"] == "test"

    for wrong, message in {
        "initial=first.safetensors architecture.width=16": "initial is 'first.safetensors' with",
        "initial=none.safetensors": "initial is 'none.safetensors'; it must be a .safetensors file",
    }.items():
        monkeypatch.setattr(sys, "argv", ["samarl-train", *SMALL, *wrong.split(), "folder=other"])
        with pytest.raises(SystemExit) as stopped:
            main()
        assert stopped.value.code == 2
        assert message in capsys.readouterr().err


def test_a_foreign_or_damaged_checkpoint_is_refused_in_words(tmp_path: Path) -> None:
    path = saved(tmp_path)
    card = path.with_suffix(".json")
    good, weights = card.read_text(), path.read_bytes()

    def refused(text: str) -> None:
        with pytest.raises(ConfigurationError, match=text):
            build_agent(learned(path), Scenario())

    card.write_text(good.replace("hierarchical", "os.system"))
    refused("names 'os.system'; it must be among hierarchical")
    card.write_text(good[: len(good) // 2])
    refused("is not the card of a policy")
    card.write_text("[]")
    refused("is not the card of a policy")
    card.write_text(json.dumps({**json.loads(good), "format": 99}))
    refused("has format 99; it must be 1")
    content = json.loads(good)
    content["architecture"]["width"] = 16
    card.write_text(json.dumps(content))
    refused("does not fit its card")
    card.write_text(good)
    path.write_bytes(weights[:-1] + b"x")
    refused("is damaged")
    card.unlink()
    refused("there is no file .*json; a policy is a .safetensors file and, beside it, a .json file")
    path.unlink()
    refused("it must be a .safetensors file or one of the shipped")


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        ("[]", "groups has none for the time from 0 "),
        ("[{worlds: 1, end: 0.5}]", "groups has none for the time from 0.5 "),
        ("[{worlds: 1, begin: 0.7, end: 0.5}]", "groups[0].begin is 0.7; it must be less than"),
        ("[{worlds: 0}]", "groups[0].worlds is 0; it must be"),
    ],
)
def test_a_curriculum_with_a_mistake_is_refused(
    groups: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["samarl-train", f"groups={groups}"])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    errors = capsys.readouterr().err
    assert message in errors
    assert errors.count("\n") == 1


@pytest.mark.parametrize("plan", ["first", "random"])
def test_without_its_waypoints_it_drives_otherwise(plan: str, tmp_path: Path) -> None:
    policy = HierarchicalPolicy(ARCHITECTURE, 3)
    with torch.no_grad():  # of a new policy the mean of the actions hardly depends on anything
        for part in (policy.macro_actor, policy.local_actor):
            part.body[-1].weight.mul_(100)
    path = tmp_path / "policy.safetensors"
    save_policy(path, policy, "hierarchical", {})
    scenario, cases = Scenario(humans=2), Evaluation(cases=3).numbers()
    with_waypoints = run_cases(build_agent(learned(path), scenario), scenario, cases, 3)
    agent = build_agent({**learned(path), "waypoints": plan}, scenario)
    without = run_cases(agent, scenario, cases, 3)
    assert (without.path_length != with_waypoints.path_length).any()
    again = run_cases(
        build_agent({**learned(path), "waypoints": plan}, scenario), scenario, cases, 3
    )
    assert (again.path_length == without.path_length).all()


def test_a_policy_for_other_robots_is_refused(tmp_path: Path) -> None:
    from mrsan import Kinematics

    with pytest.raises(ConfigurationError, match="kinematics is holonomic"):
        build_agent(learned(saved(tmp_path)), Scenario(kinematics=Kinematics.holonomic))
