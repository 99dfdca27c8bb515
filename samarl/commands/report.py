"""`samarl-report`: an HTML report of `results/` with replays."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from hydra.utils import get_class
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario, Split
from samarl.agents import Agent, build_agent
from samarl.commands.cli import command_line, run_command
from samarl.configuration import available_agents, load_method_config, load_scenario, scenario_of
from samarl.evaluation.summary import scenario_column
from samarl.evaluation.table import column_name
from samarl.evaluation.trajectory import record_episode
from samarl.files import check_writable, code_version, find_folder
from samarl.progress import progress_bar
from samarl.report.replays import ReplayFolder, digest_of


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
    """Build the pages, then record the replays."""
    from samarl.report.build import build_site, check_output  # imports matplotlib

    results = find_folder("results") if config.results is None else Path(config.results)
    if not results.is_dir():
        raise ConfigurationError(f"results is {str(results)!r}; it must be a folder")
    for case in config.cases:
        if not (isinstance(case, int) and 0 <= case < 10**9):
            raise ConfigurationError(f"cases has {case}; each must be a whole number in [0, 1e+09)")
    output = Path(config.output)
    check_writable(output / "index.html", "output")
    check_output(output)
    scenarios = [scenario_of(OmegaConf.to_container(column)) for column in config.columns]
    methods = None if config.agents is None else _methods(config.agents, results)
    has_replays = bool(config.cases and scenarios and methods != {})
    files = build_site(output, results, command_line("samarl-report"), has_replays)
    size = sum(file.stat().st_size for file in files)
    print(f"written to {output}/index.html: {len(files)} files, {size / 1e6:.2f} MB", flush=True)
    if has_replays:
        methods = _methods(None, results) if methods is None else methods
        replays = list(_planned(methods, scenarios, config))
        _record(replays, ReplayFolder(output / "replays", [replay.key for replay in replays]))


class _Replay(NamedTuple):
    """An episode to record."""

    method: str
    agent: dict[str, Any]  # its configuration
    scenario: Scenario
    case: str
    number: int  # of the case
    key: str


def _planned(
    methods: dict[str, dict[str, Any]], scenarios: list[Scenario], config: DictConfig
) -> Iterator[_Replay]:
    """Yield the replays, those of the first case in all scenarios first."""
    from samarl.report.build import slug

    code = [code_version(), *(sys.modules[name].__file__ for name in config.plugins)]
    digests = {
        name: digest_of(code, agent, inspect.getfile(get_class(agent["_target_"])))
        for name, agent in methods.items()
    }
    for index in config.cases:
        for scenario in scenarios:
            column = column_name(scenario_column(scenario, load_scenario(scenario.name)))
            settings, number = digest_of(asdict(scenario)), config.split.case(index)
            for name, agent in methods.items():
                case = f"{config.split.name} case {index}"
                digest = digest_of(digests[name], settings, number)
                key = f"{slug(f'{name} {column} {case}')}-{digest}"
                yield _Replay(name, agent, scenario, case, number, key)


def _record(replays: Sequence[_Replay], folder: ReplayFolder) -> None:
    """Record the replays that the folder lacks; print one line on agents that do not fit."""
    agents: dict[tuple[str, int], Agent | None] = {}  # None: it does not fit the scenario
    reasons: dict[str, str] = {}  # by method
    missing = [replay for replay in replays if replay.key not in folder]
    for method, config, scenario, case, number, key in progress_bar(
        missing, desc="replays", unit="replay"
    ):
        pair = (method, id(scenario))
        if pair not in agents:
            try:
                agents[pair] = build_agent(config, scenario)
            except ConfigurationError as error:
                if "checkpoint" not in config:
                    raise
                agents[pair] = None
                reasons.setdefault(method, str(error))
        if agent := agents[pair]:
            folder.add(key, method, case, record_episode(agent, scenario, number))
    folder.close()
    if reasons:
        names, (method, reason) = ", ".join(reasons), next(iter(reasons.items()))
        print(f"skipped: {names} in scenarios that they do not fit ({method}: {reason})")


def _methods(names: list[str] | None, results: Path) -> dict[str, dict[str, Any]]:
    """Return the configurations of the agents, by default of all in `conf/agent/`.

    A checkpoint that is also in the results folder is loaded from there.
    """
    shipped = {path.stem: str(path) for path in (results / "checkpoints").glob("*.safetensors")}
    methods = {}
    for method in map(str, available_agents() if names is None else names):
        config = load_method_config(method)
        checkpoint = config.get("checkpoint")
        methods[method] = (
            config | {"checkpoint": shipped[checkpoint]} if checkpoint in shipped else config
        )
    return methods


if __name__ == "__main__":
    main()
