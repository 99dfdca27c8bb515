"""Does it hold out? `python -m benchmarks.soak --minutes 10 --worlds 4096`.

Random actions for minutes on end: after every step no number may be NaN, and once warm the
process may not need more memory.
"""

from __future__ import annotations

import argparse
import resource
import shlex
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from benchmarks.workload import (
    RandomDrive,
    interruptible,
    positive_number,
    positive_whole_number,
)
from mrsan import Step, World
from samarl.files import code_version, machine, write_json

LARGEST_GROWTH = 20.0  # MB

_WARM_SHARE = 0.2  # of the time passes before memory is compared
_ENDS_SHARE = 0.1  # of the samples make the figure at the start, and as many that at the end
_SAMPLES_PER_SECOND = 10.0


def main() -> None:
    """Run, print and write what came of it; exit code 1 if it did not hold out."""
    arguments = _parse()
    with interruptible():
        result = soak(60.0 * arguments.minutes, arguments.worlds)
    print(
        f"{result['steps']:,} steps of {result['worlds']:,} worlds "
        f"({result['world_steps_per_second']:,} world-steps/s), "
        f"{result['episodes']:,} episodes\n"
        f"memory: {result['start_mb']} MB once warm, {result['end_mb']} MB at the end, "
        f"{result['growth_mb']:+} MB (at most {LARGEST_GROWTH:+g} is allowed)"
    )
    output: Path = arguments.output
    write_json(output, result)
    print(f"written to {output}")
    if result["failure"] is not None:
        print(f"error: {result['failure']}", file=sys.stderr)
        sys.exit(1)


def soak(seconds: float, worlds: int) -> dict[str, Any]:
    """Step `worlds` worlds for so long; `failure` says what went wrong, if anything did."""
    drive = RandomDrive(worlds)
    memory: list[float] = []
    steps = episodes = 0
    failure = None
    begin = time.perf_counter()
    passed = 0.0
    layout = "{l_bar}{bar}| {n:.0f}/{total:.0f} s{postfix}"
    with tqdm(total=seconds, desc="soak", bar_format=layout, disable=None) as bar:
        while passed < seconds and failure is None:
            step = drive.step()
            steps += 1
            episodes += 0 if step.finished is None else len(step.finished.case)
            if name := find_nan(drive.world, step):
                failure = f"{name} holds NaN after step {steps}"
            passed = min(time.perf_counter() - begin, seconds)
            warm = passed - _WARM_SHARE * seconds
            if warm * _SAMPLES_PER_SECOND >= len(memory):
                memory.append(memory_in_use())
                bar.set_postfix_str(f"{memory[-1]:.0f} MB")
            bar.update(passed - bar.n)
    ends = max(1, round(_ENDS_SHARE * len(memory)))
    start_mb, end_mb = (
        statistics.median(part) if part else memory_in_use()
        for part in (memory[:ends], memory[-ends:])
    )
    if failure is None and end_mb - start_mb > LARGEST_GROWTH:
        failure = f"memory grew by {end_mb - start_mb:.1f} MB; at most {LARGEST_GROWTH:g} is right"
    return {
        "failure": failure,
        "worlds": worlds,
        "seconds": round(time.perf_counter() - begin, 1),
        "steps": steps,
        "episodes": episodes,
        "world_steps_per_second": round(steps * worlds / max(passed, 1e-9)),
        "start_mb": round(start_mb, 1),
        "end_mb": round(end_mb, 1),
        "growth_mb": round(end_mb - start_mb, 1),
        "machine": machine(),
        "commit": code_version(),
        "command": shlex.join(["python", "-m", "benchmarks.soak", *sys.argv[1:]]),
    }


def find_nan(world: World, step: Step) -> str | None:
    """The first array of state, observation or reward that holds NaN."""
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


def memory_in_use() -> float:
    """Resident memory of this process in MB; where only the peak is known, the peak."""
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024**2 if sys.platform == "darwin" else 1024)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.soak",
        description="Drive many worlds at random for minutes; fail on NaN or growing memory.",
    )
    parser.add_argument(
        "--minutes", type=positive_number, default=10.0, help="how long (default: 10)"
    )
    parser.add_argument(
        "--worlds", type=positive_whole_number, default=4096, help="side by side (default: 4096)"
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("outputs/soak.json"),
        help="the JSON file to write (default: outputs/soak.json)",
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
