"""Step worlds for an hour: `python -m benchmarks.soak --world-steps 1000000000 --worlds 4096`.

The actions are random. The invariants must hold after every step, and the memory of the process
must not grow after its warm-up. The worlds are saved every minute; the same command resumes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save
from tqdm import tqdm

from benchmarks.workload import (
    RandomStepper,
    add_output,
    interruptible,
    positive_whole_number,
    provenance,
)
from mrsan import ConfigurationError, Step, World
from mrsan.state import State
from samarl.files import atomic_write, check_writable, code_version, write_json
from samarl.progress import progress_bar

LARGEST_GROWTH = 20.0  # of the memory of one process, MB
SAVE_SECONDS = 60.0

_WARM_UP_SECONDS = 10.0  # of every process; its memory is compared only afterwards
_WINDOW = 0.1  # fraction of the memory samples whose median is compared, first with last
_SAMPLE_SECONDS = 1.0
_TOLERANCE = 1e-4  # for rounding in float32


class Soak:
    """Steps worlds with random actions, checks them and saves their state to a file.

    The state after a number of steps is the same bit for bit, whether the run was interrupted or
    not.
    """

    def __init__(self, worlds: int, path: Path) -> None:
        """Start, or resume from the file `path` if it exists.

        Raises:
            ConfigurationError: the file is not a saved run of this number of worlds.
        """
        self.path = path
        self.stepper = RandomStepper(worlds)
        self.episodes = 0
        self.seconds = 0.0
        self.processes: list[dict[str, float]] = []  # duration and memory of each
        self.commits = [code_version()]
        self.failure: str | None = None
        self._memory: list[float] = []
        if path.is_file():
            self._restore(worlds)
        self._before_this_process = self.processes, self.seconds
        self._start = time.perf_counter()

    @property
    def world_steps(self) -> int:
        """The steps of all worlds together."""
        return self.stepper.steps * self.stepper.world.worlds

    def run(self, world_steps: int) -> None:
        """Step until `world_steps` are reached or a check fails, and save regularly."""
        self.save()
        with progress_bar(
            total=world_steps, initial=self.world_steps, desc="soak", unit="step", unit_scale=True
        ) as bar:
            while self.world_steps < world_steps and self.failure is None:
                step = self.stepper.step()
                self.episodes += 0 if step.finished is None else len(step.finished.case)
                if violation := first_violation(self.stepper.world, step):
                    self.failure = f"{violation}, after step {self.stepper.steps}"
                bar.update(self.world_steps - bar.n)
                self._sample_and_save(bar)
        self._update_process()

    def save(self) -> None:
        """Write the file atomically."""
        self._update_process()
        names = ("episodes", "seconds", "processes", "commits")
        progress = {name: getattr(self, name) for name in names}
        progress["steps"] = self.stepper.steps
        state = self.stepper.world.state._asdict()
        with atomic_write(self.path) as part:
            part.write_bytes(save(state, {"progress": json.dumps(progress)}))
        self._saved = time.perf_counter()

    def digest(self) -> str:
        """Return the SHA-256 digest of the state of all worlds."""
        digest = hashlib.sha256()
        for array in self.stepper.world.state:
            digest.update(array.tobytes())
        return digest.hexdigest()

    def _sample_and_save(self, bar: tqdm) -> None:
        now = time.perf_counter()
        if now - self._start > _WARM_UP_SECONDS + _SAMPLE_SECONDS * len(self._memory):
            self._memory.append(memory_in_use())
            bar.set_postfix_str(f"{self._memory[-1]:.0f} MB", refresh=False)
        if now - self._saved > SAVE_SECONDS:
            self.save()

    def _update_process(self) -> None:
        """Update the duration and the memory of this process."""
        processes, seconds = self._before_this_process
        elapsed = time.perf_counter() - self._start
        self.seconds = round(seconds + elapsed, 1)
        process = {
            "seconds": round(elapsed, 1),
            **_memory_growth(self._memory or [memory_in_use()]),
        }
        self.processes = [*processes, process]
        if process["growth_mb"] > LARGEST_GROWTH and self.failure is None:
            self.failure = (
                f"memory grew by {process['growth_mb']} MB; it may grow by {LARGEST_GROWTH:g} MB"
            )

    def _restore(self, worlds: int) -> None:
        try:
            with safe_open(self.path, "np") as file:
                progress = json.loads(file.metadata()["progress"])
                state = State(*(file.get_tensor(name) for name in State._fields))
            self.stepper.world.restore(state)
            self.stepper.steps = progress.pop("steps")
        except (SafetensorError, TypeError, KeyError, ValueError) as error:
            raise ConfigurationError(
                f"{self.path} is not a saved run of {worlds} worlds; remove it to start again "
                f"({error})"
            ) from error
        self.commits = sorted({*self.commits, *progress.pop("commits")})
        vars(self).update(progress)


def main() -> None:
    """Run, print and write the result; exit with code 1 if a check failed."""
    arguments = _parse()
    try:
        check_writable(arguments.output, "--output")
        with interruptible():
            result = _run(arguments)
            write_json(arguments.output, result)
    except (ConfigurationError, OSError) as error:
        sys.exit(f"error: {error}")
    print(
        f"{result['world_steps']:,} steps of {result['worlds']:,} worlds together "
        f"({result['world_steps_per_second']:,} per second), {result['episodes']:,} episodes, "
        f"{len(result['processes'])} processes\n"
        f"memory growth: at most {result['growth_mb']:+} MB in one process "
        f"(limit: {LARGEST_GROWTH:+g} MB)\n"
        f"written to {arguments.output}"
    )
    if result["failure"] is not None:
        sys.exit(f"error: {result['failure']}")


def _run(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run to the end and return the result that is written to the JSON file."""
    soak = Soak(arguments.worlds, arguments.state)
    if soak.world_steps:
        print(f"resuming at {soak.world_steps:,} world-steps")
    try:
        soak.run(arguments.world_steps)
    except KeyboardInterrupt:
        # Do not save here, because a step may be incomplete.
        raise KeyboardInterrupt("run the same command to resume") from None
    arguments.state.unlink()
    return {
        "failure": soak.failure,
        "world_steps": soak.world_steps,
        "worlds": arguments.worlds,
        "episodes": soak.episodes,
        "seconds": soak.seconds,
        "world_steps_per_second": round(soak.world_steps / max(soak.seconds, 1e-9)),
        "invariants": list(INVARIANTS),
        "violations": 0 if soak.failure is None else 1,
        "growth_mb": max(process["growth_mb"] for process in soak.processes),
        "processes": soak.processes,
        "state_sha256": soak.digest(),
        **provenance("soak"),
        "commit": ", ".join(soak.commits),
    }


