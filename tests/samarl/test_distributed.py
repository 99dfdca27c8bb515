"""Training in several processes: equal to one process, stopped, killed and resumed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.nn import Parameter
from torch.utils._pytree import tree_map

from mrsan import Scenario
from samarl.commands.train import main
from samarl.distributed import (
    all_gather_cat,
    all_gather_object,
    average_gradients,
    init_process_group,
)
from samarl.launch import rank
from samarl.policies.card import LAST
from samarl.rollout import Rollout
from samarl.training.curriculum import CurriculumStage
from samarl.training.run_dir import STATE, read_progress
from samarl.training.trainer import Trainer
from tests.commands import run_module
from tests.learning import (
    PPO_NUMBERS,
    SOFT_NUMBERS,
    VALUE_NUMBERS,
    algorithm,
    collector,
    policy,
    policy_numbers,
    trainer_config,
)

# Children are forked from a process that has imported everything and done nothing.
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(["samarl.commands.train", "samarl.training.trainer", __name__])


def start(folder: Path, work: Callable[..., None], *arguments: Any) -> list[BaseProcess]:
    """Start two processes of one training in `folder`, with their output in `RANK.{out,err}`."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    processes = []
    for number in range(2):
        environment = {
            "RANK": number,
            "WORLD_SIZE": 2,
            "MASTER_ADDR": "127.0.0.1",
            "MASTER_PORT": port,
        }
        process = CONTEXT.Process(target=child, args=(folder, environment, work, *arguments))
        process.start()
        processes.append(process)
    return processes


def child(
    folder: Path, environment: dict[str, Any], work: Callable[..., None], *arguments: Any
) -> None:
    os.environ |= {name: str(value) for name, value in environment.items()}
    os.chdir(folder)
    torch.set_num_threads(1)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for stream, name in ((sys.stdout, "out"), (sys.stderr, "err")):
        file = os.open(f"{environment['RANK']}.{name}", os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
        os.dup2(file, stream.fileno())
    work(*arguments)


def run_two(folder: Path, work: Callable[..., None], *arguments: Any) -> None:
    """Run `work` in two processes and wait for both."""
    for number, process in enumerate(start(folder, work, *arguments)):
        process.join(240)
        assert process.exitcode == 0, (folder / f"{number}.err").read_text()


def check_collectives() -> None:
    init_process_group("cpu")
    first = rank() == 0
    shared, one_sided, unused = (Parameter(torch.zeros(2)) for _ in range(3))
    shared.grad = torch.tensor([1.0, 2.0] if first else [3.0, -6.0])
    one_sided.grad = torch.tensor([4.0, 8.0]) if first else None
    average_gradients([shared, one_sided, unused])
    assert shared.grad.tolist() == [2.0, -2.0]
    assert one_sided.grad is not None
    assert one_sided.grad.tolist() == [2.0, 4.0]
    assert unused.grad is None  # optimisers skip it, as with one process
    assert all_gather_cat(torch.arange(3.0) if first else torch.tensor([7.0])).tolist() == [
        0,
        1,
        2,
        7,
    ]
    assert all_gather_object("ab"[rank()]) == ["a", "b"]


def test_gradients_are_averaged_and_values_gathered(tmp_path: Path) -> None:
    run_two(tmp_path, check_collectives)


def half(rollout: Rollout, number: int) -> Rollout:
    """Return the sequences of one of two processes."""
    s = len(rollout.steps) // 2
    which = torch.arange(number * s, (number + 1) * s)
    rows = rollout.rows(which)
    assert rollout.state is not None
    return Rollout(
        rollout.scenario,
        rollout.correlation,
        rollout.steps[which],
        rollout.frames.select(rows),
        rollout.is_init[rows],
        tree_map(lambda tensor: tensor[rows], rollout.encoder),
        rollout.state.select(rows),
        [],
        rollout.environment_steps // 2,
    )


def update(which: Callable[[Rollout], Rollout], path: str) -> None:
    """Train a policy for two epochs of one optimiser step each."""
    actor = policy("flat")
    learner = algorithm(actor, minibatches=1, epochs=2, advantage_filter_fraction=1.0)
    # No episode ends, so that the halves have equal length.
    long = Scenario(humans=2, robots=2, time_limit=50.0)
    rollout = collector(actor, worlds=6, steps=5, scenario=long).collect()
    assert not rollout.episodes
    learner.update([which(rollout)])
    torch.save({**actor.state_dict(), **learner.state_dict()}, path)


def update_with_half() -> None:
    init_process_group("cpu")
    update(lambda rollout: half(rollout, rank()), f"{rank()}.pt")


def test_two_processes_with_half_of_the_worlds_equal_one_with_all(tmp_path: Path) -> None:
    run_two(tmp_path, update_with_half)
    update(lambda rollout: rollout, str(tmp_path / "one.pt"))
    before = {**policy("flat").state_dict()}
    one, first, second = (torch.load(tmp_path / f"{name}.pt") for name in ("one", "0", "1"))
    for name, value in one.items():
        assert torch.equal(first[name], second[name]), name
        torch.testing.assert_close(first[name], value, rtol=1e-4, atol=1e-6, msg=name)
    moved = [(one[name] - value).abs().max() for name, value in before.items()]
    assert max(moved) > 1e-3  # two steps at a rate of 1e-3


FEW_EPOCHS = PPO_NUMBERS | {"target_kl": 0.01, "epochs": 3, "advantage_filter_fraction": 0.5}
LEARNERS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "mappo": (
        "flat",
        "gru",
        FEW_EPOCHS,
    ),
    "value_learning": ("lookahead", "pairwise", VALUE_NUMBERS),
    "soft_actor_critic": ("squashed", "gru", SOFT_NUMBERS),
}


