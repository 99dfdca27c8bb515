"""Submissions: the results of an agent on a table, in one file that others can check.

The rows follow from the records of all cases in the file, so a changed number in either is found
without the agent. Replaying some of the cases finds records that never happened.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Episodes, Scenario, World
from samarl.agents import Agent, build_agent
from samarl.agents.agent import act_and_tell
from samarl.configuration import load_scenario
from samarl.evaluation.regression import compare
from samarl.evaluation.runner import run_cases
from samarl.evaluation.summary import Row, check_row, scenario_column, summarise
from samarl.evaluation.table import column_name
from samarl.files import code_version, machine
from samarl.policies.card import find_policy

FORMAT = 1
HASHED_CASES = 20  # the first ones of every column
_BATCH = 256
_DECIMALS = 4  # of records
_LIBRARIES = ("samarl", "numpy", "numba", "torch")

Submission = dict[str, Any]


def create_submission(
    table: str,
    method: str,
    settings: Mapping[str, Any],
    scenarios: Sequence[Scenario],
    cases: NDArray[np.int64],
    command: str,
    advance: Callable[[int], Any] | None = None,
    **about: Any,
) -> Submission:
    """Play the cases of a table and return the content of the file.

    Args:
        table: its name in `conf/table/`.
        method: the name of the agent in the rows.
        settings: the configuration of the agent, as `build_agent` takes it.
        scenarios: the columns; those that the agent was not trained for are left out.
        cases: [B] case numbers.
        command: the command line that creates the file.
        advance: called with the number of episodes that have just ended, to show progress.
        **about: further entries about the agent.

    Raises:
        ConfigurationError: the agent can play no column, or one of its settings is wrong.
    """
    columns = []
    for scenario in scenarios:
        agent = build_agent(settings, scenario)
        if agent.scope_warning():
            continue
        actions = action_hash(agent, scenario, cases[:HASHED_CASES])
        agent = build_agent(settings, scenario)
        records = _encoded(run_cases(agent, scenario, cases, _BATCH, advance))
        row = _row(_decoded(records, scenario), scenario, method, command, code_version())
        columns.append({"row": row, "records": records, "actions": actions})
    if not columns:
        raise ConfigurationError(f"agent is {method!r}; it can play no column of table {table}")
    content = {
        "format": FORMAT,
        "table": table,
        "method": method,
        "agent": dict(settings),
        "weights": _weights(settings),
        **about,
        "versions": {name: version(name) for name in _LIBRARIES}
        | {"python": platform.python_version(), "machine": machine()},
        "columns": columns,
    }
    return content | {"checksum": _checksum(content)}


def action_hash(agent: Agent, scenario: Scenario, cases: NDArray[np.int64]) -> str:
    """Play cases [B] side by side and return the digest of all actions of robots on their way."""
    world = World(scenario, len(cases))
    observation = world.reset(cases)
    agent.reset(np.ones(len(cases), np.bool_))
    digest = hashlib.sha256()
    while not world.state.done.all():
        driving = ~world.state.done[:, None] & ~world.state.arrived
        action = act_and_tell(agent, observation, world)
        digest.update(np.ascontiguousarray(action[driving], np.float32).tobytes())
        observation = world.step(action).observation
    return digest.hexdigest()


def check_submission(
    content: Any, path: Path, scenarios: Sequence[Scenario]
) -> list[tuple[Scenario, Episodes]]:
    """Check that the numbers of a file agree with each other.

    Args:
        content: of the file.
        path: of the file, for messages.
        scenarios: the columns of its table.

    Returns:
        The scenario and the records of each column.

    Raises:
        ConfigurationError: it is no submission, was edited, or a number is not what its cases give.
    """
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigurationError(f"{path} is no submission of format {FORMAT}")
    if content.get("checksum") != _checksum(content):
        raise ConfigurationError(f"{path} was edited: its checksum is not that of its content")
    by_column = {scenario_column(s, load_scenario(s.name)): s for s in scenarios}
    checked = []
    for number, entry in enumerate(_columns(content, path)):
        row = entry["row"]
        check_row(row, path, number)
        scenario = next((s for c, s in by_column.items() if row == row | c._asdict()), None)
        if scenario is None:
            raise ConfigurationError(
                f"{path} has a row {number} that is of no column of table {content.get('table')}"
            )
        name = column_name(scenario_column(scenario, load_scenario(scenario.name)))
        try:
            episodes = _decoded(entry["records"], scenario)
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(
                f"{path} has no complete records of {name} ({error})"
            ) from None
        expected = _row(episodes, scenario, content["method"], row["command"], row["commit"])
        if (np.diff(episodes.case) != 1).any():
            raise ConfigurationError(f"{path} has records of {name} that are not of adjacent cases")
        for field in expected | row:
            if row.get(field) != expected.get(field):
                raise ConfigurationError(
                    f"{path} has {field} {row.get(field)!r:.40} in {name}; it must be "
                    f"{expected.get(field)!r:.40}, as its records say"
                )
        checked.append((scenario, episodes))
    return checked


def replay(
    content: Submission, path: Path, number: int, scenario: Scenario, episodes: Episodes,
    sample: NDArray[np.intp],
) -> str:  # fmt: skip
    """Play some cases of a column again and return a line on what agrees.

    Planners must act the same to the last bit. Networks round differently on another processor: if
    their actions differ, their results must lie within the intervals of those of the file.

    Args:
        content: the checked submission.
        path: of the file, for messages.
        number: index of the column in the file.
        scenario: the scenario of the column.
        episodes: the records of the column.
        sample: which of its records to compare.

    Raises:
        ConfigurationError: the replayed cases are not those of the file.
    """
    name = column_name(scenario_column(scenario, load_scenario(scenario.name)))
    settings, entry = content["agent"], content["columns"][number]
    if _weights(settings) != content["weights"]:
        raise ConfigurationError(f"{path} was played with other weights than {settings}")
    actions = action_hash(build_agent(settings, scenario), scenario, episodes.case[:HASHED_CASES])
    cases = episodes.case[sample]
    played = run_cases(build_agent(settings, scenario), scenario, cases, _BATCH)
    played = _decoded(_encoded(played), scenario)
    stored = Episodes._make(array[sample] for array in episodes)
    pairs = list(zip(stored._asdict().values(), played._asdict().values(), strict=True))
    same = [
        all(np.array_equal(a[k], b[k], equal_nan=True) for a, b in pairs) for k in range(len(cases))
    ]
    is_exact = actions == entry["actions"]
    if not is_exact and content["weights"] is None:
        raise ConfigurationError(f"{path} has other actions in {name} than a replay")
    if is_exact and not all(same):
        raise ConfigurationError(
            f"{path} has another record of case {cases[same.index(False)]} in {name} than a replay"
        )
    rows = [_row(e, scenario, content["method"], "", "") for e in (played, stored)]
    status = compare(rows[0], rows[1:])
    if status.startswith("DIFFERS"):
        raise ConfigurationError(f"{path} has other results than a replay: {status}")
    log = "same actions" if is_exact else "other actions, as on another processor"
    return f"{name}: {sum(same)} of {len(cases)} replayed cases are the same, {log}"


def submission_rows(content: Submission) -> list[Row]:
    """Return the rows of a submission, with what the leaderboard says about its agent."""
    about = {key: content.get(key) for key in ("description", "code", "privileged")}
    about["settings"] = content["agent"]
    return [entry["row"] | {"submission": about} for entry in content["columns"]]


def _columns(content: Submission, path: Path) -> list[dict[str, Any]]:
    columns = content.get("columns")
    keys = {"row", "records", "actions"}
    is_complete = (
        isinstance(content.get("agent"), dict)
        and isinstance(columns, list)
        and bool(columns)
        and all(isinstance(entry, dict) and set(entry) == keys for entry in columns)
    )
    if not is_complete:
        raise ConfigurationError(f"{path} lacks agent or columns with {', '.join(sorted(keys))}")
    return list(columns or [])


def _row(episodes: Episodes, scenario: Scenario, method: str, command: str, commit: str) -> Row:
    named = load_scenario(scenario.name)
    return summarise(episodes, scenario, method, command, commit, int(episodes.case[0]), named)


def _encoded(episodes: Episodes) -> dict[str, Any]:
    """Return records as lists; numbers that are not finite are null."""
    records = {}
    for name, array in episodes._asdict().items():
        if array.dtype == np.float64:
            array = np.where(np.isfinite(array), array.round(_DECIMALS), None)
        records[name] = array.tolist()
    return records


def _decoded(records: Mapping[str, Any], scenario: Scenario) -> Episodes:
    """Return the records of `_encoded`.

    Raises:
        ValueError: an array has another shape than the others.
    """
    hints = get_type_hints(Episodes)
    arrays = {}
    for name in Episodes._fields:
        dtype = get_args(get_args(hints[name])[1])[0]
        array = np.array(records[name], dtype)
        if dtype is np.float64 and name != "intrusion_share":
            array[np.isnan(array)] = np.inf
        cases = len(records["case"])
        if not cases or array.shape not in ((cases,), (cases, scenario.robots)):
            raise ValueError(f"{name} has shape {array.shape}")
        arrays[name] = array
    return Episodes(**arrays)


def _weights(settings: Mapping[str, Any]) -> str | None:
    """Return the digest of the weights of an agent, or None."""
    if settings.get("checkpoint") is None:
        return None
    return hashlib.sha256(find_policy(str(settings["checkpoint"])).read_bytes()).hexdigest()


def _checksum(content: Mapping[str, Any]) -> str:
    """Return the digest of all but the checksum."""
    rest = {key: value for key, value in content.items() if key != "checksum"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
