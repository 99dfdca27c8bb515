"""The Python API: load agents and scenarios, evaluate, record, draw and train."""

from __future__ import annotations

import contextlib
import dataclasses
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Scenario, Split
from mrsan.scenario import overridden
from mrsan.suggestions import choice_hint
from samarl import configuration
from samarl.agents import Agent, build_agent
from samarl.commands.agents import AGENT_OF_POLICY
from samarl.commands.composition import COMPOSITION_ERRORS
from samarl.commands.errors import explain
from samarl.commands.overrides import as_override
from samarl.commands.render import picture_writer, title_of
from samarl.evaluation.result import EvaluationResult
from samarl.evaluation.runner import Evaluation, run_cases
from samarl.evaluation.summary import changed_fields, summarise
from samarl.evaluation.trajectory import as_table, record_episode
from samarl.files import check_writable, code_version
from samarl.progress import progress_bar

if TYPE_CHECKING:
    from pandas import DataFrame

Name = str | Path
_YAML = (".yaml", ".yml")


def load_scenario(scenario: Name | Scenario = Scenario.name, **overrides: Any) -> Scenario:
    """Return a scenario by its name, with some of its fields changed.

    Args:
        scenario: the name of a file in `conf/scenario/`, a YAML file in the same form, or a
            scenario.
        **overrides: fields of `mrsan.Scenario`, such as `humans=5`.

    Raises:
        ConfigurationError: there is no such scenario, or a value is invalid.

    Examples:
        >>> load_scenario("10p3r", humans=5).humans
        5
    """
    if not isinstance(scenario, Scenario):
        with _one_line_errors():
            is_file = Path(scenario).suffix in _YAML
            scenario = (
                configuration.read_scenario(Path(scenario))
                if is_file
                else configuration.load_scenario(str(scenario))
            )
    return overridden(scenario, overrides)


def load_agent(agent: Name, scenario: Name | Scenario | None = None, **overrides: Any) -> Agent:
    """Build an agent as its YAML file describes it, with the safety shield if the file says so.

    Args:
        agent: the name of an agent in `conf/agent/`, such as `samarl` or `orca`; a YAML file in
            the same form; a policy, which is a `.safetensors` file or the name of a shipped one;
            or the folder of a training, whose best policy is loaded. A policy drives like the
            shipped agent with a policy of its kind, which for SAMARL's kinds has a shield.
        scenario: the task (`load_scenario` lists the forms). None: SAMARL's.
        **overrides: fields of the YAML file, such as `shield=False`.

    Raises:
        ConfigurationError: there is no such agent, a field is invalid, or the agent cannot drive
            the robots of the scenario.

    Examples:
        >>> load_agent("samarl", load_scenario(humans=5)).scenario.humans
        5
        >>> load_agent("samarl", shield=False).checkpoint
        'samarl'
    """
    with _one_line_errors():
        label, settings = _agent_settings(agent)
    task = load_scenario() if scenario is None else load_scenario(scenario)
    loaded = build_agent({**settings, **overrides}, task)
    loaded.label = label
    return loaded


def evaluate(
    agent: Agent | Name,
    scenario: Name | Scenario | None = None,
    cases: int | Iterable[int] = 500,
    *,
    split: str | Split = Split.test,
    batch: int = Evaluation.batch,
    name: str | None = None,
) -> EvaluationResult:
    """Run an agent on fixed cases, like `samarl-evaluate`; results do not depend on the batch size.

    Args:
        agent: an agent, or a name that `load_agent` accepts. An agent that was created for another
            scenario is created again from its settings.
        scenario: the task (`load_scenario` lists the forms). None: that of the agent object, or
            SAMARL's.
        cases: how many cases from the first one, or which: indices in the split, or case numbers.
        split: "test", "validation" or "training".
        batch: number of worlds simulated in parallel.
        name: the method in the row. None: the name of the agent, or of its class.

    Raises:
        ConfigurationError: there is no such agent or scenario, or a case is invalid.

    Examples:
        >>> result = evaluate("orca", load_scenario(humans=5), cases=4)
        >>> result.success.shape, result.social_score.shape
        ((4,), (4, 3))
    """
    driver = _agent_for(agent, scenario)
    title = name or _name_of(driver)
    numbers = _case_numbers(cases, split)
    with progress_bar(total=len(numbers), desc=title, unit="case", leave=False) as bar:
        episodes = run_cases(driver, driver.scenario, numbers, batch, bar.update)
    named = None
    with contextlib.suppress(ConfigurationError):  # the name of a scenario may be the user's own
        named = configuration.load_scenario(driver.scenario.name)
    row = summarise(
        episodes,
        driver.scenario,
        title,
        _call(title, driver.scenario, named or Scenario(), numbers),
        code_version(),
        int(numbers[0]),
        named,
    )
    return EvaluationResult(driver.scenario, episodes, row)


