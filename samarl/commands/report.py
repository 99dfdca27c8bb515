"""`samarl-report`: an HTML report of `results/` with replays."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario, Split
from samarl.agents import Agent, build_agent
from samarl.commands.cli import command_line, run_command
from samarl.configuration import available_agents, load_agent_config, scenario_of
from samarl.evaluation.trajectory import Trajectory, record_episode
from samarl.files import check_writable, find_folder
from samarl.progress import progress_bar


@dataclass
class Report:
    """Schema of `conf/report.yaml`."""

    results: str | None = None
    agents: list[str] | None = None
    split: Split = Split.test
    cases: list[int] = field(default_factory=list)
    columns: list[dict[str, Any]] = field(default_factory=list)
    output: str = MISSING
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(report, "report", report_schema=Report)


def report(config: DictConfig) -> None:
    """Record the replays and build the pages."""
    from samarl.report.build import build_site

    results = find_folder("results") if config.results is None else Path(config.results)
    if not results.is_dir():
        raise ConfigurationError(f"results is {str(results)!r}; it must be a folder")
    for case in config.cases:
        if not (isinstance(case, int) and 0 <= case < 10**9):
            raise ConfigurationError(f"cases has {case}; each must be a whole number in [0, 1e+09)")
    output = Path(config.output)
    check_writable(output / "index.html", "output")
    scenarios = [scenario_of(OmegaConf.to_container(column)) for column in config.columns]
    methods = _methods(config.agents, results)
    agents = _agents(methods, scenarios)
    runs = [(*agent, case) for agent in agents for case in config.cases]
    trajectories: list[tuple[str, int, Trajectory]] = [
        (name, case, record_episode(agent, scenario, config.split.case(case)))
        for name, agent, scenario, case in progress_bar(runs, desc="episodes", unit="episode")
    ]
    files = build_site(
        output, results, trajectories, config.split.name, command_line("samarl-report")
    )
    size = sum(file.stat().st_size for file in files)
    print(f"written to {output}/index.html: {len(files)} files, {size / 1e6:.2f} MB")


def _methods(names: list[str] | None, results: Path) -> dict[str, dict[str, Any]]:
    """Return the configurations of the agents, by default of all in `conf/agent/`.

    A checkpoint that is also in the results folder is loaded from there.
    """
    shipped = {path.stem: str(path) for path in (results / "checkpoints").glob("*.safetensors")}
    methods = {}
    for name in map(str, available_agents() if names is None else names):
        config = load_agent_config(name, "agents")
        checkpoint = config.get("checkpoint")
        methods[name] = (
            config | {"checkpoint": shipped[checkpoint]} if checkpoint in shipped else config
        )
    return methods


def _agents(
    methods: dict[str, dict[str, Any]], scenarios: list[Scenario]
) -> list[tuple[str, Agent, Scenario]]:
    """Return every agent in every scenario; print one line for each agent that does not fit all."""
    agents = []
    for name, config in methods.items():
        errors = []
        for scenario in scenarios:
            try:
                agents.append((name, build_agent(config, scenario), scenario))
            except ConfigurationError as error:
                if "checkpoint" not in config:
                    raise
                errors.append(error)
        if errors:
            print(
                f"skipped: {name} in {len(errors)} of {len(scenarios)} scenarios: "
                + "; ".join(dict.fromkeys(map(str, errors)))
            )
    return agents


if __name__ == "__main__":
    main()
