"""`samarl-bench`: a table, every agent in every column, against the committed results."""

from __future__ import annotations

import dataclasses
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed, parallel_config
from omegaconf import MISSING, DictConfig, OmegaConf
from tqdm import tqdm

from mrsan import ActionError, ConfigurationError, Scenario
from samarl.agents import build_agent
from samarl.commands.cli import run_command
from samarl.commands.recordings import recordings_in
from samarl.configuration import (
    available_agents,
    evaluation_in,
    import_plugins,
    load_agent,
    load_scenario,
    scenario_of,
)
from samarl.evaluation.page import page
from samarl.evaluation.regression import compare
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.seeds import across_seeds, other_seeds
from samarl.evaluation.summary import (
    Column,
    Row,
    changed_fields,
    column_of,
    place_of,
    read_rows,
    summarise,
)
from samarl.evaluation.table import (
    grids_as_markdown,
    rows_as_markdown,
)
from samarl.files import (
    check_writable,
    code_version,
    find_folder,
    read_json,
    write_atomically,
    write_json,
)

STATUS = """\
(same: the committed row again; close: within its 95 % intervals, as processors round differently;
 DIFFERS: outside of them; other: it is of other settings or cases; new: there is none)"""


@dataclass
class Bench:
    """Schema of `conf/bench.yaml` and of the tables in `conf/table/`."""

    name: str = MISSING
    about: str = MISSING
    agents: list[str] | None = None
    leave_out: list[str] = field(default_factory=list)
    headline: list[str] = field(default_factory=list)
    improvement_of: list[str] = field(default_factory=list)
    columns: list[dict[str, Any]] = field(default_factory=list)
    recordings: str | None = None
    recorded: dict[str, Any] = field(default_factory=dict)
    frame_seconds: dict[str, float] = field(default_factory=dict)
    plugins: list[str] = field(default_factory=list)
    seeds: bool = False
    learned_cases: int | None = None
    merge: bool = False
    jobs: int = -1
    output: str = MISSING
    evaluation: Any = MISSING


def main() -> None:
    """Entry point."""
    run_command(bench, "bench", bench_schema=Bench)


def bench(config: DictConfig) -> None:
    """Play, print and write the table; say how each row compares with the committed one."""
    evaluation = evaluation_in(config)
    _check_numbers(config)
    fewer = evaluation.cases if config.learned_cases is None else config.learned_cases
    learned = dataclasses.replace(evaluation, cases=min(fewer, evaluation.cases))
    everybody = [name for name in available_agents() if name not in config.leave_out]
    names = everybody if config.agents is None else list(config.agents)
    columns = [OmegaConf.to_container(column) for column in config.columns]
    columns += _recorded_columns(config)
    scenarios = [scenario_of(column) for column in columns]
    if not names or not scenarios:
        raise ConfigurationError("agents and columns are empty; name at least one of each")
    if len({_place(scenario) for scenario in scenarios}) < len(scenarios):
        raise ConfigurationError(f"columns has two with the same {', '.join(Column._fields)}")
    output = Path(config.output)
    check_writable(output / f"{config.name}.json", "output")
    commit = code_version()
    plugins = list(config.plugins)
    agents = [(name, load_agent(name, "agents")) for name in names]
    tasks, coming = [], []
    left_out: dict[str, str] = {}
    for scenario in scenarios:
        for name, agent in agents:
            # What is wrong is said before anything is played; policies are not for every column.
            if warning := build_agent(agent, scenario).scope_warning():
                left_out.setdefault(name, warning)
                continue
            others = other_seeds(str(agent.get("checkpoint"))) if config.seeds else []
            variants = [agent, *({**agent, "checkpoint": other} for other in others)]
            cases = learned if "checkpoint" in agent else evaluation
            coming.append((name, scenario, cases.cases))
            named = load_scenario(scenario.name)
            tasks.append(delayed(_row)(name, variants, scenario, named, cases, commit, plugins))
    if not tasks:
        raise ConfigurationError(f"columns has nothing to play: {'; '.join(left_out.values())}")
    earlier = _kept(config, output / f"{config.name}.json", coming)
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")  # when it is interrupted
    with parallel_config("loky", n_jobs=config.jobs, inner_max_num_threads=1):
        played = Parallel(return_as="generator")(tasks)
        try:
            bar = tqdm(played, config.name, len(tasks), unit="row", disable=None)
            rows = list(bar)
        except ActionError as error:
            raise error from None  # without the traceback of the other process
    committed = find_folder("results") / f"{config.name}.json"
    known = (read_rows(committed) if committed.exists() else None) or []
    print(grids_as_markdown(rows), "\n")
    print(rows_as_markdown(rows), "\n")
    for row in rows:
        print(compare(row, known))
    print(STATUS)
    if left_out:
        print("not played everywhere:")
        for name, why in left_out.items():
            print(f"  {name}: {why}")
    rows = merged(rows, earlier)
    write_json(output / f"{config.name}.json", rows)
    text = page(config.name, config.about, rows, config.improvement_of, config.headline)
    write_atomically(output / f"{config.name}.md", text)
    print(f"\nwritten to {output}/{config.name}.json and {config.name}.md")


