"""Does it hold out? `python -m benchmarks.soak --world-steps 1000000000 --worlds 4096`.

Random actions for an hour on end: after every step the invariants must hold, and once warm the
process may not need more memory. The worlds are saved every minute; the same command goes on.
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
    RandomDrive,
    add_output,
    interruptible,
    made_by,
    positive_whole_number,
)
from mrsan import ConfigurationError, Step, World
from mrsan.state import State
from samarl.files import atomic_write, check_writable, code_version, write_json

LARGEST_GROWTH = 20.0  # MB, of one process
SAVE_SECONDS = 60.0

_WARM_SECONDS = 10.0  # pass in every process before its memory is compared
_ENDS_SHARE = 0.1  # of the samples make the figure at the start, and as many that at the end
_SAMPLE_SECONDS = 1.0
_ROUNDING = 1e-4  # of float32


class Soak:
    """Worlds that are driven at random, what has happened to them, and the file they are kept in.

    Their state after so many steps is the same to the last bit, interrupted or not.
    """

    def __init__(self, worlds: int, path: Path) -> None:
        """Begin, or go on from the file `path`.

        Raises:
            ConfigurationError: it is no such file, or one of another number of worlds.
        """
        self.path = path
        self.drive = RandomDrive(worlds)
        self.episodes = 0
        self.seconds = 0.0
        self.processes: list[dict[str, float]] = []  # how long each ran, and its memory
        self.commits = [code_version()]
        self.failure: str | None = None
        self._memory: list[float] = []
        if path.is_file():
            self._restore(worlds)
        self._earlier = self.processes, self.seconds
        self._begin = time.perf_counter()

    @property
    def world_steps(self) -> int:
        """Steps of all worlds together."""
        return self.drive.steps * self.drive.world.worlds

    def run(self, world_steps: int) -> None:
        """Go on until there are so many, or until something is wrong; save now and then."""
        self.save()
        layout = "{l_bar}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}{postfix}]"
        with tqdm(
            total=world_steps, initial=self.world_steps, desc="soak", unit_scale=True,
            bar_format=layout, disable=None,
        ) as bar:  # fmt: skip
            while self.world_steps < world_steps and self.failure is None:
                step = self.drive.step()
                self.episodes += 0 if step.finished is None else len(step.finished.case)
                if broken := violated(self.drive.world, step):
                    self.failure = f"{broken}, after step {self.drive.steps}"
                bar.update(self.world_steps - bar.n)
                self._look_at_the_clock(bar)
        self._count()

    def save(self) -> None:
        """Write the file, whole or not at all."""
        self._count()
        names = ("episodes", "seconds", "processes", "commits")
        progress = {name: getattr(self, name) for name in names}
        progress["steps"] = self.drive.steps
        state = self.drive.world.state._asdict()
        with atomic_write(self.path) as part:
            part.write_bytes(save(state, {"progress": json.dumps(progress)}))
        self._saved = time.perf_counter()

    def digest(self) -> str:
        """Of the state of all worlds."""
        found = hashlib.sha256()
        for array in self.drive.world.state:
            found.update(array.tobytes())
        return found.hexdigest()

    def _look_at_the_clock(self, bar: tqdm) -> None:
        now = time.perf_counter()
        if now - self._begin > _WARM_SECONDS + _SAMPLE_SECONDS * len(self._memory):
            self._memory.append(memory_in_use())
            bar.set_postfix_str(f"{self._memory[-1]:.0f} MB")
        if now - self._saved > SAVE_SECONDS:
            self.save()

    def _count(self) -> None:
        """Bring the time and the memory of this process up to date."""
        before, seconds = self._earlier
        took = time.perf_counter() - self._begin
        self.seconds = round(seconds + took, 1)
        mine = {"seconds": round(took, 1), **_ends(self._memory or [memory_in_use()])}
        self.processes = [*before, mine]
        if mine["growth_mb"] > LARGEST_GROWTH and self.failure is None:
            self.failure = (
                f"memory grew by {mine['growth_mb']} MB; at most {LARGEST_GROWTH:g} is right"
            )

    def _restore(self, worlds: int) -> None:
        try:
            with safe_open(self.path, "np") as file:
                progress = json.loads(file.metadata()["progress"])
                state = State(*(file.get_tensor(name) for name in State._fields))
            self.drive.world.restore(state)
            self.drive.steps = progress.pop("steps")
        except (SafetensorError, TypeError, KeyError, ValueError) as error:
            raise ConfigurationError(
                f"{self.path} is no soak of {worlds} worlds to go on with; remove it to begin "
                f"again ({error})"
            ) from error
        self.commits = sorted({*self.commits, *progress.pop("commits")})
        vars(self).update(progress)


def main() -> None:
    """Run, print and write what came of it; exit code 1 if it did not hold out."""
    arguments = _parse()
    try:
        check_writable(arguments.output, "--output")
        with interruptible():
            result = _soaked(arguments)
            write_json(arguments.output, result)
    except (ConfigurationError, OSError) as error:
        sys.exit(f"error: {error}")
    print(
        f"{result['world_steps']:,} steps of {result['worlds']:,} worlds together "
        f"({result['world_steps_per_second']:,} per second), {result['episodes']:,} episodes, "
        f"{len(result['processes'])} processes\n"
        f"memory: at most {result['growth_mb']:+} MB in one process "
        f"({LARGEST_GROWTH:+g} is allowed)\n"
        f"written to {arguments.output}"
    )
    if result["failure"] is not None:
        sys.exit(f"error: {result['failure']}")


def _soaked(arguments: argparse.Namespace) -> dict[str, Any]:
    soak = Soak(arguments.worlds, arguments.state)
    if soak.world_steps:
        print(f"going on at {soak.world_steps:,} world-steps")
    try:
        soak.run(arguments.world_steps)
    except KeyboardInterrupt:
        # Not saved here: it may be in the middle of a step.
        raise KeyboardInterrupt("the same command goes on") from None
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
        **made_by("soak"),
        "commit": ", ".join(soak.commits),
    }


def violated(world: World, step: Step) -> str | None:
    """The first of `INVARIANTS` that does not hold after a step, and where."""
    for name, broken in INVARIANTS.items():
        if where := broken(world, step):
            return f"not true: {name} ({where})"
    return None


def _nan(world: World, step: Step) -> str | None:
    """The first array that holds NaN."""
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


def _late(world: World, step: Step) -> str | None:
    clock = int(world.state.clock.max())
    return f"step {clock} of an episode" if clock > world.scenario.time_limit_steps else None


def _ended(world: World, step: Step) -> str | None:
    return f"world {np.flatnonzero(world.state.done)[0]}" if world.state.done.any() else None


def _fast(world: World, step: Step) -> str | None:
    x, y = np.moveaxis(world.state.robot_velocity, -1, 0)
    fastest = float(np.sqrt((x * x + y * y).max()))
    return f"{fastest} m/s" if fastest > world.scenario.robot_speed + _ROUNDING else None


def _unexplained(world: World, step: Step) -> str | None:
    most = float(np.abs(sum(step.reward_parts) - step.reward).max())
    return f"it differs by {most}" if most > _ROUNDING else None


INVARIANTS = {
    "no number is NaN": _nan,
    "no episode is longer than the time limit": _late,
    "a world that has ended begins anew": _ended,
    "no robot is faster than it can be": _fast,
    "the reward is the sum of its parts": _unexplained,
}


def _ends(memory: list[float]) -> dict[str, float]:
    """Memory once warm, now, and by how much it grew, MB."""
    ends = max(1, round(_ENDS_SHARE * len(memory)))
    start, end = statistics.median(memory[:ends]), statistics.median(memory[-ends:])
    found = {"start_mb": start, "end_mb": end, "growth_mb": end - start}
    return {name: round(value, 1) for name, value in found.items()}


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
        description="Drive many worlds at random for an hour; fail on what may not be, and on "
        "growing memory. The same command goes on where it was interrupted.",
    )
    parser.add_argument(
        "--world-steps", type=positive_whole_number, default=10**9,
        help="how many, of all worlds together (default: 1000000000)",
    )  # fmt: skip
    parser.add_argument(
        "--worlds", type=positive_whole_number, default=4096, help="side by side (default: 4096)"
    )
    parser.add_argument(
        "--state", type=Path, default=Path("outputs/soak.safetensors"),
        help="where the worlds are kept until it is done (default: outputs/soak.safetensors)",
    )  # fmt: skip
    add_output(parser, "soak")
    return parser.parse_args()


if __name__ == "__main__":
    main()
