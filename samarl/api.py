"""The Python API: load agents and scenarios, evaluate, record and draw."""

from __future__ import annotations

import contextlib
import sys
import warnings
from collections.abc import Callable, Iterable
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Observation, Scenario, Split, World
from mrsan.case_file import read_case_file
from mrsan.compile_ahead import compile_ahead
from mrsan.scenario import scenario_of_case
from mrsan.tasks import overridden
from samarl import configuration
from samarl.agents import Agent, ScopeWarning, build_agent
from samarl.agents.custom import Custom
from samarl.evaluation.result import EvaluationResult
from samarl.evaluation.runner import Evaluation, run_cases, warm_up
from samarl.evaluation.summary import changed_fields, summarise
from samarl.evaluation.trajectory import as_table, record_episode
from samarl.files import check_writable, code_version
from samarl.physics.engine import Engine, MrsanEngine
from samarl.policies.card import is_policy
from samarl.progress import progress_bar
from samarl.report.pictures import film_physics, picture_writer, title_of
from samarl.user_files import name_of

if TYPE_CHECKING:
    from pandas import DataFrame

Name = str | Path
AnyAgent = Agent | Name | Callable[[Observation], Any] | Any


def load_scenario(scenario: Name | Scenario = Scenario.name, **overrides: Any) -> Scenario:
    """Return a scenario by its name, with some of its fields changed.

    Args:
        scenario: the name or id of a task in `mrsan.TASKS`; the name of a file in `conf/scenario/`;
            a YAML file in the same form; a policy or the folder of a training run, for the scenario
            of its training; or a scenario.
        **overrides: fields of `mrsan.Scenario`, such as `humans=5`. With `case_file` they change
            the scenario of that file.

    Raises:
        ConfigurationError: there is no such scenario, or a value is invalid.

    Examples:
        >>> load_scenario("10p3r", humans=5).humans
        5
    """
    if overrides.get("case_file") is not None:
        return scenario_of_case(str(overrides.pop("case_file")), overrides)
    if not isinstance(scenario, Scenario):
        name = str(scenario)
        is_known = name in configuration.available_scenarios() or not is_policy(name)
        load = configuration.load_scenario if is_known else configuration.training_scenario
        scenario = load(name)
    return overridden(scenario, overrides)


