"""`samarl-submit`: play the cases of a table and write one file for the leaderboard."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from mrsan import World
from mrsan.compile_ahead import compile_ahead
from samarl.agents import build_agent
from samarl.commands.bench import Table
from samarl.commands.cli import command_line, run_command
from samarl.configuration import evaluation_in, open_mapping, scenario_of
from samarl.evaluation.table import rows_as_markdown
from samarl.files import check_writable, write_text
from samarl.progress import progress_bar
from samarl.report.marl_eval import marl_eval_json
from samarl.submission import create_submission
from samarl.user_files import name_of


@dataclass
class Submit(Table):
    """Schema of `conf/submit.yaml`."""

    agent: Any = open_mapping()
    description: str = ""
    code: str = ""
    privileged: bool = False


def main() -> None:
    """Entry point."""
    run_command(submit, "submit", submit_schema=Submit)


def submit(config: DictConfig) -> None:
    """Play all columns, write the file and print the rows."""
    path = Path(config.output)
    check_writable(path, "output")
    hydra, cases = HydraConfig.get(), evaluation_in(config).case_numbers()
    values = OmegaConf.to_container(config.agent, resolve=True)
    assert isinstance(values, dict)
    settings = {str(key): value for key, value in values.items()}
    own = [word for word in hydra.overrides.task if word.startswith("agent.")]
    words = [name_of(hydra.runtime.choices.agent), *(w.removeprefix("agent.") for w in own)]
    scenarios = [scenario_of(OmegaConf.to_container(column)) for column in config.columns]
    build_agent(settings, scenarios[0])  # mistakes are found before kernels are compiled
    with compile_ahead(World(scenarios[0])):
        pass
    with progress_bar(total=len(scenarios) * len(cases), desc=config.name, unit="case") as bar:
        content = create_submission(
            config.name,
            " ".join(words),
            settings,
            scenarios,
            cases,
            command_line("samarl-submit"),
            bar.update,
            plugins=list(config.plugins),
            description=config.description,
            code=config.code,
            privileged=config.privileged or bool(settings.get("central")),
        )
    rows = [column["row"] for column in content["columns"]]
    write_text(path, json.dumps(content) + "\n")
    evaluations = path.with_name(f"{path.stem}_marl_eval.json")
    write_text(evaluations, marl_eval_json(rows))
    print(rows_as_markdown(rows))
    print(f"written to {path} and {evaluations.name}")


if __name__ == "__main__":
    main()
