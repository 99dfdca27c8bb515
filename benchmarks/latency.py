"""Measure how long one decision takes: `python -m benchmarks.latency [--checkpoint FILE]`.

On one core, with observations from episodes that the agent itself drives: one robot among ten
people, the same robot with the exported policy (`samarl.runtime`), and a batch of 512 such robots.
Agents for holonomic robots are measured in the scenario `10p3r`. Last comes one decision of the
exported macro level of the right of way.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.workload import add_output, interruptible, positive_number, provenance
from mrsan import ConfigurationError, Scenario, World
from mrsan.threads import use_threads
from samarl.agents import Agent, build_agent
from samarl.agents.agent import Controller
from samarl.configuration import available_agents, load_method_config, load_scenario
from samarl.evaluation.table import markdown_table
from samarl.export import export_agent
from samarl.files import machine, write_json
from samarl.progress import progress_bar
from samarl.runtime import Detection, Driver, KnownMap, Message, OwnState, RightOfWayDriver
from samarl.runtime.simulation import as_seen

BATCH = 512
SCENARIOS = (
    Scenario(robots=1, humans=10, fov_degrees=90.0),
    replace(load_scenario("10p3r"), robots=1),  # for agents that drive holonomic robots
)
_TWO_ROOMS = (  # with a door between them
    np.array([(-6.0, -4.0), (-6.0, 4.0), (6.0, 4.0), (6.0, -4.0)]),
    np.array([(0.0, -4.0), (0.0, -0.7)]),
    np.array([(0.0, 0.7), (0.0, 4.0)]),
)
_WARM_UP = 20
_MEASURED = ("one_robot_ms", "exported_ms", f"batch_of_{BATCH}_ms")


def main() -> None:
    """Measure every agent, print the table and write the JSON file."""
    arguments = _parse()
    use_threads(1)
    methods = arguments.agents or [*available_agents(), "perimeter shield=true"]
    agents = {method: load_method_config(method) for method in methods}
    if arguments.checkpoint is not None:
        target = "samarl.agents.learned.Learned"
        agents["checkpoint"] = {"_target_": target, "checkpoint": str(arguments.checkpoint)}
    rows: list[dict[str, Any]] = []
    with interruptible():
        for name, config in progress_bar(agents.items(), desc="latency", unit="agent"):
            one = _summary(decision_times(*build(config), 1, arguments.seconds))
            exported = exported_times(config, name, arguments.seconds)
            batch = _summary(decision_times(*build(config), BATCH, arguments.seconds))
            rows.append(dict(zip(("agent", *_MEASURED), (name, one, exported, batch), strict=True)))
    header = (
        "agent",
        "one robot ms [smallest, largest]",
        "exported ms [smallest, largest]",
        f"{BATCH} robots ms [smallest, largest]",
    )
    lines = [[row["agent"], *(_cell(row[key]) for key in _MEASURED)] for row in rows]
    print(markdown_table(header, lines))
    decision = _summary(macro_decision_times(arguments.seconds))
    print(f"\na decision of the exported macro level, ms: {_cell(decision)}")
    result = {
        "agents": rows,
        "macro_decision_ms": decision,
        **provenance("latency"),
        "threads": 1,
    }
    write_json(arguments.output, result)
    print(f"\nmedians, one thread, {machine()}\nwritten to {arguments.output}")


def build(config: dict[str, Any]) -> tuple[Agent, Scenario]:
    """Return the agent with the first of `SCENARIOS` whose robots it can drive."""
    try:
        return build_agent(config, SCENARIOS[0]), SCENARIOS[0]
    except ConfigurationError:
        return build_agent(config, SCENARIOS[1]), SCENARIOS[1]


def decision_times(
    agent: Controller, scenario: Scenario, worlds: int, seconds: float
) -> list[float]:
    """Return the times of single calls of `act` for all robots of some worlds, in ms."""
    world = World(scenario, worlds, auto_reset=True)
    observation = world.reset(np.arange(worlds))
    begins = np.ones(worlds, np.bool_)
    times: list[float] = []
    end = float("inf")
    while time.perf_counter() < end:
        agent.reset(begins)
        start = time.perf_counter()
        action = agent.act(observation)
        times.append(1e3 * (time.perf_counter() - start))
        step = world.step(action)
        observation, begins = step.observation, step.terminated | step.truncated
        if end == float("inf") and len(times) == _WARM_UP:  # kernels are compiled
            times.clear()
            end = time.perf_counter() + seconds
    return times


def exported_times(config: dict[str, Any], name: str, seconds: float) -> dict[str, float] | None:
    """Return the times of one runtime step for one robot; None if the agent has no export."""
    agent, scenario = build(config)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.onnx"
        try:
            export_agent(path, agent, name)
        except ConfigurationError:  # a planner, or an ablation
            return None
        driver = Driver.load(path)
    world = World(scenario, 1, auto_reset=True)
    observation, begins, step = world.reset([0]), True, 0
    times: list[float] = []
    end = float("inf")
    while time.perf_counter() < end:
        if begins:
            driver.reset()
            step = 0
        own, detections = as_seen(observation, 0)
        start = time.perf_counter()
        command = driver.step(own, detections, step * scenario.time_step)
        times.append(1e3 * (time.perf_counter() - start))
        world_step = world.step(command.action[None, None])
        observation, step = world_step.observation, step + 1
        begins = bool((world_step.terminated | world_step.truncated)[0])
        if end == float("inf") and len(times) == _WARM_UP:
            times.clear()
            end = time.perf_counter() + seconds
    return _summary(times)


def macro_decision_times(seconds: float) -> list[float]:
    """Return the times in which an exported macro level decides for one robot, in ms.

    The robot is before a door, with three team-mates and five people. A decision is made of the
    features and the network.
    """
    scenario = Scenario(robots=4, team_messages=True)
    method = "right_of_way macro_level=right_of_way_macro"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "macro_level.onnx"
        export_agent(path, build_agent(load_method_config(method), scenario), method)
        driver = RightOfWayDriver(KnownMap(_TWO_ROOMS), "0", scenario, path)
    mates = [
        Message(str(k), 0.0, 2.0, k - 2.0, 0.0, 0.0, 0.2 * k, False, 0, driver.passages)
        for k in range(1, 4)
    ]
    people = [Detection(k - 2.0, 1.0, 0.5, 0.0) for k in range(5)]
    times: list[float] = []
    choose = driver._choose

    def timed(*features: NDArray[Any]) -> None:
        start = time.perf_counter()
        choose(*features)
        times.append(1e3 * (time.perf_counter() - start))

    driver._choose = timed  # type: ignore[assignment, method-assign]
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or len(times) <= _WARM_UP:
        driver.reset()
        driver.step(OwnState(-2.0, 0.5, 0.0, 0.0, 0.0, 4.0, 0.0), people, 0.0, mates)
    return times[_WARM_UP:]


def _summary(times: list[float]) -> dict[str, float]:
    return {
        "median": round(statistics.median(times), 4),
        "smallest": round(min(times), 4),
        "largest": round(max(times), 4),
    }


def _cell(times: dict[str, float] | None) -> str:
    if times is None:
        return ""
    return f"{times['median']:.3f} [{times['smallest']:.3f}, {times['largest']:.3f}]"


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.latency", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument(
        "--seconds",
        type=positive_number,
        default=2.0,
        help="per measurement (2)",
    )
    parser.add_argument("--agents", nargs="+", help="names in conf/agent/ (default: all)")
    parser.add_argument("--checkpoint", type=Path, help="also measure this trained policy")
    add_output(parser, "latency")
    return parser.parse_args()


if __name__ == "__main__":
    main()
