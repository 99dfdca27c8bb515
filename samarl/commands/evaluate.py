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
from samarl import api
from samarl.commands.agents import agent_in, check_agent
from samarl.commands.cli import command_line, run_command
from samarl.configuration import engine_in, evaluation_in, scenario_in
from samarl.evaluation.summary import Row
from samarl.evaluation.sweep import read_cell
from samarl.evaluation.table import rows_as_markdown
from samarl.files import code_version, write_json, write_text

_PER_EPISODE = ("case", "episode", "duration", "outcome", "steps", "deadlock")
_PER_ROBOT = [name for name in Episodes._fields if name not in _PER_EPISODE]


def main() -> None:
    """Entry point."""
    run_command(evaluate, "config", check_cell)


def evaluate(config: DictConfig) -> Row:
    """Run the cases, write `row.json` and `episodes.jsonl`, and print the row.

    Cells of a sweep that were finished with the same configuration and code are not run again.
    """
    hydra, evaluation, engine = HydraConfig.get(), evaluation_in(config), engine_in(config)
    folder = Path(hydra.runtime.output_dir)
    row_path = folder / "row.json"
    agent = agent_in(config)
    marker = {"config": _plain(config), "commit": code_version(), "agent": agent.version()}
    cell = read_cell(row_path) if hydra.mode == RunMode.MULTIRUN else None
    if cell and {key: cell.get(key) for key in marker} == marker:
        print(f"already finished: {folder}")
        finished_row: Row = cell["row"]
        return finished_row
    result = api.evaluate(
        agent,
        cases=evaluation.case_numbers(),
        batch=evaluation.batch,
        engine=engine,
        command=command_line("samarl-evaluate"),
    )
    row = result.row
    write_text(folder / "episodes.jsonl", episodes_as_jsonl(result.episodes))
    write_json(row_path, {"row": row, **marker})  # last: it marks the cell as finished
    print(rows_as_markdown([row]))
    if "tracking_error" in row:
        print(
            f"after a decision, robots are {100 * row['tracking_error']:.1f} cm from where it leads"
        )
    print(f"written to {folder}")
    return row


def check_cell(config: DictConfig) -> None:
    """Check the configuration of a cell of a sweep without running it."""
    evaluation_in(config)
    check_agent(config)
    engine_in(config).check(scenario_in(config))


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