def load_agent(agent: Name, scenario: Name | Scenario | None = None, **overrides: Any) -> Agent:
    """Build an agent as its YAML file describes it, with the safety shield if the file says so.

    Args:
        agent: the name of an agent in `conf/agent/`, such as `samarl` or `orca`; a YAML file in
            the same form; or a policy, which is a `.safetensors` file, the folder of a training
            run, whose best policy is loaded, or the name of an included one. A policy drives like
            the included agent with a policy of its kind, which for SAMARL's kinds has a shield.
        scenario: the task (`load_scenario` lists the forms). None: that of the training of a
            policy, otherwise SAMARL's.
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
    name = str(agent)
    settings = configuration.load_agent_config(name)
    if scenario is None:
        scenario = Scenario.name
        if configuration.is_own_policy(name):
            scenario = scenario_of_training(name)
    loaded = build_agent({**settings, **overrides}, load_scenario(scenario))
    loaded.label = name_of(name)
    return loaded


def scenario_of_training(policy: str) -> Scenario:
    """Return the scenario of the training of a policy and say so in one line.

    Raises:
        ConfigurationError: its scenario cannot be read.
    """
    scenario = configuration.training_scenario(policy)
    print(f"note: {policy} is used in the scenario of its training: {scenario}", file=sys.stderr)
    return scenario


def evaluate(
    agent: AnyAgent,
    scenario: Name | Scenario | None = None,
    cases: int | Iterable[int] = 500,
    *,
    split: str | Split = Split.test,
    batch: int = Evaluation.batch,
    name: str | None = None,
    engine: Engine | None = None,
    command: str | None = None,
) -> EvaluationResult:
    """Run an agent on fixed cases; results do not depend on the batch size.

    Args:
        agent: an agent; a name that `load_agent` accepts; a function that returns actions
            [E, N, A] in [-1, 1] for the `mrsan.Observation` of N robots in each of E worlds; or an
            object with such a method `act`, and perhaps `reset` like `Agent`. An agent that was
            created for another scenario is created again from its settings.
        scenario: the task (`load_scenario` lists the forms). None: that of the agent object, that
            of the training of a policy, or SAMARL's.
        cases: how many cases from the first one, or which: indices in the split, or case numbers.
            A scenario with a case file has only the case of the file.
        split: "test", "validation" or "training".
        batch: number of worlds simulated in parallel.
        name: the method in the row. None: the name of the agent, of the function or of the class.
        engine: what moves the robots, such as a `samarl.physics.engine.MujocoEngine`. None: the
            simulator.
        command: recorded in the row as what reproduces it. None: this call.

    Raises:
        ConfigurationError: there is no such agent or scenario, or a case is invalid.
        ActionError: an action is not valid.

    Examples:
        >>> result = evaluate("orca", load_scenario(humans=5), cases=4)
        >>> result.success.shape, result.social_score.shape
        ((4,), (4, 3))
    """
    driver = _agent_for(agent, scenario)
    title = name or _name_of(driver)
    numbers = _case_numbers(cases, split, driver.scenario)
    Evaluation(batch=batch)  # checks it
    engine = engine or MrsanEngine()
    engine.check(driver.scenario)
    task, further = driver.scenario, {}
    if isinstance(engine, MrsanEngine):
        _compile_for(driver)
    with progress_bar(total=len(numbers), desc=title, unit="case", leave=False) as bar:
        if isinstance(engine, MrsanEngine):
            episodes = run_cases(driver, task, numbers, batch, bar.update)
        else:
            from samarl.physics.runner import run_physics_cases  # imports MuJoCo

            episodes, error = run_physics_cases(driver, engine, numbers, title, bar.update)
            further["tracking_error"] = round(error, 4)
    named = None
    with contextlib.suppress(ConfigurationError):  # the name of a scenario may be the user's own
        named = configuration.load_scenario(task.name)
    if command is None:
        source = str(agent) if isinstance(agent, Name) else title
        command = _call(source, task, named or Scenario(), numbers)
    first = int(numbers[0])
    row = summarise(episodes, task, title, command, code_version(), first, named)
    row["changes"] = " ".join(filter(None, [row["changes"], *engine.changes()]))
    return EvaluationResult(task, episodes, row | further)


def record(
    agent: AnyAgent,
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
    (number,) = _case_numbers([case], split, driver.scenario)
    return as_table(record_episode(driver, driver.scenario, int(number)))


def render(
    agent: AnyAgent,
    scenario: Name | Scenario | None = None,
    case: int = 0,
    output: Name = "outputs/case.png",
    *,
    against: AnyAgent | None = None,
    split: str | Split = Split.test,
    engine: Engine | None = None,
) -> Path:
    """Run one case and draw it.

    Args:
        agent: as for `evaluate`.
        scenario: as for `evaluate`.
        case: index in the split, or a case number.
        output: file of the picture (.png, .svg or .pdf) or of the animation (.gif or .mp4).
        against: a second agent, drawn next to the first on the same case.
        split: "test", "validation" or "training".
        engine: as for `evaluate`; MuJoCo draws films of one agent.

    Returns:
        The path of the file.

    Raises:
        ConfigurationError: there is no such agent or scenario, or the case or the file is invalid.
    """
    path = Path(output)
    save = picture_writer(path)
    check_writable(path, "output")
    drivers = [_agent_for(agent, scenario)]
    (number,) = _case_numbers([case], split, drivers[0].scenario)
    if engine is not None and not isinstance(engine, MrsanEngine):
        if against is not None:
            raise ConfigurationError(f"against is {against}; it must be null with engine=mujoco")
        film_physics(drivers[0], engine, int(number), _name_of(drivers[0]), path)
        return path
    if against is not None:
        drivers.append(_agent_for(against, drivers[0].scenario))
    _compile_for(drivers[0])
    trajectories = [record_episode(driver, driver.scenario, int(number)) for driver in drivers]
    titles = [title_of(*pair) for pair in zip(map(_name_of, drivers), trajectories, strict=True)]
    save(list(zip(trajectories, titles, strict=True)), path)
    return path


def _agent_for(agent: AnyAgent, scenario: Name | Scenario | None) -> Agent:
    """Return the agent for a scenario, with a warning if it was not trained for such scenarios."""
    if isinstance(agent, Name):
        driver = load_agent(agent, scenario)
    elif not isinstance(agent, Agent):
        if not callable(getattr(agent, "act", agent)):
            raise ConfigurationError(
                f"agent is {agent!r:.60}; it must be a name, an Agent, a function of an "
                "observation or an object with `act`"
            )
        driver = Custom(load_scenario(Scenario.name if scenario is None else scenario), agent)
    elif scenario is None or (task := load_scenario(scenario)) == agent.scenario:
        driver = agent
    else:
        driver = agent.for_scenario(task)
        driver.label = agent.label
    if warning := driver.scope_warning():
        warnings.warn(warning, ScopeWarning, stacklevel=3)
    return driver


def _name_of(agent: Agent) -> str:
    return agent.label or type(agent).__name__


def _compile_for(agent: Agent) -> None:
    """Compile what evaluating an agent needs, side by side, unless it is cached."""
    with compile_ahead(World(agent.scenario)) as compiles:
        if compiles and not isinstance(agent, Custom):
            warm_up(agent.for_scenario(agent.scenario), agent.scenario)


def _case_numbers(
    cases: int | Iterable[int], split: str | Split, scenario: Scenario
) -> NDArray[np.int64]:
    """Return the numbers of cases, of which `cases` is the number or their indices or numbers."""
    if scenario.case_file is not None:
        return np.array([read_case_file(scenario.case_file).case], np.int64)
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
