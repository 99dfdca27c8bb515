"""`samarl-bench`: Table I, every agent in every column, against the committed results."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf
from tqdm import tqdm

from mrsan import ConfigurationError, Scenario
from samarl.agents import build_agent
from samarl.cli import run_command
from samarl.evaluation.files import (
    code_version,
    find_folder,
    machine,
    write_atomically,
    write_json,
)
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.summary import Row, summarise
from samarl.evaluation.table import column_of, rows_as_markdown, table1_as_markdown


@dataclass
class Bench:
    """Schema of `conf/bench.yaml`."""

    agents: list[str] | None = None
    columns: list[dict[str, Any]] = field(default_factory=list)
    output: str = MISSING
    evaluation: Any = MISSING


def main() -> None:
    """Entry point."""
    run_command(bench, "bench", bench_schema=Bench)


def bench(config: DictConfig) -> None:
    """Play, print and write the table; say how each row compares with the committed one."""
    evaluation = OmegaConf.to_object(config.evaluation)
    assert isinstance(evaluation, Evaluation)
    names = available_agents() if config.agents is None else list(config.agents)
    scenarios = [_scenario(OmegaConf.to_container(column)) for column in config.columns]
    agents = [(name, load_agent(name), scenario) for scenario in scenarios for name in names]
    commit = code_version()
    rows = []
    for name, agent_config, scenario in tqdm(agents, desc="table 1", unit="row", disable=None):
        agent = build_agent(agent_config, scenario)
        cases = evaluation.numbers()
        episodes = run_cases(agent, scenario, cases, evaluation.batch, name)
        command = _command(name, scenario, evaluation)
        rows.append(summarise(episodes, scenario, name, command, commit, int(cases[0])))
    committed = find_folder("results") / "table1.json"
    known: list[Row] = json.loads(committed.read_text()) if committed.exists() else []
    print(table1_as_markdown(rows), "\n")
    print(rows_as_markdown(rows), "\n")
    for row in rows:
        print(compare(row, known))
    output = Path(config.output)
    write_json(output / "table1.json", rows)
    write_atomically(output / "table1.md", _page(rows, commit))
    print(f"\nwritten to {output}/table1.json and table1.md")


def available_agents() -> list[str]:
    """The names of all agents in `conf/agent/`."""
    return sorted(path.stem for path in (find_folder("conf") / "agent").glob("*.yaml"))


def compare(row: Row, committed: Sequence[Row]) -> str:
    """One line: how a row compares with the committed row of the same method and column."""
    fov, humans, robots = column_of(row)
    name = f"{row['method']} {fov:g}° {humans}h {robots}r"
    same = [r for r in committed if (r["method"], column_of(r)) == (row["method"], column_of(row))]
    if not same:
        return f"new      {name}: no committed row"
    old = same[0]
    change = (
        f"{name}: success {old['success_rate']:.1f} -> {row['success_rate']:.1f} %, "
        f"social score {old['social_score']:.1f} -> {row['social_score']:.1f}"
    )
    measured = ("episodes", "success_rate", "social_score", "collision_rate", "timeout_rate")
    if all(row[key] == old[key] for key in measured):  # type: ignore[literal-required]
        return f"same     {change}"
    for key, low, high in (
        ("success_rate", "success_low", "success_high"),
        ("social_score", "social_low", "social_high"),
    ):
        if not old[low] <= row[key] <= old[high]:  # type: ignore[literal-required]
            bounds = f"[{old[low]:.1f}, {old[high]:.1f}]"  # type: ignore[literal-required]
            return f"DIFFERS  {change}: {key} is outside {bounds}"
    return f"close    {change}, within the committed intervals"


def _scenario(column: Any) -> Scenario:
    try:
        return Scenario(**column)
    except TypeError as error:
        raise ConfigurationError(
            f"columns has {column}; its keys must be those of scenario"
        ) from error


def load_agent(name: str) -> dict[str, Any]:
    """The configuration of an agent of `conf/agent/`."""
    path = find_folder("conf") / "agent" / f"{name}.yaml"
    if not path.exists():
        choices = ", ".join(available_agents())
        raise ConfigurationError(f"agents has {name!r}; it must be among {choices}")
    config = OmegaConf.to_container(OmegaConf.load(path))
    assert isinstance(config, dict)
    return {str(key): value for key, value in config.items()}


def _command(name: str, scenario: Scenario, evaluation: Evaluation) -> str:
    words = ["samarl-evaluate", f"agent={name}"]
    words += [
        f"scenario.{key}={getattr(scenario, key):g}" for key in ("fov_degrees", "humans", "robots")
    ]
    if evaluation.cases != Evaluation.cases:
        words.append(f"evaluation.cases={evaluation.cases}")
    return shlex.join(words)


def _page(rows: Sequence[Row], commit: str) -> str:
    return f"""# Table I

Success is joint: every robot reaches its goal and nobody collides. The paper's social score is
undefined there and ours is on another scale, so only its success rates stand here; at 90° our
sensor hides what is outside the field of view, which makes those columns harder than the paper's.

{table1_as_markdown(rows)}

## Every row

{rows_as_markdown(rows)}

Made by `make results` at commit {commit} on {machine()}. Each row of `table1.json` holds the
command that produces it alone.
"""


if __name__ == "__main__":
    main()
