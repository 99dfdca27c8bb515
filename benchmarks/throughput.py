"""Measure world-steps per second: `python -m benchmarks.throughput`.

A full step moves humans and robots, detects contacts, computes rewards, begins a new episode in
every world that ended, and computes every robot's observation. Actions are uniformly random, and
the worlds are in different phases of their episodes when the measurement starts.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba
import numpy as np

from benchmarks.workload import (
    RandomStepper,
    add_output,
    interruptible,
    positive_number,
    provenance,
)
from mrsan.pettingzoo_env import PettingZooEnv
from samarl.evaluation.table import markdown_table
from samarl.files import write_json
from samarl.progress import progress_bar

WORLDS, HUMANS, ROBOTS = 512, 10, 3
BY_WORLDS = (1, 64, 512, 4096)
BY_HUMANS = (0, 1, 2, 5, 10, 20, 40, 64)
BY_ROBOTS = (1, 2, 3, 5, 8, 16)

# Places with walls: the layout, and the number of rays of the lidar.
BY_PLACE = (("circle", 0), ("doorway", 0), ("rooms", 0), ("rooms", 72), ("pillars", 0))

_REPETITIONS = 5
_STARTS = 3  # processes timed for the start from the cache
_FIRST_STEP = f"""
import numpy as np
from mrsan import Scenario, World
world = World(Scenario(humans={HUMANS}, robots={ROBOTS}), {WORLDS})
world.reset()
world.step(np.zeros(({WORLDS}, {ROBOTS}, world.scenario.action_size), np.float32))
"""
_FIRST_COMMAND = [
    *(sys.executable, "-m", "samarl.commands.evaluate"),
    *("agent=samarl", "evaluation.cases=20"),
]

Point = dict[str, Any]


def main() -> None:
    """Measure, print the tables and write the JSON file."""
    arguments = _parse()
    with interruptible():
        result = measure(arguments.seconds, arguments.cold)
    print(format_tables(result))
    output: Path = arguments.output
    write_json(output, result)
    print(f"\nwritten to {output}")


def measure(seconds: float, cold: bool) -> dict[str, Any]:
    """Return the content of `results/throughput.json`.

    Args:
        seconds: the duration of the measurement of each point.
        cold: also time first starts, without compiled kernels (two minutes).
    """
    points = len(BY_WORLDS) + len(BY_HUMANS) + len(BY_ROBOTS) + len(BY_PLACE) + 3
    with progress_bar(total=points, desc="throughput", unit="point") as bar:

        def point(worlds: int, humans: int, robots: int) -> Point:
            bar.set_postfix_str(f"{worlds} worlds, {humans} humans, {robots} robots", refresh=False)
            rates = steps_per_second(RandomStepper(worlds, humans, robots).step, seconds)
            bar.update()
            return _point(worlds, humans, robots, [rate * worlds for rate in rates])

        full_step = point(WORLDS, HUMANS, ROBOTS)
        by_worlds = [point(worlds, HUMANS, ROBOTS) for worlds in BY_WORLDS]
        by_humans = [point(WORLDS, humans, ROBOTS) for humans in BY_HUMANS]
        by_robots = [point(WORLDS, HUMANS, robots) for robots in BY_ROBOTS]
        by_place = []
        for layout, rays in BY_PLACE:
            bar.set_postfix_str(f"{layout}, {rays} rays", refresh=False)
            stepper = RandomStepper(WORLDS, HUMANS, ROBOTS, layout=layout, lidar_rays=rays)
            rates = [rate * WORLDS for rate in steps_per_second(stepper.step, seconds)]
            by_place.append(
                {"place": layout, "rays": rays}
                | _point(WORLDS, HUMANS, ROBOTS, rates)
                | {"bytes_per_world": sum(a.nbytes for a in stepper.world.state) // WORLDS}
            )
            bar.update()
        bar.set_postfix_str("PettingZoo", refresh=False)
        pettingzoo = _point(1, HUMANS, ROBOTS, steps_per_second(_pettingzoo_step(), seconds))
        bar.update()
        bar.set_postfix_str("start", refresh=False)
        start: dict[str, float | None] = {
            "from_cache_seconds": _start_from_cache(),
            "compile_seconds": None,
            "first_command_seconds": None,
        }
        if cold:
            bar.set_postfix_str("first compilation", refresh=False)
            start["compile_seconds"] = _seconds_without_cache([sys.executable, "-c", _FIRST_STEP])
            start["first_command_seconds"] = _seconds_without_cache(_FIRST_COMMAND)
        bar.update()
    return {
        "full_step": full_step,
        "by_worlds": by_worlds,
        "by_humans": by_humans,
        "by_robots": by_robots,
        "by_place": by_place,
        "pettingzoo": pettingzoo,
        "start": start,
        "seconds_per_point": seconds,
        "repetitions": _REPETITIONS,
        "threads": numba.get_num_threads(),
        **provenance("throughput"),
    }


def steps_per_second(step: Callable[[], Any], seconds: float) -> list[float]:
    """Return the calls of `step` per second in each repetition; together these take `seconds`."""
    count, elapsed = 1, 0.0
    while elapsed < 0.02 and elapsed < seconds:
        elapsed = _time(step, count)
        count *= 2
    steps = max(1, round(count / 2 * seconds / _REPETITIONS / elapsed))
    return [steps / _time(step, steps) for _ in range(_REPETITIONS)]


def growth_exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Return x of cost ~ size^x, fitted by least squares to the logarithms of the last 3 points."""
    return float(np.polyfit(np.log(sizes[-3:]), np.log(costs[-3:]), 1)[0])


