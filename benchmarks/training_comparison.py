"""What a setting is worth in training: `python -m benchmarks.training_comparison SETTING ...`.

Rounds with the settings and without them alternate in one process, so that whatever else runs on
the machine slows both alike; what counts is how the times of each pair of rounds compare. Beside
the time that passes, the processor time is given, which other programs disturb less; it is that of
all threads, and does not include a GPU's.
`python -m benchmarks.training_comparison trainer.compile=true --common trainer.threads=1`.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import time
from contextlib import ExitStack
from typing import Any

import numpy as np

from benchmarks.training import default_trainer
from benchmarks.workload import add_output, interruptible, positive_whole_number, provenance
from mrsan.threads import use_threads
from samarl.evaluation.table import markdown_table
from samarl.files import machine, write_json
from samarl.progress import progress_bar
from samarl.training.trainer import Trainer

VARIANTS = ("without", "with")
CLOCKS = ("wall", "processor")
SECONDS = ("round_seconds", "warm_up_seconds")


def main() -> None:
    """Measure, print the table, write the JSON."""
    arguments = _parse()
    with interruptible(), ExitStack() as stack:
        trainers = []
        for settings in (arguments.common, [*arguments.common, *arguments.settings]):
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            trainers.append(default_trainer([*settings, f"run_dir={folder}"]))
        seconds = alternate(trainers, arguments.warm_up + arguments.rounds)
    timed, warm_up = seconds[arguments.warm_up :], seconds[: arguments.warm_up]
    ratio = np.quantile(timed[:, 0] / timed[:, 1], (0.5, 0.25, 0.75), axis=0).round(3)
    medians, first = np.median(timed, 0).round(2), warm_up.sum(0).round(1)
    result: dict[str, Any] = (
        {
            clock: {
                "speed_ratio": ratio[0, k],  # above 1: the settings make it faster
                "quartiles": ratio[1:, k].tolist(),
                "round_seconds": dict(zip(VARIANTS, medians[:, k], strict=True)),
                "warm_up_seconds": dict(zip(VARIANTS, first[:, k], strict=True)),
            }
            for k, clock in enumerate(CLOCKS)
        }
        | {"rounds": arguments.rounds, **provenance("training_comparison")}
    )
    write_json(arguments.output, result)
    header = ("clock", "settings", "median s a round", f"s in the first {arguments.warm_up}")
    lines = [
        [clock, variant, *(f"{result[clock][key][variant]:.2f}" for key in SECONDS)]
        for clock, variant in itertools.product(CLOCKS, VARIANTS)
    ]
    print(markdown_table(header, lines))
    for clock in CLOCKS:
        low, high = result[clock]["quartiles"]
        print(
            f"{clock} time: with the settings {result[clock]['speed_ratio']:.2f} times as fast, "
            f"quartiles {low:.2f} and {high:.2f} of {arguments.rounds} pairs of rounds"
        )
    print(f"{machine()}\nwritten to {arguments.output}")


def alternate(trainers: list[Trainer], rounds: int) -> np.ndarray:
    """Time rounds of some trainers in turn.

    Args:
        trainers: V trainers; the first round of every other turn is that of the last one.
        rounds: R rounds of each.

    Returns:
        The seconds of each round by each of `CLOCKS`, [R, V, 2].
    """
    seconds = np.empty((rounds, len(trainers), len(CLOCKS)))
    for number in progress_bar(range(rounds), desc="training", unit="pair"):
        order = range(len(trainers))
        for index in order if number % 2 else reversed(order):
            use_threads(trainers[index].config.threads)
            start = time.perf_counter(), time.process_time()
            trainers[index].round()
            seconds[number, index] = time.perf_counter(), time.process_time()
            seconds[number, index] -= start
    return seconds


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.training_comparison",
        description=(__doc__ or "").partition("\n")[0],
    )
    parser.add_argument("settings", nargs="+", help="as for samarl-train: trainer.compile=true")
    parser.add_argument("--common", nargs="+", default=[], help="settings of both")
    parser.add_argument("--rounds", type=positive_whole_number, default=20, help="timed (20)")
    parser.add_argument("--warm-up", type=positive_whole_number, default=3, help="not timed (3)")
    add_output(parser, "training_comparison")
    return parser.parse_args()


if __name__ == "__main__":
    main()