def record(
    agent: Agent | Name,
    scenario: Name | Scenario | None = None,
    case: int = 0,
    *,
    split: str | Split = Split.test,
) -> DataFrame:
    """Run one case and return where everybody is at every step.

    `samarl.evaluation.trajectory.as_table` explains the columns.

    Args:
        agent: as for `evaluate`.
        scenario: as for `evaluate`.
        case: index in the split, or a case number.
        split: "test", "validation" or "training".

    Raises:
        ConfigurationError: there is no such agent or scenario, or the case is invalid.

    Examples:
        >>> table = record("orca", load_scenario(humans=5), case=28)
        >>> table[table.step == 0].kind.value_counts().to_dict()
        {'human': 5, 'robot': 3}
    """
    driver = _agent_for(agent, scenario)
    (number,) = _case_numbers([case], split)
    return as_table(record_episode(driver, driver.scenario, int(number)))


def train(*overrides: str | Sequence[str], **settings: Any) -> Path:
    """Train a policy, or resume an interrupted training, like `samarl-train`.

    Args:
        *overrides: the words of a command line, such as "policy=flat", or lists of them.
        **settings: the same by name: choices of a file (`policy="flat"`), and numbers in nested
            mappings (`trainer={"steps": 50000}`). `scenario` may be a `mrsan.Scenario`.

    Returns:
        The folder of the run, which `load_agent` and `evaluate` accept as an agent.

    Raises:
        ConfigurationError: a setting is not valid.
        KeyboardInterrupt: the training was interrupted; the same call resumes it.

    Examples:
        ```python
        scenario = samarl.load_scenario(humans=3)
        folder = samarl.train(
            "policy=flat", scenario=scenario, trainer={"steps": 200_000}, run_dir="outputs/mine"
        )
        samarl.evaluate(folder, scenario)
        ```
    """
    from samarl.commands.train import train_in_process  # imports what the rest does not need

    words: list[str] = []
    for override in overrides:
        words += [override] if isinstance(override, str) else override
    for name, value in settings.items():
        words += _words(name, value)
    with _one_line_errors():
        return train_in_process(words)


def render(
    agent: Agent | Name,
    scenario: Name | Scenario | None = None,
    case: int = 0,
    output: Name = "outputs/case.png",
    *,
    against: Agent | Name | None = None,
    split: str | Split = Split.test,
) -> Path:
    """Run one case and draw it, like `samarl-render`.

    Args:
        agent: as for `evaluate`.
        scenario: as for `evaluate`.
        case: index in the split, or a case number.
        output: file of the picture (.png, .svg or .pdf) or of the animation (.gif or .mp4).
        against: a second agent, drawn next to the first on the same case.
        split: "test", "validation" or "training".

    Returns:
        The path of the file.

    Raises:
        ConfigurationError: there is no such agent or scenario, or the case or the file is invalid.
    """
    path = Path(output)
    save = picture_writer(path)
    check_writable(path, "output")
    drivers = [_agent_for(agent, scenario)]
    if against is not None:
        drivers.append(_agent_for(against, drivers[0].scenario))
    (number,) = _case_numbers([case], split)
    trajectories = [record_episode(driver, driver.scenario, int(number)) for driver in drivers]
    titles = [title_of(*pair) for pair in zip(map(_name_of, drivers), trajectories, strict=True)]
    save(list(zip(trajectories, titles, strict=True)), path)
    return path


def _words(name: str, value: Any) -> Iterator[str]:
    """Yield the settings of a command line that have the same effect as a named argument."""
    if isinstance(value, Scenario):
        named = configuration.load_scenario(value.name)
        yield as_override(name, value.name)
        for key, item in _changes(value, named):
            yield from _words(f"{name}.{key}", item)
    elif isinstance(value, Mapping) and value:
        for key, item in value.items():
            yield from _words(f"{name}.{key}", item)
    else:
        yield as_override(name, value)


