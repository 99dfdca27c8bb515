"""`samarl-evaluate`: evaluate an agent on fixed cases, or run a sweep of evaluations."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from mrsan import Episodes, Outcome, social_score
from samarl.agents import Agent, build_agent
from samarl.commands.agents import check_agent, compile_for, print_scope_warning, selected_agent
from samarl.commands.cli import command_line, run_command
from samarl.configuration import engine_in, evaluation_in, load_scenario, scenario_in
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.summary import Row, summarise
from samarl.evaluation.sweep import read_cell
from samarl.evaluation.table import rows_as_markdown
from samarl.files import code_version, write_json, write_text
from samarl.physics.engine import Engine, MrsanEngine
from samarl.progress import progress_bar

_PER_EPISODE = ("case", "episode", "duration", "outcome", "steps", "deadlock")
_PER_ROBOT = [name for name in Episodes._fields if name not in _PER_EPISODE]


def main() -> None:
    """Entry point."""
    run_command(evaluate, "config", check_cell)


def evaluate(config: DictConfig) -> Row:
    """Run the cases, write `row.json` and `episodes.jsonl`, and print the row.

    Cells of a sweep that were finished with the same configuration and code are not run again.
    """
    scenario, evaluation = scenario_in(config), evaluation_in(config)
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    row_path = folder / "row.json"
    engine = engine_in(config)
    agent = build_agent(selected_agent(config), scenario)
    marker = {"config": _plain(config), "commit": code_version(), "agent": agent.version()}
    cell = read_cell(row_path) if hydra.mode == RunMode.MULTIRUN else None
    if cell and {key: cell.get(key) for key in marker} == marker:
        print(f"already finished: {folder}")
        finished_row: Row = cell["row"]
        return finished_row
    print_scope_warning(agent)
    name = str(hydra.runtime.choices.agent)
    command = command_line("samarl-evaluate")
    if isinstance(engine, MrsanEngine):
        compile_for(config.agent, scenario)
    episodes, row = evaluate_agent(agent, name, engine, evaluation, command, marker["commit"])
    write_text(folder / "episodes.jsonl", episodes_as_jsonl(episodes))
    write_json(row_path, {"row": row, **marker})  # last: it marks the cell as finished
    print(rows_as_markdown([row]))
    if "tracking_error" in row:
        print(
            f"after a decision, robots are {100 * row['tracking_error']:.1f} cm from where it leads"
        )
    print(f"written to {folder}")
    return row


def evaluate_agent(
    agent: Agent, name: str, engine: Engine, evaluation: Evaluation, command: str, commit: str
) -> tuple[Episodes, Row]:
    """Run the cases in an engine and return their records and the row of the table.

    Args:
        agent: built for the scenario.
        name: of the agent in `conf/agent/`.
        engine: what moves the robots.
        evaluation: the cases.
        command: the command that reproduces the row.
        commit: the version of the code.

    Raises:
        ConfigurationError: the engine cannot play the scenario or drive the agent.
    """
    engine.check(agent.scenario)
    scenario, cases = agent.scenario, evaluation.case_numbers()
    named = load_scenario(scenario.name)
    further_fields: Row = {}
    with progress_bar(total=len(cases), desc=name, unit="case", leave=False) as bar:
        if isinstance(engine, MrsanEngine):
            episodes = run_cases(agent, scenario, cases, evaluation.batch, bar.update)
        else:
            from samarl.physics.runner import run_physics_cases  # imports MuJoCo

            episodes, error = run_physics_cases(agent, engine, cases, name, bar.update)
            further_fields["tracking_error"] = round(error, 4)
    row = summarise(episodes, scenario, name, command, commit, int(cases[0]), named)
    row["changes"] = " ".join(filter(None, [row["changes"], *engine.changes()]))
    return episodes, row | further_fields


def check_cell(config: DictConfig) -> None:
    """Check the configuration of a cell of a sweep without running it."""
    evaluation_in(config)
    engine_in(config).check(scenario_in(config))
    check_agent(config)


def episodes_as_jsonl(episodes: Episodes) -> str:
    """Return one JSON object per episode; lists hold one element per robot."""
    scores = social_score(episodes)
    lines = []
    for b in range(len(episodes.case)):
        record: dict[str, Any] = {
            "case": int(episodes.case[b]),
            "success": bool(episodes.success[b]),
            "duration": float(episodes.duration[b]),
            "steps": int(episodes.steps[b]),
            "deadlock": bool(episodes.deadlock[b]),
            "outcome": [Outcome(value).name for value in episodes.outcome[b]],
            "social_score": scores[b].round(2).tolist(),
        }
        for key in _PER_ROBOT:
            values = getattr(episodes, key)[b].tolist()
            record[key] = [_rounded(value) for value in values]
        lines.append(json.dumps(record))
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> float | None:
    """Return a value for JSON, which has no infinity; booleans are unchanged."""
    if value == math.inf:
        return None
    return round(value, 4) if isinstance(value, float) else value


def _plain(config: DictConfig) -> Any:
    """Return the configuration without the batch size, which does not affect results."""
    content = json.loads(json.dumps(OmegaConf.to_container(config, resolve=True), default=str))
    del content["evaluation"]["batch"]
    return content


if __name__ == "__main__":
    main()