def trainer(folder: str, learner: str) -> Trainer:
    name, encoder, numbers = LEARNERS[learner]
    config = trainer_config(steps=10**4, rollout=10)
    stage = CurriculumStage(6, scenario=Scenario(humans=2, robots=3, time_limit=4.0))
    return Trainer(
        Path(folder),
        config,
        policy_numbers(name, encoder),
        {"name": learner, **numbers},
        [stage],
        "test",
    )


def rounds(of: Trainer, number: int) -> None:
    of.algorithm.set_progress(of.steps_done / of.config.steps)
    for _ in range(number):
        of.round()
    of.save()
    of.run_dir.release()


def learn() -> None:
    init_process_group("cpu")
    for learner in LEARNERS:
        training = trainer(learner, learner)
        before = [value.clone() for value in training.policy.state_dict().values()]
        (collector,) = training.collectors
        rounds(training, 3)
        assert training.steps_done == 3 * 10 * 6
        policy_weights = training.policy.state_dict().values()
        weights = [*policy_weights, *training.algorithm.state_dict().values()]
        first, second = all_gather_object((weights, set(collector.world.state.case.tolist())))
        assert all(torch.equal(a, b) for a, b in zip(first[0], second[0], strict=True))
        assert any(not torch.equal(a, b) for a, b in zip(weights, before, strict=False))
        assert len(first[1] | second[1]) == 6  # all worlds have different cases
    rounds(trainer("again", "mappo"), 1)
    rounds(trainer("again", "mappo"), 2)


def test_every_algorithm_trains_in_two_processes_and_resumes_bit_for_bit(tmp_path: Path) -> None:
    run_two(tmp_path, learn)
    files = [(tmp_path / folder / LAST).read_bytes() for folder in ("mappo", "again")]
    assert files[0] == files[1]


COMMAND = [
    "samarl-train",
    "policy=flat",
    "encoder=gru",
    "encoder.width=8",
    "encoder.features=8",
    "policy.hidden=8",
    "trainer.steps=1000000",
    "trainer.rollout=4",
    "trainer.save_every=16",
    "trainer.validate_every=1000000",
    "trainer.threads=1",
    "run_dir=run",
    "curriculum.stages=[{worlds: 4, scenario: {humans: 2, robots: 2}}]",
]


def command() -> None:
    sys.argv = COMMAND
    main()


def wait_for(done: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.slow
def test_a_killed_process_ends_the_run_in_one_line_and_the_same_command_resumes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    state = tmp_path / "run" / STATE
    first, second = start(tmp_path, command)
    wait_for(state.exists)
    second.kill()
    first.join(60)
    assert first.exitcode == 2
    message = (tmp_path / "0.err").read_text()
    assert message.count("\n") == 1
    assert message.startswith("error: training stopped at step ")
    assert ": another process of the run has ended (" in message

    saved = state.stat().st_mtime_ns
    first, second = start(tmp_path, command)
    wait_for(lambda: state.stat().st_mtime_ns > saved)
    os.kill(second.pid or 0, signal.SIGTERM)  # both stop after the same round
    for process in (first, second):
        process.join(60)
        assert process.exitcode == 130
    assert (tmp_path / "0.out").read_text().startswith("resuming at step ")
    resume_command = "torchrun --nproc-per-node 2 --no-python samarl-train resume=run"
    assert (tmp_path / "0.err").read_text() == f"interrupted; resume with: {resume_command}\n"
    assert (tmp_path / "1.out").read_text() + (tmp_path / "1.err").read_text() == ""

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", COMMAND)
    with pytest.raises(SystemExit):
        main()
    error = capsys.readouterr().err
    assert error.startswith("error: run holds a run with WORLD_SIZE=2; ")
    assert error.endswith(" WORLD_SIZE=1\n")


@pytest.mark.slow
def test_a_command_starts_its_own_processes(tmp_path: Path) -> None:
    arguments = [*COMMAND[1:], "trainer.processes=2"]
    for steps in (64, 96):  # the second continues the run of the first
        words = [*arguments, f"trainer.steps={steps}"]
        done = run_module("samarl.commands.train", *words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("written to run") == 1
        assert read_progress(tmp_path / "run")["steps_done"] == steps
    assert "resuming at step 64 of 96" in done.stdout
    assert read_progress(tmp_path / "run")["world_size"] == 2
