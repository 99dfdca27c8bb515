"""Kill runs with `kill -9` and resume them: `python -m benchmarks.kills --training 50 --sweep 50`.

A tiny training and a tiny sweep are repeatedly killed at random moments and restarted by the same
command until they finish. Only the work since the last save may be lost, and the final output must
equal that of an uninterrupted run bit for bit.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tensorboard.backend.event_processing.event_accumulator import (  # type: ignore[import-untyped]
    EventAccumulator,
)

from benchmarks.workload import add_output, interruptible, provenance
from mrsan import ConfigurationError
from samarl.files import check_writable, write_json
from samarl.policies.card import BEST, LAST
from samarl.progress import progress_bar
from samarl.training.run_dir import RunDir

SAVE_EVERY = 32  # environment steps
TRAINING = [
    "train",
    "run_dir=run",
    "trainer.steps=640",
    f"trainer.save_every={SAVE_EVERY}",
    "trainer.validate_every=160",
    "trainer.validation_cases=2",
    "trainer.rollout=8",
    "trainer.threads=1",
    "encoder.width=8",
    "encoder=spatio_temporal",
    "encoder.heads=1",
    "encoder.history=3",
    "encoder.features=8",
    "policy.hidden=8",
    "curriculum.stages=[{worlds: 2, scenario: {humans: 3, humans_min: 0, robots: 2}, end: 0.5},"
    "{worlds: 2, scenario: {humans: 3, robots: 3, fov_degrees: 90}, begin: 0.5,"
    "midway_start_probability: 0.5, failure_restart_probability: 0.5, noise_correlation: 0.5}]",
]
SWEEP = [
    "evaluate",
    "-m",
    "agent=straight,orca,perimeter",
    "scenario.robots=1,2,3,4",
    "scenario.humans=2,5",
    "evaluation.cases=10",
    "hydra.sweep.dir=sweep",
]
TIMED = ("seconds", "charts/steps_per_second", "charts/collect_share")  # differ between runs


class DataLossError(Exception):
    """Saved data is missing or has changed."""


class Training:
    """A training run and the state that it has saved."""

    command = TRAINING

    def __init__(self, folder: Path) -> None:
        """Prepare a training run in an empty folder."""
        self.folder, self.saved_steps = folder, 0

    @property
    def has_saved_data(self) -> bool:
        """Whether a state has been saved."""
        return (self.folder / "run/state.safetensors").exists()

    def check_saved_data(self, log: str) -> None:
        """Check that the state is intact and lacks no steps but those since the last save.

        Args:
            log: the output of the process that was killed.

        Raises:
            DataLossError: steps are missing, or the process did not resume from the saved state.
        """
        steps = 0
        if self.has_saved_data:
            run = RunDir(self.folder / "run")
            steps = int(run.load()[1]["steps_done"])
            run.release()
        reported = [int(number) for number in re.findall(r"^step (\d+),", log, re.MULTILINE)]
        if steps < max([self.saved_steps, *(number - SAVE_EVERY for number in reported)]):
            raise DataLossError(
                f"the saved step is {steps}; it was {self.saved_steps} before, and the training "
                f"reported {reported}"
            )
        first_step = re.search(r"at step (\d+) of \d+", log)
        if first_step and int(first_step[1]) != self.saved_steps:
            raise DataLossError(
                f"the training resumed at step {first_step[1]}; it must resume at "
                f"{self.saved_steps}, the saved step"
            )
        self.saved_steps = steps

    def output(self) -> dict[str, Any]:
        """Return the bytes of the policies and the learning curve without times."""
        run = self.folder / "run"
        with (run / "progress.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        curve = [{key: row[key] for key in row if key not in TIMED} for row in rows]
        events = EventAccumulator(str(run / "tensorboard")).Reload().Scalars("charts/success")
        points = [(event.step, event.value) for event in events]  # no duplicates
        policies = {name: (run / name).read_bytes() for name in (LAST, BEST)}
        return {"curve": curve, "tensorboard": points, **policies}


class Sweep:
    """A sweep and the cells that it has finished."""

    command = SWEEP

    def __init__(self, folder: Path) -> None:
        """Prepare a sweep in an empty folder."""
        self.folder = folder
        self.cells: dict[Path, tuple[int, bytes]] = {}  # time of writing and content of each

    @property
    def has_saved_data(self) -> bool:
        """Whether a state has been saved."""
        return any((self.folder / "sweep").glob("*/row.json"))

    def check_saved_data(self, log: str) -> None:
        """Check that finished cells are unchanged and were not evaluated again.

        Raises:
            DataLossError: a cell is missing, has changed or was written again.
        """
        cells = {
            path: (path.stat().st_mtime_ns, path.read_bytes())
            for path in (self.folder / "sweep").glob("*/row.json")
        }
        for path, cell in self.cells.items():
            if cells.get(path) != cell:
                raise DataLossError(f"cell {path.parent.name} is missing or was evaluated again")
        for path in (*cells, *(self.folder / "sweep").glob("table.json")):
            json.loads(path.read_text(encoding="utf-8"))
        self.cells = cells

    def output(self) -> dict[str, Any]:
        """Return the bytes of the table and of the episodes of every cell."""
        sweep = self.folder / "sweep"
        tables = [sweep / "table.json", sweep / "table.md", *sweep.glob("*/episodes.jsonl")]
        return {str(path.relative_to(sweep)): path.read_bytes() for path in sorted(tables)}


def start(task: Training | Sweep) -> tuple[subprocess.Popen[bytes], Path]:
    """Start or resume a task; return the process and its log file."""
    name, *words = task.command
    log = task.folder / "log"
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with log.open("wb") as file:
        return subprocess.Popen(
            [sys.executable, "-m", f"samarl.commands.{name}", *words],
            cwd=task.folder,
            stdout=file,
            stderr=file,
            env=environment,
        ), log


def run_uninterrupted(task: Training | Sweep) -> tuple[float, float]:
    """Run a task to its end; return the seconds until its first save and until its end."""
    start_time, first_save = time.perf_counter(), 0.0
    process, log = start(task)
    while process.poll() is None:
        if not first_save and task.has_saved_data:
            first_save = time.perf_counter() - start_time
        time.sleep(0.01)
    _check_exit_code(process, log)
    return first_save, time.perf_counter() - start_time


def finishes_within(task: Training | Sweep, seconds: float) -> bool:
    """Start or resume a task, kill it after some seconds and return whether it ended before."""
    process, log = start(task)
    try:
        process.wait(seconds)
        _check_exit_code(process, log)
        return True
    except subprocess.TimeoutExpired:
        return False
    finally:
        process.kill()
        process.wait()
        task.check_saved_data(log.read_text(encoding="utf-8", errors="replace"))


def _check_exit_code(process: subprocess.Popen[bytes], log: Path) -> None:
    if process.returncode != 0:
        text = log.read_text(encoding="utf-8", errors="replace")
        raise DataLossError(f"exit code {process.returncode}: {text[-1000:]}")


def kill_repeatedly(
    kind: type[Training] | type[Sweep], kills: int, r: random.Random
) -> dict[str, Any]:
    """Kill tasks `kills` times in total and compare their final output; return the counts.

    Raises:
        DataLossError: data was lost, or the output differs from that of an uninterrupted run.
    """
    counts = {"kills": 0, "before_a_save": 0, "while_writing": 0, "finished": 0}
    with tempfile.TemporaryDirectory() as name:
        for folder in ("compiling", "reference"):  # the first run also compiles kernels
            reference = kind(Path(name) / folder)
            reference.folder.mkdir()
            first_save, duration = run_uninterrupted(reference)
        expected = reference.output()
        bar = progress_bar(total=kills, desc=kind.__name__.lower(), unit="kill")
        while counts["kills"] < kills or not counts["finished"]:
            task = kind(Path(name) / str(counts["finished"]))
            task.folder.mkdir()
            finished, starts = False, 0
            while not finished:
                # A quarter of the kills at any moment, the others when there is data to lose.
                earliest = 0.0 if r.random() < 0.25 else 0.9 * first_save
                limit = 600.0 if counts["kills"] >= kills else r.uniform(earliest, duration)
                start_time, starts = time.perf_counter(), starts + 1
                finished = finishes_within(task, limit)
                if finished and starts == 1:  # uninterrupted: update the speed of the machine
                    elapsed = time.perf_counter() - start_time
                    first_save, duration = first_save * elapsed / duration, elapsed
                if not finished:
                    counts["kills"] += 1
                    counts["before_a_save"] += not task.has_saved_data
                    counts["while_writing"] += any(task.folder.rglob("*.part"))
                    bar.update()
            output = task.output()
            differences = [
                key
                for key in output.keys() | expected.keys()
                if output.get(key) != expected.get(key)
            ]
            if differences or any(task.folder.rglob("*.part")):
                raise DataLossError(
                    "the output differs from that of an uninterrupted run: "
                    f"{differences or 'unfinished files'}"
                )
            counts["finished"] += 1
        bar.close()
    return counts | {"undisturbed_seconds": round(duration, 1)}


def main() -> None:
    """Run both tests, print and write the counts; exit with code 1 if data was lost."""
    arguments = _parse()
    start_time = time.perf_counter()
    result: dict[str, Any] = {}
    try:
        check_writable(arguments.output, "--output")
        with interruptible():
            r = random.Random(arguments.seed)
            result["training"] = kill_repeatedly(Training, arguments.training, r)
            result["sweep"] = kill_repeatedly(Sweep, arguments.sweep, r)
    except (ConfigurationError, DataLossError) as error:
        sys.exit(f"error: {error}")
    result |= {
        "seconds": round(time.perf_counter() - start_time, 1),
        **provenance("kills"),
    }
    for name in ("training", "sweep"):
        print(f"{name}:", ", ".join(f"{key} {value}" for key, value in result[name].items()))
    write_json(arguments.output, result)
    print(f"written to {arguments.output}")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.kills",
        description="Kill a training run and a sweep at random moments; fail if data is lost.",
    )
    for name in ("training", "sweep"):
        parser.add_argument(
            f"--{name}", type=int, default=50, help=f"kills of the {name} (default: 50)"
        )
    parser.add_argument("--seed", type=int, default=0, help="seed of the moments (default: 0)")
    add_output(parser, "kills")
    return parser.parse_args()


if __name__ == "__main__":
    main()
