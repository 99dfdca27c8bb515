"""The one Hydra tree `conf/`: its schemas, and what lies in it."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import yaml
from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrsan import ConfigurationError, Scenario
from samarl.evaluation.runner import Evaluation
from samarl.files import find_folder
from samarl.messages import choice_hint, describe

T = TypeVar("T")

LARGEST = 100_000  # so many values a YAML file may have; ours have some hundreds


@dataclass
class Config:
    """Schema of `conf/config.yaml`: one evaluation."""

    scenario: Any = MISSING
    agent: Any = MISSING
    evaluation: Any = MISSING
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def first(*values: Any) -> Any:
    """The first value that is not null, for `${first:...}` in `conf/`."""
    return next(value for value in values if value is not None)


def register_schemas() -> None:
    """Let Hydra check types and names against the dataclasses."""
    store = ConfigStore.instance()
    store.store(name="config_schema", node=Config)
    scenario = OmegaConf.structured(Scenario)
    OmegaConf.set_struct(scenario.crowd_settings, False)  # its names depend on the crowd model
    store.store(group="scenario", name="schema", node=scenario)
    store.store(group="evaluation", name="schema", node=Evaluation)


def scenario_in(config: DictConfig) -> Scenario:
    """The checked scenario of a composed configuration.

    Raises:
        ConfigurationError: names what is wrong with it.
    """
    return _object_in(config, "scenario", Scenario, "samarl")


def evaluation_in(config: DictConfig) -> Evaluation:
    """The checked choice of cases in a composed configuration.

    Raises:
        ConfigurationError: names what is wrong with it.
    """
    return _object_in(config, "evaluation", Evaluation, "default")


def _object_in(config: DictConfig, group: str, kind: type[T], shipped: str) -> T:
    values = config[group]
    found = None if values is None else OmegaConf.to_object(values)
    if not isinstance(found, kind):
        raise ConfigurationError(
            f"{group} is {values!r:.60}; a file of it must begin with another one: "
            f"defaults: [{shipped}]"
        )
    return found


def refuse_bombs(folder: Path) -> None:
    """Refuse YAML files whose aliases stand for more values than a configuration can have.

    Hydra would write every alias out: a few lines can ask for all memory there is.

    Raises:
        ConfigurationError: names the file.
    """
    for path in sorted(folder.rglob("*.yaml")):
        try:
            text = path.read_text(encoding="utf-8")
            tree = yaml.compose(text, yaml.SafeLoader) if "&" in text else None
            if tree and _values_in(tree, {}) > LARGEST:
                raise ConfigurationError(
                    f"{path} has more than {LARGEST} values when its aliases are written out; it "
                    "must have fewer"
                )
        except (OSError, UnicodeError, yaml.YAMLError, RecursionError):
            pass  # said when it is read, if it ever is


def _values_in(node: yaml.Node, known: dict[int, int]) -> int:
    """How many, counting an alias as often as it is used; `known` has those of other nodes."""
    if id(node) not in known:
        known[id(node)] = LARGEST  # it holds itself, if it is met again before this is done
        entries = node.value if isinstance(node, yaml.CollectionNode) else []
        if isinstance(node, yaml.MappingNode):
            entries = [part for pair in entries for part in pair]
        known[id(node)] = 1 + sum(_values_in(entry, known) for entry in entries)
    return known[id(node)]


def import_plugins(modules: Sequence[str]) -> None:
    """Import a user's modules, which make their classes known."""
    for name in modules:
        try:
            importlib.import_module(name)
        except Exception as error:
            raise ConfigurationError(
                f"plugins has {name!r}; it must be a module that can be imported ({error})"
            ) from error


def available_agents() -> list[str]:
    """The names of all agents in `conf/agent/`, and in that of `--config-dir`."""
    with _hydra() as loader:
        return sorted(loader.get_group_options("agent"))


def load_agent(name: str, field: str = "agent") -> dict[str, Any]:
    """Return the configuration of an agent of `conf/agent/`.

    Args:
        name: of its file.
        field: the setting that holds the name, for the error.

    Raises:
        ConfigurationError: there is no such agent.
    """
    names = available_agents()
    if name not in names:
        hint = choice_hint(name, names, "samarl-evaluate --help lists them")
        raise ConfigurationError(f"{field}: there is no agent {name!r}; {hint}")
    with _hydra():
        config = OmegaConf.to_container(compose("config", [f"agent={name}"]).agent)
    assert isinstance(config, dict)
    return {str(key): value for key, value in config.items()}


@contextlib.contextmanager
def _hydra() -> Iterator[ConfigLoader]:
    """The configuration of the command that runs, or outside of one that in `conf/`."""
    known = GlobalHydra.instance()
    if known.is_initialized():
        yield known.config_loader()
        return
    register_schemas()
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        yield GlobalHydra.instance().config_loader()


@cache
def load_scenario(name: str, field: str = "scenario") -> Scenario:
    """Return the scenario of a file of `conf/scenario/`, or of that of `--config-dir`.

    Args:
        name: of the file.
        field: the setting that holds the name, for the error.

    Raises:
        ConfigurationError: there is no such scenario.
    """
    with _hydra() as loader:
        choices = sorted(set(loader.get_group_options("scenario")) - {"schema"})
        if name not in choices:
            raise ConfigurationError(
                f"{field}: there is no scenario {name!r}; {choice_hint(name, choices)}"
            )
        scenario = OmegaConf.to_object(compose("config", [f"scenario={name}"]).scenario)
    assert isinstance(scenario, Scenario)
    return scenario


def scenario_of(column: Any, field: str = "columns") -> Scenario:
    """The scenario of one entry of `field`: its fields, and for the rest those of a named one.

    That is `scenario`, SAMARL's unless it is said.
    """
    if not isinstance(column, Mapping | DictConfig):
        raise ConfigurationError(
            f"{field} has {column!r:.60}; it must be fields of a scenario with their values"
        )
    fields = dict(column)
    named = load_scenario(str(fields.pop("scenario", Scenario.name)), field)
    try:
        scenario = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(named), fields))
    except OmegaConfBaseException as error:
        raise ConfigurationError(describe(error, f"{field}: ")) from error
    except OverflowError:
        raise ConfigurationError(
            f"{field} has a number that is too large for a float: {fields!r:.60}"
        ) from None
    assert isinstance(scenario, Scenario)
    return scenario
