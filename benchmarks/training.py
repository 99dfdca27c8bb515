"""Measure the speed of training and where its time is spent: `python -m benchmarks.training`.

Rounds of the default recipe (collect, update) are timed. As many further rounds run under Python's
profiler, which measures the share of each part. Arguments are those of `samarl-train`:
`python -m benchmarks.training trainer.threads=1`. To measure several processes that train together:
`torchrun --nproc-per-node 2 --no-python python -m benchmarks.training trainer.threads=1`. The speed
is then that of all processes together, and the shares are those of the first one.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import statistics
import tempfile
import time
from typing import Any

from hydra import compose, initialize_config_dir

from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from samarl.commands.train import settings_in
from samarl.configuration import register_schemas
from samarl.distributed import stop_requested
from samarl.evaluation.table import markdown_table
from samarl.files import find_folder, machine, write_json
from samarl.launch import rank, world_size
from samarl.progress import progress_bar
from samarl.training.run import build_trainer
from samarl.training.settings import train_schema
from samarl.training.trainer import Trainer

# The functions that make up each part of a round: end of the file's path, name.
_PARTS = {
    "simulation": [("world.py", "step"), ("world.py", "reset")],
    "tracks, features": [("policy.py", "_perceive")],
    "shield": [("shield.py", "apply_shield")],
    "networks, acting": [("stochastic.py", "act"), ("stochastic.py", "resume")],
    "rollouts": [("collector.py", "collect")],
    "advantages": [("ppo.py", "prepare")],
    "networks, forward": [("ppo.py", "_policy_loss"), ("ppo.py", "_value_loss")],
    "networks, backward": [("_tensor.py", "backward")],
    "optimiser": [("adam.py", "step"), ("clip_grad.py", "clip_grad_norm_")],
    "mean of gradients": [("distributed.py", "average_gradients")],  # waits for the slowest one
}
_NESTED = {  # parts that run within another part and are subtracted from it
    "networks, acting": ["tracks, features"],
    "rollouts": ["networks, acting", "tracks, features", "shield", "simulation"],
}


def main() -> None:
    """Measure, print the table and write the JSON file."""
    arguments = _parse()
    with interruptible(), tempfile.TemporaryDirectory() as folder:
        trainer = default_trainer([*arguments.settings, f"run_dir={folder}"])
        seconds, steps = [], 0
        profiler = cProfile.Profile()
        rounds = arguments.rounds
        for number in progress_bar(
            range(1 + 2 * rounds), desc="training", unit="round", disable=rank() != 0
        ):
            if number == 1 + rounds:
                profiler.enable()
            start = time.perf_counter()
            steps_before = trainer.steps_done
            trainer.round()
            if 1 <= number <= rounds:  # round 0 compiles and warms up
                seconds.append(time.perf_counter() - start)
            steps = trainer.steps_done - steps_before
            if stop_requested():
                raise KeyboardInterrupt
        profiler.disable()
    if rank() > 0:
        return
    rates = [steps / second for second in seconds]
    result: dict[str, Any] = {
        "world_steps_per_second": round(statistics.median(rates), 1),
        "smallest": round(min(rates), 1),
        "largest": round(max(rates), 1),
        "share_percent": shares(pstats.Stats(profiler)),
        "processes": world_size(),
        "threads": trainer.config.threads,
        **provenance("training"),
    }
    write_json(arguments.output, result)
    rate, low, high = (f"{value:,.0f}" for value in list(result.values())[:3])
    print(
        f"{rate} [{low}, {high}] world-steps per second, {world_size()} processes with "
        f"{result['threads']} threads each, {machine()}"
    )
    lines = [[part, f"{share:.1f}"] for part, share in result["share_percent"].items()]
    print(markdown_table(("part of a round", "share %"), lines))
    print(f"\nwritten to {arguments.output}")


def shares(profile: pstats.Stats) -> dict[str, float]:
    """Return the share of the profiled time that each part takes, in percent."""
    calls: dict[tuple[str, int, str], tuple] = profile.stats  # type: ignore[attr-defined]
    total = sum(call[2] for call in calls.values())
    spent = {
        part: sum(
            call[3]
            for (file, _, name), call in calls.items()
            if any(file.endswith(f"/{end}") and name == function for end, function in functions)
        )
        for part, functions in _PARTS.items()
    }
    for part, inner in _NESTED.items():
        spent[part] -= sum(spent[name] for name in inner)
    spent["rest"] = total - sum(spent.values())
    return {part: round(100 * seconds / total, 1) for part, seconds in spent.items()}


def default_trainer(settings: list[str]) -> Trainer:
    """Return the trainer that `samarl-train` would run with these settings."""
    register_schemas(train_schema=train_schema())
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        return build_trainer(settings_in(compose("train", settings)), "benchmark")


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.training", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("settings", nargs="*", help="as for samarl-train: trainer.threads=1")
    parser.add_argument(
        "--rounds",
        type=positive_whole_number,
        default=5,
        help="timed rounds (5)",
    )
    add_output(parser, "training_throughput")
    return parser.parse_intermixed_args()


if __name__ == "__main__":
    main()
