"""`samarl-evaluate`: one agent over fixed cases, or a sweep of them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from mrsan import Episodes, Outcome, Scenario, social_score
from samarl.agents import build_agent
from samarl.commands.agents import check_agent, chosen_agent, print_scope_warning
from samarl.commands.cli import command_line, run_command
from samarl.configuration import evaluation_in, load_scenario, scenario_in
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.summary import Row, summarise
from samarl.evaluation.sweep import read_cell
from samarl.evaluation.table import rows_as_markdown
from samarl.files import code_version, write_atomically, write_json

_PER_ROBOT = [
    name
    for name in Episodes._fields
    if name not in ("case", "episode", "duration", "outcome", "steps")
]


def main() -> None:
    """Entry point."""
    run_command(evaluate, "config", check_cell)


def evaluate(config: DictConfig) -> Row:
    """Play the cases, write `row.json` and `episodes.jsonl`, print the row.

    A cell of a sweep that was finished before with the same configuration and code is not played
    again.
    """
    scenario, evaluation = objects(config)
    hydra = HydraConfig.get()
    folder = Path(hydra.runtime.output_dir)
    finished = folder / "row.json"
    agent = build_agent(chosen_agent(config), scenario)
    marker = {"config": _plain(config), "commit": code_version(), "agent": agent.version()}
    known = read_cell(finished) if hydra.mode == RunMode.MULTIRUN else None
    if known and {key: known.get(key) for key in marker} == marker:
        print(f"finished before: {folder}")
        before: Row = known["row"]
        return before
    print_scope_warning(agent)
    name = str(hydra.runtime.choices.agent)
    episodes = run_cases(agent, scenario, evaluation.numbers(), evaluation.batch, name)
    command = command_line("samarl-evaluate")
    seed = int(evaluation.numbers()[0])
    named = load_scenario(scenario.name)
    row = summarise(episodes, scenario, name, command, marker["commit"], seed, named)
    write_atomically(folder / "episodes.jsonl", episodes_as_jsonl(episodes))
    write_json(finished, {"row": row, **marker})  # last: it marks the cell as finished
    print(rows_as_markdown([row]))
    print(f"written to {folder}")
    return row


def check_cell(config: DictConfig) -> None:
    """Check a cell of a sweep without playing it."""
    evaluation_in(config)
    check_agent(config)


def objects(config: DictConfig) -> tuple[Scenario, Evaluation]:
    """The checked scenario and evaluation of a composed configuration."""
    return scenario_in(config), evaluation_in(config)


def episodes_as_jsonl(episodes: Episodes) -> str:
    """One JSON object per episode; lists hold one element per robot."""
    scores = social_score(episodes)
    lines = []
    for b in range(len(episodes.case)):
        record: dict[str, Any] = {
            "case": int(episodes.case[b]),
            "success": bool(episodes.success[b]),
            "duration": float(episodes.duration[b]),
            "steps": int(episodes.steps[b]),
            "outcome": [Outcome(value).name for value in episodes.outcome[b]],
            "social_score": scores[b].round(2).tolist(),
        }
        for key in _PER_ROBOT:
            values = getattr(episodes, key)[b].tolist()
            record[key] = [_rounded(value) for value in values]
        lines.append(json.dumps(record))
    return "\n".join(lines) + "\n"


def _rounded(value: float) -> float | None:
    """For JSON, which has no infinity; True and False stay what they are."""
    if value == math.inf:
        return None
    return round(value, 4) if isinstance(value, float) else value


def _plain(config: DictConfig) -> Any:
    """What decides the result: all of the configuration but the batch size."""
    content = json.loads(json.dumps(OmegaConf.to_container(config, resolve=True), default=str))
    del content["evaluation"]["batch"]
    return content


if __name__ == "__main__":
    main()