def _check_numbers(config: DictConfig) -> None:
    if config.jobs < 1 and config.jobs != -1:
        raise ConfigurationError(
            f"jobs is {config.jobs}; it must be 1 or more, or -1 for all cores"
        )
    if config.learned_cases is not None and config.learned_cases < 1:
        raise ConfigurationError(
            f"learned_cases is {config.learned_cases}; it must be null or at least 1"
        )


def _recorded_columns(config: DictConfig) -> list[dict[str, Any]]:
    """Return a column for every recording in a folder."""
    return [
        {
            **config.recorded,
            "crowd": "recorded",
            "recording": str(file),
            "frame_seconds": frame_seconds,
        }
        for file, frame_seconds in recordings_in(config.recordings, config.frame_seconds).items()
    ]


def _row(
    name: str,
    variants: list[dict[str, Any]],
    scenario: Scenario,
    named: Scenario,
    evaluation: Evaluation,
    commit: str,
    plugins: list[str],
) -> Row:
    """Play one agent in one column, in a process of its own.

    The row is that of the first variant; the others are the same with other training seeds.
    """
    import_plugins(plugins)
    cases = evaluation.numbers()
    command = _command(name, scenario, named, evaluation, plugins)
    played = [
        run_cases(build_agent(agent, scenario), scenario, cases, evaluation.batch)
        for agent in variants
    ]
    seed = int(cases[0])
    rows = [summarise(of, scenario, name, command, commit, seed, named) for of in played]
    if "checkpoint" not in variants[0]:
        return rows[0]
    row = rows[0] | _from_training([str(agent["checkpoint"]) for agent in variants], command)
    return row | across_seeds(rows) if len(rows) > 1 else row


def _from_training(checkpoints: Sequence[str], command: str) -> Row:
    """How a row of a policy comes about from nothing.

    Args:
        checkpoints: the policy of the row, and those of its other training seeds.
        command: what gives the row of the first.

    Returns:
        One command that trains and evaluates, the commit at which it was trained, and what trained
        each of the seeds. Nothing of a policy that took several commands: its card has them.
    """
    from samarl.policies.checkpoint import find_policy  # torch, which --help does not need

    trained = []
    for name in checkpoints:
        path = find_policy(name)
        made = read_json(path.with_suffix(".json"))["made"]
        if "command" not in made or "initial" in made:
            return {}
        words = [w for w in shlex.split(made["command"]) if not w.startswith("run_dir=")]
        folder = f"outputs/{path.stem}"
        trained.append((shlex.join([*words, f"run_dir={folder}"]), folder, made["commit"]))
    train, folder, commit = trained[0]
    return {
        "from_training": f"{train} && {command} checkpoint={folder}/last.safetensors",
        "training_commit": commit,
        "training_commands": [train for train, _, _ in trained],
    }


def _kept(config: DictConfig, path: Path, tasks: Sequence[tuple[str, Scenario, int]]) -> list[Row]:
    """The rows of an earlier file that rows are to be merged into.

    Raises:
        ConfigurationError: it is no table, or a row to come would say less than its own.
    """
    if not config.merge or not path.exists():
        return []
    earlier = read_rows(path)
    if earlier is None:
        raise ConfigurationError(f"output has {path}, which is no table to merge rows into")
    coming = {(name, _place(scenario)): cases for name, scenario, cases in tasks}
    for row in earlier:
        cases = coming.get((row["method"], column_of(row)))
        if cases is None:
            continue
        seeds = "training_seeds" in row
        if cases < row["episodes"] or (seeds and not config.seeds):
            raise ConfigurationError(
                f"merge is true, but {path} says more of {row['method']}: {row['episodes']} cases"
                + (", several seeds (seeds=true)" if seeds else "")
            )
    return earlier


def _place(scenario: Scenario) -> Column:
    """The column that a scenario is."""
    return place_of(scenario, load_scenario(scenario.name))


def merged(rows: Sequence[Row], earlier: Sequence[Row]) -> list[Row]:
    """The rows in the place of earlier ones of the same method and column; new ones at the end."""
    every = {(column_of(row), row["method"]): row for row in (*earlier, *rows)}
    columns = list(dict.fromkeys(column for column, _ in every))
    order = sorted(every, key=lambda key: columns.index(key[0]))  # stable
    return [every[key] for key in order]


def _command(
    name: str,
    scenario: Scenario,
    named: Scenario,
    evaluation: Evaluation,
    plugins: Sequence[str] = (),
) -> str:
    """The evaluation that gives one row: the column, and whatever is not as by default."""
    words = ["samarl-evaluate", f"agent={name}"]
    if plugins:
        words.append(f"plugins=[{','.join(plugins)}]")
    if scenario.name != Scenario.name:
        words.append(f"scenario={scenario.name}")
    column = ("fov_degrees", "humans", "robots")
    words += [f"scenario.{name}={getattr(scenario, name):g}" for name in column]
    left_out = {*(f"scenario.{name}" for name in column), "scenario.name", "scenario.reward",
                "evaluation.batch"}  # fmt: skip
    for path, given, default in (
        ("scenario", scenario, named),
        ("scenario.reward", scenario.reward, named.reward),
        ("evaluation", evaluation, Evaluation()),
    ):
        for name, value in changed_fields(given, default):
            key = f"{path}.{name}"
            if key not in left_out:
                value = Path(value).name if name == "recording" else value
                words.append(f"{key}={value}")
    return shlex.join(words)


if __name__ == "__main__":
    main()
