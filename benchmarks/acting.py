"""Measure whether acting in more worlds at once is faster: `python -m benchmarks.acting`.

A training calls the policy for each stage of its curriculum separately, with about 100 worlds each.
One call for all stages would only be faster if the time per robot fell with the number of worlds.
It is measured on one core, with exploration, for five robots among ten people.
"""

from __future__ import annotations

import argparse
import statistics
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.latency import decision_times
from benchmarks.workload import add_output, interruptible, positive_number, provenance
from mrsan import Observation, Scenario
from mrsan.threads import use_threads
from samarl.evaluation.table import markdown_table
from samarl.files import machine, write_json
from samarl.policies.checkpoint import load_policy
from samarl.policies.policy import Policy
from samarl.progress import progress_bar

POLICIES = {
    "set_pool, two levels": "samarl",
    "transformer, two levels": "samarl_transformer",
    "transformer, flat": "samarl_flat",
}
WORLDS = (12, 24, 48, 96, 192, 384)
SCENARIO = Scenario(robots=5, humans=10)
CORRELATION = 0.75  # of the exploration noise


def main() -> None:
    """Measure every policy, print the table and write the JSON file."""
    arguments = _parse()
    use_threads(1)
    rows: list[dict[str, Any]] = []
    with interruptible():
        for name, checkpoint in progress_bar(POLICIES.items(), desc="acting", unit="measurement"):
            policy, _ = load_policy(checkpoint)
            per_robot = {w: microseconds_per_robot(policy, w, arguments.seconds) for w in WORLDS}
            rows.append({"policy": name, "microseconds_per_robot": per_robot})
    header = ["policy", *(f"{worlds} worlds" for worlds in WORLDS)]
    lines = [
        [row["policy"], *(f"{value:.0f}" for value in row["microseconds_per_robot"].values())]
        for row in rows
    ]
    print(markdown_table(header, lines))
    write_json(arguments.output, {"policies": rows, **provenance("acting"), "threads": 1})
    print(f"\nmicroseconds per robot, one thread, {machine()}\nwritten to {arguments.output}")


class Exploring:
    """A policy that explores, as in a training."""

    def __init__(self, policy: Policy, worlds: int) -> None:
        """Drive the robots of E worlds."""
        self.policy, self.state = policy, policy.initial_state(worlds, SCENARIO)
        self.begins = np.ones(worlds, np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Begin episodes in some worlds [E]."""
        self.begins = worlds

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return actions with exploration noise, [E, N, A]."""
        decision = self.policy.act(observation, self.state, self.begins, SCENARIO, CORRELATION)
        return decision.action


def microseconds_per_robot(policy: Policy, worlds: int, seconds: float) -> float:
    """Return the median time of a decision with exploration, divided by the number of robots."""
    times = decision_times(Exploring(policy, worlds), SCENARIO, worlds, seconds)
    return round(1e3 * statistics.median(times) / (worlds * SCENARIO.robots), 1)


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.acting", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "--seconds", type=positive_number, default=3.0, help="of each measurement (3)"
    )
    add_output(parser, "acting")
    return parser.parse_args()


if __name__ == "__main__":
    main()
