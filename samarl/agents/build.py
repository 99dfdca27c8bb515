"""Construction of agents from the files of `conf/agent/`."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Mapping
from typing import Any, get_type_hints

from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError, Scenario
from samarl.agents.agent import Agent
from samarl.agents.shielded import Shielded
from samarl.planning.shield import Shield
from samarl.registry import checked_fields


def build_agent(config: Mapping[str, Any], scenario: Scenario) -> Agent:
    """Build the agent described by a file of `conf/agent/`.

    Args:
        config: `_target_`, the import path of a subclass of `Agent`; the fields of this class; and
            `shield`: true to apply the safety shield, or the fields of `Shield` to change.
        scenario: the task. Agents may use the limits of their robots and the time step.

    Raises:
        ConfigurationError: the class cannot be found or one of its fields is wrong.
    """
    if not isinstance(config, Mapping | DictConfig):
        raise ConfigurationError(
            f"agent is {config!r}; it must be a mapping with `_target_` and other fields "
            "(samarl.load_agent builds an agent by its name)"
        )
    values = dict(config)
    target = values.pop("_target_", None)
    if target is None:
        raise ConfigurationError("agent has no _target_; it must be the import path of an Agent")
    agent_class = find_class(target)
    if not (isinstance(agent_class, type) and issubclass(agent_class, Agent)):
        raise ConfigurationError(f"agent._target_ is {target!r}; it must be a subclass of Agent")
    if inspect.isabstract(agent_class):
        raise ConfigurationError(f"agent._target_ is {target!r}; it must define `act`")
    own = vars(agent_class)
    has_settings = inspect.get_annotations(agent_class) or (values and "__init__" in own)
    if has_settings and "__dataclass_fields__" not in own:
        raise ConfigurationError(
            f"agent._target_ is {target!r}; it must be a dataclass: write @dataclass above "
            f"`class {agent_class.__name__}`"
        )
    hints = get_type_hints(agent_class)
    settings = [f for f in dataclasses.fields(agent_class) if f.init and f.name != "scenario"]
    schema = dataclasses.make_dataclass(
        agent_class.__name__,
        [
            *((f.name, hints[f.name], _schema_field(f)) for f in settings),
            ("shield", Any, dataclasses.field(default=False)),
        ],
    )
    fields = checked_fields(schema, values, "agent")
    shield = _shield(fields.pop("shield"))
    agent: Agent = agent_class(scenario=scenario, **fields)
    return agent if shield is None else Shielded(scenario, agent, shield)


def _shield(config: Any) -> Shield | None:
    """Return the shield configured by `agent.shield`, if any."""
    if isinstance(config, Mapping | DictConfig):
        return Shield(**checked_fields(Shield, config, "agent.shield"))
    if not isinstance(config, bool):
        raise ConfigurationError(
            f"agent.shield is {config!r}; it must be true, false or fields of Shield"
        )
    return Shield() if config else None


def _schema_field(field: dataclasses.Field) -> Any:
    """Return the field for the schema; fields without a default are required in the YAML file."""
    if field.default_factory is not dataclasses.MISSING:
        return dataclasses.field(default_factory=field.default_factory, metadata=field.metadata)
    default = MISSING if field.default is dataclasses.MISSING else field.default
    return dataclasses.field(default=default, metadata=field.metadata)


def find_class(target: Any) -> Any:
    """Return the object at an import path.

    Hydra's own `get_class` would also log its errors to stderr.

    Raises:
        ConfigurationError: nothing can be imported from `target`.
    """
    module, _, name = str(target).rpartition(".")
    try:
        return getattr(importlib.import_module(module), name)
    except Exception as error:
        raise ConfigurationError(
            f"agent._target_ is {target!r}; it must be the import path of an Agent ({error})"
        ) from error
