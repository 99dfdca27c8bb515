"""Does it survive `kill -9`? `python -m benchmarks.kills --training 50 --sweep 50`.

A tiny training and a tiny sweep are killed at random moments and started again by the same command
until they are done, again and again. Nothing may be lost but what was done since the last save,
and what comes out must be, to the last bit, what comes out of a run that nobody disturbed.
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
from tqdm import tqdm

from benchmarks.workload import add_output, interruptible, made_by
from mrsan import ConfigurationError
from samarl.files import check_writable, write_json
from samarl.training.run_dir import BEST, LAST, RunDir

SAVE_EVERY = 32  # environment steps
TRAINING = [
    "train", "run_dir=run", "trainer.steps=640", f"trainer.save_every={SAVE_EVERY}",
    "trainer.validate_every=160", "trainer.validation_cases=2", "trainer.rollout=8",
    "trainer.threads=1", "encoder.width=8", "encoder.heads=1", "encoder.history=3",
    "encoder.features=8", "policy.hidden=8",
    "curriculum.stages=[{worlds: 2, scenario: {humans: 3, humans_min: 0, robots: 2}, end: 0.5},"
    "{worlds: 2, scenario: {humans: 3, robots: 3, fov_degrees: 90}, begin: 0.5,"
    "midway_start_probability: 0.5, failure_restart_probability: 0.5, noise_correlation: 0.5}]",
]  # fmt: skip
SWEEP = [
    "evaluate", "-m", "agent=straight,orca,perimeter", "scenario.robots=1,2,3,4",
    "scenario.humans=2,5", "evaluation.cases=10", "hydra.sweep.dir=sweep",
]  # fmt: skip
TIMED = ("seconds", "charts/steps_per_second", "charts/collect_share")  # never the same twice


class LostError(Exception):
    """Something that was saved is gone, or is not what it was."""


class Training:
    """A training with its folder."""

    command = TRAINING

    def __init__(self, folder: Path) -> None:
        """Nothing has been saved yet."""
        self.folder, self.saved = folder, 0

    @property
    def begun(self) -> bool:
        """Something is saved."""
        return (self.folder / "run/state.safetensors").exists()

    def look(self, said: str) -> None:
        """After a kill: the state is whole and no step is lost but those since the last save."""
        steps = 0
        if self.begun:
            run = RunDir(self.folder / "run")
            steps = int(run.load()[1]["steps_done"])
            run.release()
        told = [int(number) for number in re.findall(r"^step (\d+),", said, re.MULTILINE)]
        if steps < max([self.saved, *(number - SAVE_EVERY for number in told)]):
            raise LostError(f"step {steps} is saved; it was {self.saved}, and {told} were reached")
        begun = re.findall(r"resuming at step (\d+)", said)
        if begun and int(begun[0]) != self.saved:
            raise LostError(f"it went on at step {begun[0]}; {self.saved} was saved")
        self.saved = steps

    def made(self) -> dict[str, Any]:
        """What came out: policies to the last bit, the curve without times."""
        run = self.folder / "run"
        with (run / "progress.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        curve = [{key: row[key] for key in row if key not in TIMED} for row in rows]
        events = EventAccumulator(str(run / "tensorboard")).Reload().Scalars("charts/success")
        points = [(event.step, event.value) for event in events]  # each once
        policies = {name: (run / name).read_bytes() for name in (LAST, BEST)}
        return {"curve": curve, "tensorboard": points, **policies}


class Sweep:
    """A sweep with its folder."""

    command = SWEEP

    def __init__(self, folder: Path) -> None:
        """No cell has been played yet."""
        self.folder = folder
        self.cells: dict[Path, tuple[int, bytes]] = {}  # when each was written, and what

    @property
    def begun(self) -> bool:
        """Something is saved."""
        return any((self.folder / "sweep").glob("*/row.json"))

    def look(self, said: str) -> None:
        """After a kill: finished cells are as they were, and were not played again."""
        found = {
            path: (path.stat().st_mtime_ns, path.read_bytes())
            for path in (self.folder / "sweep").glob("*/row.json")
        }
        for path, before in self.cells.items():
            if found.get(path) != before:
                raise LostError(f"{path.parent.name} was played again, or is gone")
        for path in (*found, *(self.folder / "sweep").glob("table.json")):
            json.loads(path.read_text())
        self.cells = found

    def made(self) -> dict[str, Any]:
        """What came out: the table, and the episodes of every cell."""
        sweep = self.folder / "sweep"
        tables = [sweep / "table.json", sweep / "table.md", *sweep.glob("*/episodes.jsonl")]
        return {str(path.relative_to(sweep)): path.read_bytes() for path in sorted(tables)}


def start(task: Training | Sweep) -> tuple[subprocess.Popen[bytes], Path]:
    """Start a task, or go on with it; the process, and the file of what it says."""
    name, *words = task.command
    log = task.folder / "log"
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    with log.open("wb") as file:
        return subprocess.Popen(
            [sys.executable, "-m", f"samarl.commands.{name}", *words],
            cwd=task.folder, stdout=file, stderr=file, env=environment,
        ), log  # fmt: skip


def undisturbed(task: Training | Sweep) -> tuple[float, float]:
    """Run to the end; after how many seconds something was saved, and it was over."""
    begin, first = time.perf_counter(), 0.0
    process, log = start(task)
    while process.poll() is None:
        if not first and task.begun:
            first = time.perf_counter() - begin
        time.sleep(0.01)
    _check(process, log)
    return first, time.perf_counter() - begin


def ends_before(task: Training | Sweep, seconds: float) -> bool:
    """Start it and kill it after so many seconds, unless it has ended before."""
    process, log = start(task)
    try:
        process.wait(seconds)
        _check(process, log)
        return True
    except subprocess.TimeoutExpired:
        return False
    finally:
        process.kill()
        process.wait()
        task.look(log.read_text(errors="replace"))


def _check(process: subprocess.Popen[bytes], log: Path) -> None:
    if process.returncode != 0:
        raise LostError(f"exit code {process.returncode}: {log.read_text()[-1000:]}")


def torment(kind: type[Training] | type[Sweep], kills: int, r: random.Random) -> dict[str, Any]:
    """Kill so many times, and compare what comes out in the end.

    Raises:
        LostError: says what was lost.
    """
    counts = {"kills": 0, "before_a_save": 0, "while_writing": 0, "finished": 0}
    with tempfile.TemporaryDirectory() as name:
        for folder in ("compiling", "calm"):  # what compiles takes longer
            calm = kind(Path(name) / folder)
            calm.folder.mkdir()
            first, over = undisturbed(calm)
        expected = calm.made()
        bar = tqdm(total=kills, desc=kind.__name__.lower(), unit="kill", disable=None)
        while counts["kills"] < kills or not counts["finished"]:
            task = kind(Path(name) / str(counts["finished"]))
            task.folder.mkdir()
            done, starts = False, 0
            while not done:
                # One of four at any moment, the others while something may be lost.
                earliest = 0.0 if r.random() < 0.25 else 0.9 * first
                enough = counts["kills"] >= kills
                begin, starts = time.perf_counter(), starts + 1
                done = ends_before(task, 600.0 if enough else r.uniform(earliest, over))
                if done and starts == 1:  # undisturbed as well: how fast the machine is now
                    took = time.perf_counter() - begin
                    first, over = first * took / over, took
                if not done:
                    counts["kills"] += 1
                    counts["before_a_save"] += not task.begun
                    counts["while_writing"] += any(task.folder.rglob("*.part"))
                    bar.update()
            made = task.made()
            differ = [key for key in made.keys() | expected.keys()
                      if made.get(key) != expected.get(key)]  # fmt: skip
            if differ or any(task.folder.rglob("*.part")):
                raise LostError(f"not as in an undisturbed run: {differ or 'unfinished files'}")
            counts["finished"] += 1
        bar.close()
    return counts | {"undisturbed_seconds": round(over, 1)}


def main() -> None:
    """Kill, print and write what came of it; exit code 1 if anything was lost."""
    arguments = _parse()
    begin = time.perf_counter()
    result: dict[str, Any] = {}
    try:
        check_writable(arguments.output, "--output")
        with interruptible():
            r = random.Random(arguments.seed)
            result["training"] = torment(Training, arguments.training, r)
            result["sweep"] = torment(Sweep, arguments.sweep, r)
    except (ConfigurationError, LostError) as error:
        sys.exit(f"error: {error}")
    result |= {
        "seconds": round(time.perf_counter() - begin, 1),
        **made_by("kills"),
    }
    for name in ("training", "sweep"):
        print(f"{name}:", ", ".join(f"{what} {of}" for what, of in result[name].items()))
    write_json(arguments.output, result)
    print(f"written to {arguments.output}")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.kills",
        description="Kill a training and a sweep at random moments; fail if anything is lost.",
    )
    for name in ("training", "sweep"):
        parser.add_argument(
            f"--{name}", type=int, default=50, help=f"kills of the {name} (default: 50)"
        )
    parser.add_argument("--seed", type=int, default=0, help="of the moments (default: 0)")
    add_output(parser, "kills")
    return parser.parse_args()


if __name__ == "__main__":
    main()