def _changes(value: Any, default: Any) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a scenario that differ, with those of its parts as mappings."""
    for name, item in changed_fields(value, default):
        is_part = dataclasses.is_dataclass(item)
        yield name, dict(_changes(item, getattr(default, name))) if is_part else item


def _agent_for(agent: Agent | Name, scenario: Name | Scenario | None) -> Agent:
    """Return the agent for a scenario, with a warning if it was not trained for such scenarios."""
    if not isinstance(agent, Agent):
        driver = load_agent(agent, scenario)
    elif scenario is None or (task := load_scenario(scenario)) == agent.scenario:
        driver = agent
    else:
        driver = agent.for_scenario(task)
        driver.label = agent.label
    if warning := driver.scope_warning():
        warnings.warn(warning, stacklevel=3)
    return driver


def _name_of(agent: Agent) -> str:
    return agent.label or type(agent).__name__


def _agent_settings(agent: Name) -> tuple[str, dict[str, Any]]:
    """Return the label and the settings of an agent that is named in one of several ways."""
    path = Path(agent)
    if path.suffix in _YAML:
        return path.stem, configuration.read_agent_config(path)
    names = configuration.available_agents()
    if str(agent) in names:
        return str(agent), configuration.load_agent_config(str(agent))
    from samarl.policies.checkpoint import find_policy, read_card  # import torch

    try:
        checkpoint = find_policy(str(path / "best.safetensors" if path.is_dir() else path))
    except ConfigurationError:
        raise ConfigurationError(
            f"agent is {str(agent)!r}; it must be the name of an agent or of a shipped policy, a "
            "YAML file, a .safetensors file, or the folder of a training; "
            f"{choice_hint(str(agent), names, 'samarl-evaluate --help lists all names')}"
        ) from None
    kind = read_card(checkpoint).policy
    if kind not in AGENT_OF_POLICY:
        raise ConfigurationError(
            f"agent is {str(agent)!r}, a {kind} policy; it must be a policy of the kinds "
            f"{', '.join(AGENT_OF_POLICY)}, or a YAML file of an agent with this checkpoint"
        )
    settings = configuration.load_agent_config(AGENT_OF_POLICY[kind])
    return path.stem, settings | {"checkpoint": str(checkpoint)}


def _case_numbers(cases: int | Iterable[int], split: str | Split) -> NDArray[np.int64]:
    """Return the numbers of cases, of which `cases` is the number or their indices or numbers."""
    if isinstance(split, str):
        if split not in Split.__members__:
            names = ", ".join(Split.__members__)
            raise ConfigurationError(f"split is {split!r}; it must be one of {names}")
        split = Split[split]
    if isinstance(cases, int | np.integer):
        return Evaluation(split=split, cases=int(cases)).case_numbers()
    try:
        numbers = [split.number(int(case)) for case in cases]
    except ValueError as error:
        raise ConfigurationError(str(error)) from None
    if not numbers or len(set(numbers)) < len(numbers):
        raise ConfigurationError(f"cases is {cases!r:.60}; it must list different cases")
    return np.array(numbers, np.int64)


def _call(label: str, scenario: Scenario, named: Scenario, numbers: NDArray[np.int64]) -> str:
    """Return the call that reproduces a row, as its provenance."""
    changes = "".join(f", {name}={_code(value)}" for name, value in changed_fields(scenario, named))
    task = f"samarl.load_scenario({named.name!r}{changes})" if changes else repr(named.name)
    first, count = int(numbers[0]), len(numbers)
    is_range = (np.diff(numbers) == 1).all()
    cases = f"range({first}, {first + count})" if is_range else str(numbers.tolist())
    return f"samarl.evaluate({label!r}, {task}, {cases})"


def _code(value: Any) -> str:
    return repr(value.name if isinstance(value, Enum) else value)


@contextlib.contextmanager
def _one_line_errors() -> Iterator[None]:
    """Raise errors of Hydra and YAML as errors that name the setting, like those of commands."""
    try:
        yield
    except ConfigurationError:
        raise
    except COMPOSITION_ERRORS as error:
        raise ConfigurationError(explain(error)) from error
