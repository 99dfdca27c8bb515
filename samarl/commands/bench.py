"""`samarl-bench`: evaluate agents in the columns of a table and compare with committed results."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from joblib import Parallel, delayed, parallel_config
from omegaconf import MISSING, DictConfig, OmegaConf
from tqdm import tqdm

from mrsan import ActionError, ConfigurationError, Scenario, World
from mrsan.compile_ahead import compile_ahead
from mrsan.fields import check_numbers, number
from samarl.agents import build_agent
from samarl.commands.cli import run_command
from samarl.commands.recordings import recordings_in
from samarl.configuration import (
    evaluation_in,
    import_plugins,
    load_method_config,
    load_scenario,
    open_mapping,
    scenario_of,
)
from samarl.evaluation.methods import label_of, labelled, method_name, method_words, split_method
from samarl.evaluation.page import improvement_figure, page
from samarl.evaluation.regression import beside_committed, compare
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.seeds import across_seeds, improvements, other_seeds
from samarl.evaluation.summary import (
    Column,
    Row,
    changed_fields,
    column_of,
    read_rows,
    scenario_column,
    summarise,
)
from samarl.evaluation.table import grids_as_markdown, rows_as_markdown
from samarl.files import (
    check_writable,
    code_version,
    find_folder,
    read_json,
    write_json,
    write_text,
)
from samarl.policies.card import find_policy
from samarl.progress import SharedCount, progress_bar, shared_progress
from samarl.user_files import name_of

WEIGHTS = ("checkpoint", "macro_level")
"""Settings of agents that name trained weights, of which there may be several training seeds."""

STATUS = """\
(same: equal to the committed row; close: within its 95 % intervals, since processors round
 differently; DIFFERS: outside of them; other: the committed row has other settings or cases;
 new: there is no committed row)"""


@dataclass
class Table:
    """Schema of the tables in `conf/table/` and of what plays them."""

    name: str = MISSING
    about: str = MISSING
    agents: list[Any] | None = None  # names, `NAME SETTING=VALUE`, or mappings, see `method_name`
    headline: list[str] = field(default_factory=list)
    improvement_of: list[str] = field(default_factory=list)
    columns: list[dict[str, Any]] = field(default_factory=list)
    recorded: dict[str, Any] = open_mapping()
    frame_seconds: dict[str, float] = open_mapping(float)
    plugins: list[str] = field(default_factory=list)
    output: str = MISSING
    evaluation: Any = MISSING


@dataclass
class Bench(Table):
    """Schema of `conf/bench.yaml`."""

    only_headline: bool = False
    recordings: str | None = None
    seeds: bool = False
    learned_cases: int | None = number(None, 1, 10**6, help="cases of learned agents, if fewer")
    merge: bool = False
    jobs: int = number(-1, -1, 10**4, help="processes; -1: one per core")


def main() -> None:
    """Entry point."""
    run_command(bench, "bench", bench_schema=Bench)


def bench(config: DictConfig) -> None:
    """Evaluate all rows of the table, print them, compare them with the committed ones, write."""
    check_numbers(Bench(jobs=config.jobs, learned_cases=config.learned_cases), "")
    if config.jobs == 0:
        raise ConfigurationError("jobs is 0; it must be 1 or more, or -1 for all cores")
    scenarios = _scenarios(config)
    path = Path(config.output) / f"{config.name}.json"
    check_writable(path, "output")
    if config.merge and config.agents == [] and (rows := _earlier_rows(config, path, [])):
        _write_page(config, path, rows)
        print(f"written to {path.with_suffix('.md')}")
        return
    tasks, scope_warnings = _tasks(config, scenarios)
    if not tasks:
        warnings = "; ".join(scope_warnings.values())
        raise ConfigurationError(f"columns has no column that an agent can play: {warnings}")
    earlier = _earlier_rows(config, path, tasks)
    committed_path = find_folder("results") / path.name
    committed = (read_rows(committed_path) if committed_path.exists() else None) or []
    rows = _run(tasks, config, committed)
    print(f"\n{STATUS}\n")
    print(rows_as_markdown(rows), "\n")
    _print_grid(rows, committed, config, [_column(scenario) for scenario in scenarios])
    if scope_warnings:
        print("not evaluated in every column:")
        for name, warning in scope_warnings.items():
            print(f"  {name}: {warning}")
    rows = merged(rows, earlier)
    write_json(path, rows)
    _write_page(config, path, rows)
    print(f"\nwritten to {path} and {path.with_suffix('.md').name}")


def _print_grid(
    rows: Sequence[Row], committed: Sequence[Row], config: DictConfig, columns: Sequence[Column]
) -> None:
    """Print evaluated rows beside the committed ones of other methods."""
    if config.only_headline:
        committed = [row for row in committed if row["method"] in config.headline]
    shown = beside_committed(rows, committed, columns)
    print(grids_as_markdown(shown, columns), "\n")
    if others := shown[len(rows) :]:
        now, then = (
            f"{' or '.join(map(str, sorted({row['episodes'] for row in group})))} cases"
            for group in (rows, others)
        )
        print(f"(this run): evaluated now, {now}; others: committed, {then}\n")


def _write_page(config: DictConfig, path: Path, rows: Sequence[Row]) -> None:
    """Write the page of a table and its figure beside its rows in `path`."""
    rows = labelled(rows)
    matrices = improvements(rows, list(map(label_of, config.improvement_of)))
    headline = list(map(label_of, config.headline))
    text = page(config.name, config.about, rows, matrices, headline)
    write_text(path.with_suffix(".md"), text)
    if matrices:
        from samarl.report.improvement import draw_improvements  # imports matplotlib
        from samarl.report.style import save_figure

        save_figure(draw_improvements(matrices), path.with_name(improvement_figure(config.name)))


def _scenarios(config: DictConfig) -> list[Scenario]:
    """Return the scenarios of all columns.

    Raises:
        ConfigurationError: there are none, or two are the same column.
    """
    columns: list[Any] = [OmegaConf.to_container(column) for column in config.columns]
    for file, seconds in recordings_in(config.recordings, config.frame_seconds).items():
        recording = {"crowd": "recorded", "recording": str(file), "frame_seconds": seconds}
        columns.append({**config.recorded, **recording})
    scenarios = [scenario_of(column) for column in columns]
    if not scenarios:
        raise ConfigurationError("columns is empty; it must name at least one")
    if len({_column(scenario) for scenario in scenarios}) < len(scenarios):
        raise ConfigurationError(f"columns has two with the same {', '.join(Column._fields)}")
    return scenarios


class _Task(NamedTuple):
    """The evaluation of one row."""

    method: str  # an agent with its settings, see `samarl.evaluation.methods`
    label: str  # the method in the row
    variants: list[dict[str, Any]]  # configurations of the agent, one per training seed
    scenario: Scenario
    evaluation: Evaluation


def _tasks(config: DictConfig, scenarios: Sequence[Scenario]) -> tuple[list[_Task], dict[str, str]]:
    """Return the rows to evaluate, and why some agents are not evaluated in every column.

    All agents are built here, so that mistakes are reported before anything is evaluated.

    Raises:
        ConfigurationError: there are no agents, or one of them is not valid.
    """
    evaluation = evaluation_in(config)
    cases = evaluation.cases if config.learned_cases is None else config.learned_cases
    learned_evaluation = replace(evaluation, cases=min(cases, evaluation.cases))
    labels = _methods(config)
    agents = {method: load_method_config(method) for method in labels}
    tasks: list[_Task] = []
    scope_warnings: dict[str, str] = {}
    for scenario in scenarios:
        for method, agent in agents.items():
            if warning := build_agent(agent, scenario).scope_warning():
                scope_warnings.setdefault(labels[method], warning)
                continue
            variants = [agent]
            for setting in WEIGHTS if config.seeds else ():
                seeds = other_seeds(str(agent.get(setting)))
                variants += [{**agent, setting: seed} for seed in seeds]
            protocol = learned_evaluation if "checkpoint" in agent else evaluation
            tasks.append(_Task(method, labels[method], variants, scenario, protocol))
    return tasks, scope_warnings


def _methods(config: DictConfig) -> dict[str, str]:
    """Return the methods to evaluate, with their names in the rows.

    Raises:
        ConfigurationError: there are none, or two have the same name.
    """
    entries = config.headline if config.only_headline else config.agents
    if not entries:
        raise ConfigurationError("agents is empty; it must name at least one")
    labels: dict[str, str] = {}
    for entry in entries:
        method, label = method_name(entry)
        name, _ = split_method(method)
        label = label or method.replace(name, name_of(name), 1)
        if method in labels or label in labels.values():
            raise ConfigurationError(f"agents has {label!r} twice; names in the table must differ")
        labels[method] = label
    return labels


def _run(tasks: Sequence[_Task], config: DictConfig, committed: Sequence[Row]) -> list[Row]:
    """Evaluate all tasks in parallel processes; print how each row compares when it is done."""
    commit, plugins = code_version(), list(config.plugins)
    total = sum(len(task.variants) * task.evaluation.cases for task in tasks)
    os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")  # printed on interrupts
    rows: list[Row] = []
    with compile_ahead(World(tasks[0].scenario)):
        pass  # once, rather than in every process
    with (
        progress_bar(total=total, desc=config.name, unit="case") as bar,
        shared_progress(bar, len(tasks)) as counts,
        parallel_config("loky", n_jobs=config.jobs, inner_max_num_threads=1),
    ):
        jobs = [
            delayed(_row)(
                task, load_scenario(task.scenario.name), commit, plugins, SharedCount(counts, k)
            )
            for k, task in enumerate(tasks)
        ]
        try:
            for row in Parallel(return_as="generator")(jobs):
                rows.append(row)
                tqdm.write(compare(row, committed))
        except ActionError as error:
            raise error from None  # without the traceback of the other process
    return rows


def _row(
    task: _Task,
    named: Scenario,
    commit: str,
    plugins: list[str],
    advance: Callable[[int], None] | None = None,
) -> Row:
    """Evaluate one agent in one column.

    The row is that of the first variant; the others differ in their training seed.
    """
    import_plugins(plugins)
    method, label, variants, scenario, evaluation = task
    cases = evaluation.case_numbers()
    command = _command(method, scenario, named, evaluation, plugins)
    rows = []
    for variant in variants:
        agent = build_agent(variant, scenario)
        episodes = run_cases(agent, scenario, cases, evaluation.batch, advance)
        first = int(cases[0])
        rows.append(summarise(episodes, scenario, label, command, commit, first, named))
    row = rows[0]
    if "checkpoint" in variants[0]:
        row |= _from_training([str(variant["checkpoint"]) for variant in variants], command)
    return row | across_seeds(rows) if len(rows) > 1 else row


def _from_training(checkpoints: Sequence[str], command: str) -> Row:
    """Return how a row of a policy is reproduced from scratch.

    The first checkpoint is the policy of the row, which `command` evaluates.

    Returns:
        A command that trains and evaluates, the commit of the training, and the training command
        of each seed; nothing for policies that continue another training run, whose card has the
        commands, or were not trained by `samarl-train`.
    """
    trainings = []
    for name in checkpoints:
        path = find_policy(name)
        provenance = read_json(path.with_suffix(".json"))["provenance"]
        words = shlex.split(provenance.get("command", ""))
        if "samarl-train" not in words or "init_from" in provenance:
            return {}
        words = [word for word in words if not word.startswith("run_dir=")]
        folder = f"outputs/{path.stem}"
        trainings.append((shlex.join([*words, f"run_dir={folder}"]), folder, provenance["commit"]))
    train, folder, commit = trainings[0]
    return {
        "from_training": f"{train} && {command} checkpoint={folder}/last.safetensors",
        "training_commit": commit,
        "training_commands": [train for train, _, _ in trainings],
    }


def _earlier_rows(config: DictConfig, path: Path, tasks: Sequence[_Task]) -> list[Row]:
    """Return the rows of an existing file that new rows are merged into.

    Raises:
        ConfigurationError: the file is not a table, or a new row would have fewer cases or seeds
            than the row it replaces.
    """
    if not config.merge or not path.exists():
        return []
    earlier = read_rows(path)
    if earlier is None:
        raise ConfigurationError(f"merge is true; {path} must be a table, or be removed")
    cases = {(task.label, _column(task.scenario)): task.evaluation.cases for task in tasks}
    for row in earlier:
        new_cases = cases.get((row["method"], column_of(row)))
        if new_cases is None:
            continue
        lost_seeds = "training_seeds" in row and not config.seeds
        if new_cases < row["episodes"] or lost_seeds:
            raise ConfigurationError(
                f"merge is true; the row of {row['method']} must have at least the "
                f"{row['episodes']} cases"
                + (" and all training seeds (seeds=true)" if "training_seeds" in row else "")
                + f" of {path}"
            )
    return earlier


def _column(scenario: Scenario) -> Column:
    """Return the column of a scenario."""
    return scenario_column(scenario, load_scenario(scenario.name))


def merged(rows: Sequence[Row], earlier: Sequence[Row]) -> list[Row]:
    """Replace earlier rows of the same method and column; append the others."""
    all_rows = {(column_of(row), row["method"]): row for row in (*earlier, *rows)}
    columns = list(dict.fromkeys(column for column, _ in all_rows))
    order = sorted(all_rows, key=lambda key: columns.index(key[0]))  # stable
    return [all_rows[key] for key in order]


def _command(
    method: str,
    scenario: Scenario,
    named: Scenario,
    evaluation: Evaluation,
    plugins: Sequence[str] = (),
) -> str:
    """Return the command that evaluates one row: its column and all changed fields."""
    words = ["samarl-evaluate", *method_words(method)]
    if plugins:
        words.append(f"plugins=[{','.join(plugins)}]")
    words.append(f"scenario={scenario.name}")  # not that of the training of a policy
    column = ("fov_degrees", "humans", "robots")
    words += [f"scenario.{name}={getattr(scenario, name):g}" for name in column]
    changes = [(f"scenario.{name}", value) for name, value in changed_fields(scenario, named)]
    changes += [(f"evaluation.{n}", v) for n, v in changed_fields(evaluation, Evaluation())]
    excluded = {*(f"scenario.{name}" for name in column), "scenario.name", "evaluation.batch"}
    for key, value in changes:
        if key not in excluded:
            value = Path(value).name if key == "scenario.recording" else value
            words.append(f"{key}={value}")
    return shlex.join(words)


if __name__ == "__main__":
    main()
