"""The interface of everything that drives robots, and how one is built from its YAML file."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrsan import ConfigurationError, Observation, Scenario
from mrsan.scenario import check_numbers
from samarl.policies.explanation import Explanation


@dataclass
class Agent(ABC):
    """Drives all robots of E worlds, each from its own observations alone.

    Subclasses are dataclasses: their fields are the knobs of their YAML file in `conf/agent/`.
    """

    scenario: Scenario

    def __post_init__(self) -> None:
        """Check every number of the subclass."""
        check_numbers(self, "agent")

    def reset(self, worlds: NDArray[np.bool_]) -> None:  # noqa: B027 (planners remember nothing)
        """Forget what was remembered of the worlds [E] in which an episode begins."""

    def version(self) -> str:
        """A digest of what decides its actions besides its fields: the files of its class."""
        files = {inspect.getsourcefile(base) for base in type(self).__mro__[:-2]}
        digest = hashlib.sha256()
        for file in sorted(filter(None, files)):
            digest.update(Path(file).read_bytes())
        return digest.hexdigest()[:16]

    @abstractmethod
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The action of every robot, [E, N, A] in [-1, 1]."""

    def explain(self) -> Explanation | None:
        """What led to the last action, for pictures; most agents have nothing to say."""
        return None


def build_agent(config: Mapping[str, Any], scenario: Scenario) -> Agent:
    """Make the agent that a file of `conf/agent/` describes.

    Args:
        config: `_target_`, the import path of a subclass of `Agent`, and its fields.
        scenario: the task; agents may know their robots' limits and the clock.

    Raises:
        ConfigurationError: the class cannot be found or one of its fields is wrong.
    """
    if not isinstance(config, Mapping | DictConfig):
        raise ConfigurationError(f"agent is {config!r}; it must have `_target_` and its numbers")
    values = dict(config)
    target = values.pop("_target_", None)
    agent_class = _find_class(target)
    if not (isinstance(agent_class, type) and issubclass(agent_class, Agent)):
        raise ConfigurationError(f"agent._target_ is {target!r}; it must be a subclass of Agent")
    if inspect.isabstract(agent_class):
        raise ConfigurationError(f"agent._target_ is {target!r}; it must define `act`")
    hints = get_type_hints(agent_class)
    knobs = [f for f in dataclasses.fields(agent_class) if f.init and f.name != "scenario"]
    schema = dataclasses.make_dataclass(
        agent_class.__name__, [(f.name, hints[f.name], _default(f)) for f in knobs]
    )
    try:
        merged = OmegaConf.merge(OmegaConf.structured(schema), values)
        fields = OmegaConf.to_container(merged, throw_on_missing=True)
    except OmegaConfBaseException as error:
        reason = str(error).splitlines()[0]
        raise ConfigurationError(f"agent.{getattr(error, 'full_key', '')}: {reason}") from error
    assert isinstance(fields, dict)
    knob_values: dict[str, Any] = {str(key): value for key, value in fields.items()}
    agent: Agent = agent_class(scenario=scenario, **knob_values)
    return agent


def _default(field: dataclasses.Field) -> Any:
    """The same default for the schema; what has none must be in the YAML file."""
    if field.default_factory is not dataclasses.MISSING:
        return dataclasses.field(default_factory=field.default_factory)
    missing = field.default is dataclasses.MISSING
    return dataclasses.field(default=MISSING if missing else field.default)


def _find_class(target: Any) -> Any:
    """What an import path leads to (Hydra's own `get_class` logs its errors on stderr as well)."""
    module, _, name = str(target).rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except Exception as error:
        raise ConfigurationError(
            f"agent._target_ is {target!r}; it must be the import path of an Agent ({error})"
        ) from error