def first_violation(world: World, step: Step) -> str | None:
    """Return the first of `INVARIANTS` that a step violates, with details, or None."""
    for name, violation in INVARIANTS.items():
        if details := violation(world, step):
            return f"violated: {name} ({details})"
    return None


def _nan(world: World, step: Step) -> str | None:
    """Return the name of the first array that contains NaN, or None."""
    arrays = {
        **{f"state.{name}": array for name, array in world.state._asdict().items()},
        **{f"observation.{name}": array for name, array in step.observation._asdict().items()},
        "reward": step.reward,
    }
    for name, array in arrays.items():
        # One pass without a temporary array: a sum is NaN if an element is (or inf - inf).
        if array.dtype.kind == "f" and np.isnan(array.sum()) and np.isnan(array).any():
            return name
    return None


def _exceeds_time_limit(world: World, step: Step) -> str | None:
    clock = int(world.state.clock.max())
    return f"step {clock} of an episode" if clock > world.scenario.time_limit_steps else None


def _has_ended(world: World, step: Step) -> str | None:
    return f"world {np.flatnonzero(world.state.done)[0]}" if world.state.done.any() else None


def _exceeds_speed(world: World, step: Step) -> str | None:
    x, y = np.moveaxis(world.state.robot_velocity, -1, 0)
    fastest = float(np.sqrt((x * x + y * y).max()))
    return f"{fastest} m/s" if fastest > world.scenario.robot_speed + _TOLERANCE else None


def _exceeds_reward_parts(world: World, step: Step) -> str | None:
    difference = float(np.abs(sum(step.reward_parts) - step.reward).max())
    return f"it differs by {difference}" if difference > _TOLERANCE else None


INVARIANTS = {
    "no number is NaN": _nan,
    "no episode is longer than the time limit": _exceeds_time_limit,
    "a world that has ended is reset": _has_ended,
    "no robot exceeds its maximum speed": _exceeds_speed,
    "the reward is the sum of its parts": _exceeds_reward_parts,
}


def _memory_growth(memory: list[float]) -> dict[str, float]:
    """Return the memory after the warm-up and now, and its growth, MB."""
    count = max(1, round(_WINDOW * len(memory)))
    start, end = statistics.median(memory[:count]), statistics.median(memory[-count:])
    growth = {"start_mb": start, "end_mb": end, "growth_mb": end - start}
    return {name: round(value, 1) for name, value in growth.items()}


def memory_in_use() -> float:
    """Return the resident memory of this process, MB, or its peak where only that is available."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.soak",
        description="Step many worlds with random actions for an hour; fail if an invariant is "
        "violated or memory grows. The same command resumes an interrupted run.",
    )
    parser.add_argument(
        "--world-steps",
        type=positive_whole_number,
        default=10**9,
        help="steps of all worlds together (default: 1000000000)",
    )
    parser.add_argument(
        "--worlds",
        type=positive_whole_number,
        default=4096,
        help="number of worlds (default: 4096)",
    )
    parser.add_argument(
        "--state",
        type=Path,
        default=Path("outputs/soak.safetensors"),
        help="file that stores the worlds until the run ends (default: outputs/soak.safetensors)",
    )
    add_output(parser, "soak")
    return parser.parse_args()


if __name__ == "__main__":
    main()