def format_tables(result: dict[str, Any]) -> str:
    """Return the tables as text."""
    full, pettingzoo, start = result["full_step"], result["pettingzoo"], result["start"]
    scaling_laws = {
        "worlds": "time of one step of all worlds ~ worlds",
        "humans": "time of one world-step ~ humans",
        "robots": "time of one world-step ~ robots",
    }
    tables = [
        _table(key, result[f"by_{key}"], text, of_all_worlds=key == "worlds")
        for key, text in scaling_laws.items()
    ]
    places = markdown_table(
        ("place", "lidar rays", "world-steps/s", "smallest", "largest", "bytes per world"),
        [
            [p["place"], str(p["rays"])]
            + [
                f"{p[name]:,.0f}"
                for name in ("world_steps_per_second", "min", "max", "bytes_per_world")
            ]
            for p in result["by_place"]
        ],
    )
    compiled, first_command = (
        "not measured (--cold)" if start[name] is None else f"{start[name]} s"
        for name in ("compile_seconds", "first_command_seconds")
    )
    return "\n\n".join(
        [
            f"Full step, {WORLDS} worlds, {HUMANS} humans, {ROBOTS} robots: "
            f"{_range(full)} world-steps/s",
            *tables,
            places,
            f"PettingZoo, one world: {_range(pettingzoo)} steps/s\n"
            "From process start to the first step, with cached kernels: "
            f"{start['from_cache_seconds']} s\nThe same without cached kernels: {compiled}\n"
            f"First command (20 cases of samarl), without cached kernels: {first_command}",
            f"Median of {_REPETITIONS} repetitions [smallest, largest], "
            f"{result['threads']} threads, {result['machine']}, commit {result['commit']}",
        ]
    )


def _table(key: str, points: Sequence[Point], text: str, of_all_worlds: bool) -> str:
    header = (key, "world-steps/s", "smallest", "largest", "ns per world-step", "ratio to previous")
    lines = []
    previous = None
    for p in points:
        cost = p["ns_per_world_step"]
        lines.append(
            [
                str(p[key]),
                *(f"{p[name]:,.0f}" for name in ("world_steps_per_second", "min", "max")),
                f"{cost:,.0f}",
                "" if previous is None else f"{cost / previous:.2f} x",
            ]
        )
        previous = cost
    costs = [p["ns_per_world_step"] * (p["worlds"] if of_all_worlds else 1) for p in points]
    exponent = growth_exponent([p[key] for p in points], costs)
    return (
        f"{markdown_table(header, lines)}\n{text}^{exponent:.2f} (fitted to the last three points)"
    )


def _range(point: Point) -> str:
    return f"{point['world_steps_per_second']:,.0f} [{point['min']:,.0f}, {point['max']:,.0f}]"


def _point(worlds: int, humans: int, robots: int, rates: Sequence[float]) -> Point:
    median = statistics.median(rates)
    return {
        "worlds": worlds,
        "humans": humans,
        "robots": robots,
        "world_steps_per_second": round(median),
        "min": round(min(rates)),
        "max": round(max(rates)),
        "ns_per_world_step": round(1e9 / median, 1),
    }


def _time(step: Callable[[], Any], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        step()
    return time.perf_counter() - start


def _pettingzoo_step() -> Callable[[], None]:
    """Return a function that steps the PettingZoo environment and resets it after an episode."""
    env = PettingZooEnv(humans=HUMANS, robots=ROBOTS)
    env.reset(seed=0)
    for agent in env.possible_agents:
        env.action_space(agent).seed(0)
    actions = [
        {agent: env.action_space(agent).sample() for agent in env.possible_agents}
        for _ in range(64)
    ]
    index = 0

    def step() -> None:
        nonlocal index
        index = (index + 1) % len(actions)
        env.step(actions[index])
        if not env.agents:
            env.reset()

    return step


def _start_from_cache() -> float:
    command = [sys.executable, "-c", _FIRST_STEP]
    _seconds(command, {})  # fills the cache
    return round(statistics.median(_seconds(command, {}) for _ in range(_STARTS)), 2)


def _seconds_without_cache(command: list[str]) -> float:
    """Return how long a command takes that has to compile all kernels."""
    with tempfile.TemporaryDirectory() as folder:
        return round(_seconds(command, {"NUMBA_CACHE_DIR": folder}, folder), 2)


def _seconds(command: list[str], environment: dict[str, str], folder: str | None = None) -> float:
    """Return how long a command takes, run in a folder."""
    start = time.perf_counter()
    variables = os.environ | environment
    subprocess.run(command, env=variables, cwd=folder, check=True, capture_output=True)
    return time.perf_counter() - start


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.throughput",
        description="Measure the world-steps per second of the simulator, how they scale with "
        "worlds, humans and robots, and how long a process takes to start.",
    )
    parser.add_argument(
        "--seconds",
        type=positive_number,
        default=2.0,
        help="duration of the measurement of each of the 25 points (default: 2)",
    )
    parser.add_argument(
        "--cold",
        action="store_true",
        help="also time a first step and a first command, which compile all kernels (two minutes)",
    )
    add_output(parser, "throughput")
    return parser.parse_args()


if __name__ == "__main__":
    main()
