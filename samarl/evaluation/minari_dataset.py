"""Episodes of any agent as a Minari dataset, for offline reinforcement learning."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import json
import shutil
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Scenario, World
from samarl.agents import Agent
from samarl.agents.agent import act_and_tell
from samarl.files import check_writable, code_version

_BATCH = 64  # worlds simulated in parallel
_ENVIRONMENT = "mrsan/SocialNavigation-v0"

Array = NDArray[Any]


class _Steps(NamedTuple):
    """T steps of E worlds; robots and worlds that have ended stay as they are."""

    observations: dict[str, Array]  # [T + 1, E, N, ...] each
    actions: NDArray[np.float32]  # [T, E, N, A]
    rewards: NDArray[np.float32]  # [T, E, N]
    arrived: NDArray[np.bool_]  # [T, E, N]
    terminated: NDArray[np.bool_]  # [T, E]
    truncated: NDArray[np.bool_]  # [T, E]


def check_dataset_id(dataset_id: str) -> Path:
    """Check that a dataset can be created and return its folder.

    Raises:
        ConfigurationError: Minari is not installed, or the ID is invalid or in use.
    """
    if not (find_spec("minari") and find_spec("h5py")):
        raise ConfigurationError(
            "Minari, which format=minari needs, is not installed; pip install '.[datasets]' "
            "installs it"
        )
    from minari.dataset.minari_dataset import DATASET_ID_RE
    from minari.storage import get_dataset_path

    match = DATASET_ID_RE.fullmatch(dataset_id)
    if match is None or match["version"] is None:
        raise ConfigurationError(
            f"output is {dataset_id!r}; it must be the ID of a Minari dataset, such as "
            "samarl/perimeter-v0"
        )
    folder: Path = get_dataset_path(dataset_id)
    if folder.exists():
        raise ConfigurationError(
            f"output is {dataset_id!r}, which exists in {folder}; it must be the ID of a new "
            "dataset, such as the next version"
        )
    check_writable(folder, "output")
    return folder


def write_dataset(
    dataset_id: str,
    agent: Agent,
    cases: NDArray[np.int64],
    name: str,
    command: str,
    advance: Callable[[int], Any],
) -> str:
    """Run an agent on cases and write one episode per case and robot, in this order.

    The metadata of the dataset contain the scenario, from which `mrsan.Scenario(**scenario)`
    restores it. The environment of a single robot can be recovered from the dataset.

    Args:
        dataset_id: ID of the dataset, which `check_dataset_id` has checked.
        agent: the controller of all robots.
        cases: [B] case numbers.
        name: name of the agent.
        command: command that reproduces the dataset.
        advance: called with the number of cases that have just ended, to show progress.

    Returns:
        The folder of the dataset and its size, in words.
    """
    import gymnasium
    import minari

    from mrsan.gymnasium_env import as_spaces

    settings = _as_json(agent.scenario)
    spec = None
    if agent.scenario.robots == 1:
        spec = copy.deepcopy(gymnasium.spec(_ENVIRONMENT))
        spec.kwargs = settings
    observation_space, action_space = as_spaces(agent.scenario)
    folder = check_dataset_id(dataset_id)
    episodes = robot_episodes(agent, cases, advance, _BATCH)
    with _remove_on_error(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about authors and links
        dataset = minari.create_dataset_from_buffers(
            dataset_id,
            next(episodes),
            env=spec,
            observation_space=observation_space,
            action_space=action_space,
            algorithm_name=name,
            description=f"One episode per case and robot in the scenario {agent.scenario.name}.",
        )
        for buffers in episodes:
            dataset.update_dataset_from_buffer(buffers)
        dataset.storage.update_metadata(
            {"scenario": settings, "command": command, "code_version": code_version()}
        )
    return f"{folder}: {dataset.total_episodes} episodes, {dataset.total_steps} steps"


def robot_episodes(
    agent: Agent, cases: NDArray[np.int64], advance: Callable[[int], Any], batch: int
) -> Iterator[list[Any]]:
    """Run an agent on cases and yield Minari's `EpisodeBuffer` of each robot, some cases at a time.

    The episode of a robot ends with `terminated` when it arrives, and otherwise together with the
    episode of the team: `terminated` by a collision or `truncated` by the time limit. The seed is
    the case number; the infos are `case`, `robot` (its index) and `arrived`, [T + 1] each.

    Args:
        agent: the controller of all robots.
        cases: [B] case numbers.
        advance: called with the number of cases that have just ended.
        batch: number of worlds simulated in parallel; the episodes do not depend on it.
    """
    world = World(agent.scenario, min(batch, len(cases)))
    for first in range(0, len(cases), world.worlds):
        chunk = cases[first : first + world.worlds]
        worlds = np.arange(world.worlds) < len(chunk)
        world.reset(np.resize(chunk, world.worlds), worlds)
        agent.reset(worlds)
        steps = _run(agent, world, advance)
        yield [
            _episode(steps, index, robot, int(case))
            for index, case in enumerate(chunk)
            for robot in range(agent.scenario.robots)
        ]


def _run(agent: Agent, world: World, advance: Callable[[int], Any]) -> _Steps:
    """Step all worlds until each has ended."""
    from mrsan.gymnasium_env import arrays_in_space  # imports gymnasium

    observation = world.observe()
    observations, steps = [arrays_in_space(observation)], []
    while not (done := world.state.done).all():
        action = act_and_tell(agent, observation, world).copy()
        step = world.step(action)
        observation = step.observation
        observations.append(arrays_in_space(observation))
        arrived = world.state.arrived.copy()
        steps.append((action, step.reward, arrived, step.terminated, step.truncated))
        advance(int((world.state.done & ~done).sum()))
    stacked = {key: np.stack([arrays[key] for arrays in observations]) for key in observations[0]}
    return _Steps(stacked, *map(np.stack, zip(*steps, strict=True)))


def _episode(steps: _Steps, world: int, robot: int, case: int) -> Any:
    """Return the episode of one robot."""
    from minari.data_collector import EpisodeBuffer

    arrived = steps.arrived[:, world, robot]
    terminated = arrived | steps.terminated[:, world]
    truncated = steps.truncated[:, world] & ~terminated
    length = int((terminated | truncated).argmax()) + 1
    return EpisodeBuffer(
        seed=case,
        observations={
            key: values[: length + 1, world, robot] for key, values in steps.observations.items()
        },
        actions=steps.actions[:length, world, robot],
        rewards=steps.rewards[:length, world, robot],
        terminations=terminated[:length],
        truncations=truncated[:length],
        infos={
            "case": np.full(length + 1, case),
            "robot": np.full(length + 1, robot),
            "arrived": np.concatenate([[False], arrived[:length]]),
        },
    )


def _as_json(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a scenario as JSON has them, with choices by name."""
    text = json.dumps(dataclasses.asdict(scenario), default=attrgetter("name"))
    fields: dict[str, Any] = json.loads(text)
    return fields


@contextlib.contextmanager
def _remove_on_error(folder: Path) -> Iterator[None]:
    """Remove an incomplete dataset."""
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
