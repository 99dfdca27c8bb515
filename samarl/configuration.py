"""The Hydra configuration tree `conf/`: its schemas and its files."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import tempfile
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
from mrsan.suggestions import choice_hint
from samarl.evaluation.runner import Evaluation
from samarl.files import find_folder
from samarl.messages import describe
from samarl.physics.engine import ENGINES, Engine

T = TypeVar("T")

MAX_VALUES = 100_000  # in a YAML file with its aliases expanded; typical files have some hundred


def open_mapping(element_type: Any = Any) -> Any:
    """Declare a mapping to which `name.key=value` may add keys; whoever reads it checks them."""
    return field(
        default_factory=lambda: DictConfig(
            {}, element_type=element_type, key_type=str, flags={"struct": False}
        )
    )


@dataclass
class Config:
    """Schema of `conf/config.yaml`: one evaluation."""

    scenario: Any = MISSING
    agent: Any = open_mapping()  # a subclass of Agent; files may leave fields at their defaults
    evaluation: Any = MISSING
    engine: Any = MISSING
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def first(*values: Any) -> Any:
    """Return the first value that is not null, for `${first:...}` in `conf/`."""
    return next(value for value in values if value is not None)


def register_schemas() -> None:
    """Register the dataclasses against which Hydra checks names and types."""
    store = ConfigStore.instance()
    store.store(name="config_schema", node=Config)
    scenario = OmegaConf.structured(Scenario)
    for node in (scenario.crowd_settings, scenario.sensors, scenario.reward.terms):
        OmegaConf.set_struct(node, False)  # their keys depend on what is registered
    store.store(group="scenario", name="schema", node=scenario)
    store.store(group="evaluation", name="schema", node=Evaluation)
    for engine, cls in ENGINES.items():
        store.store(group="engine", name=f"{engine}_schema", node=cls)


def scenario_in(config: DictConfig) -> Scenario:
    """Return the checked scenario of a composed configuration.

    Raises:
        ConfigurationError: the scenario is not valid.
    """
    return _object_in(config, "scenario", Scenario, "samarl")


def evaluation_in(config: DictConfig) -> Evaluation:
    """Return the checked evaluation settings of a composed configuration.

    Raises:
        ConfigurationError: the settings are not valid.
    """
    return _object_in(config, "evaluation", Evaluation, "default")


def engine_in(config: DictConfig) -> Engine:
    """Return the checked settings of the engine that moves the robots.

    Raises:
        ConfigurationError: the settings are not valid.
    """
    kinds: tuple[type[Engine], ...] = tuple(ENGINES.values())
    return _object_in(config, "engine", kinds, "mrsan_schema")


def _object_in(
    config: DictConfig, group: str, kind: type[T] | tuple[type[T], ...], shipped: str
) -> T:
    values = config[group]
    instance = None if values is None else OmegaConf.to_object(values)
    if not isinstance(instance, kind):
        raise ConfigurationError(
            f"{group} is {values!r:.60}; files in {group}/ must start with the defaults list "
            f"`defaults: [{shipped}]`"
        )
    return instance


def reject_alias_bombs(folder: Path) -> None:
    """Reject YAML files whose aliases expand to more than `MAX_VALUES` values.

    Hydra expands every alias, so a few lines could exhaust the memory.

    Raises:
        ConfigurationError: a file has too many values.
    """
    for path in sorted(folder.rglob("*.yaml")):
        try:
            text = path.read_text(encoding="utf-8")
            tree = yaml.compose(text, yaml.SafeLoader) if "&" in text else None
            if tree and _count_values(tree, {}) > MAX_VALUES:
                raise ConfigurationError(
                    f"{path} has more than {MAX_VALUES} values with its aliases expanded; it must "
                    "have fewer"
                )
        except (OSError, UnicodeError, yaml.YAMLError, RecursionError):
            pass  # reported when the file is used


def _count_values(node: yaml.Node, counts: dict[int, int]) -> int:
    """Return the number of values below a node, aliases expanded; `counts` caches other nodes."""
    if id(node) not in counts:
        counts[id(node)] = MAX_VALUES  # counted if the node contains itself
        entries = node.value if isinstance(node, yaml.CollectionNode) else []
        if isinstance(node, yaml.MappingNode):
            entries = [part for pair in entries for part in pair]
        counts[id(node)] = 1 + sum(_count_values(entry, counts) for entry in entries)
    return counts[id(node)]


def import_plugins(modules: Sequence[str]) -> None:
    """Import a user's modules, which register their classes.

    Raises:
        ConfigurationError: a module cannot be imported.
    """
    for name in modules:
        try:
            importlib.import_module(str(name))
        except Exception as error:
            raise ConfigurationError(
                f"plugins has {name!r}; it must be an importable module ({error})"
            ) from error


def available_agents() -> list[str]:
    """Return the names of all agents in `conf/agent/` and in `agent/` of `--config-dir`."""
    with _hydra() as loader:
        return sorted(loader.get_group_options("agent"))


def load_agent_config(name: str, field: str = "agent") -> dict[str, Any]:
    """Return the configuration of an agent of `conf/agent/`.

    Args:
        name: name of its file.
        field: name of the setting that holds `name`, for error messages.

    Raises:
        ConfigurationError: there is no such agent.
    """
    names = available_agents()
    if name not in names:
        hint = choice_hint(name, names, "samarl-evaluate --help lists them")
        raise ConfigurationError(f"{field}: there is no agent {name!r}; {hint}")
    return _agent_in_group(name, [])


def read_agent_config(path: Path) -> dict[str, Any]:
    """Return the configuration of an agent in any YAML file, in the form of `conf/agent/`."""
    with _as_choice(path, "agent") as (name, search_path):
        return _agent_in_group(name, search_path)


def _agent_in_group(name: str, search_path: list[str]) -> dict[str, Any]:
    with _hydra():
        config = OmegaConf.to_container(compose("config", [f"agent={name}", *search_path]).agent)
    assert isinstance(config, dict)
    return {str(key): value for key, value in config.items()}


@contextlib.contextmanager
def _as_choice(path: Path, group: str) -> Iterator[tuple[str, list[str]]]:
    """Make a YAML file a choice of a group, next to the files of its folder.

    Args:
        path: path of the file.
        group: name of the group.

    Yields:
        The name of the choice, and the override that adds it to Hydra's search path.

    Raises:
        ConfigurationError: there is no such file.
    """
    if not path.is_file():
        raise ConfigurationError(f"{group} is {str(path)!r}; there is no such file")
    with tempfile.TemporaryDirectory() as folder:
        links = Path(folder) / group
        links.mkdir()
        for file in path.resolve().parent.glob("*.yaml"):  # which its defaults list may name
            (links / file.name).symlink_to(file)
        name = f"file_{path.stem}"  # not the name of a file in `conf/`, which would precede it
        (links / f"{name}.yaml").symlink_to(path.resolve())
        yield name, [f"hydra.searchpath=['file://{folder}']"]


@contextlib.contextmanager
def _hydra() -> Iterator[ConfigLoader]:
    """Yield the configuration loader of the running command, or one for `conf/` outside of it."""
    hydra = GlobalHydra.instance()
    if hydra.is_initialized():
        yield hydra.config_loader()
        return
    register_schemas()
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        yield GlobalHydra.instance().config_loader()


@cache
def load_scenario(name: str, field: str = "scenario") -> Scenario:
    """Return the scenario of a file in `conf/scenario/` or in `scenario/` of `--config-dir`.

    Args:
        name: name of the file.
        field: name of the setting that holds `name`, for error messages.

    Raises:
        ConfigurationError: there is no such scenario.
    """
    with _hydra() as loader:
        choices = sorted(set(loader.get_group_options("scenario")) - {"schema"})
        if name not in choices:
            raise ConfigurationError(
                f"{field}: there is no scenario {name!r}; {choice_hint(name, choices)}"
            )
        return scenario_in(compose("config", [f"scenario={name}"]))


def read_scenario(path: Path) -> Scenario:
    """Return the scenario in any YAML file, in the form of `conf/scenario/`."""
    with _as_choice(path, "scenario") as (name, search_path), _hydra():
        return scenario_in(compose("config", [f"scenario={name}", *search_path]))


def scenario_of(column: Any, field: str = "columns") -> Scenario:
    """Return the scenario of one entry of `field`.

    Args:
        column: changed fields, and `scenario` or `name`, the name of the scenario they change
            (default: SAMARL's); or only this name.
        field: name of the setting, for error messages.

    Raises:
        ConfigurationError: a field is unknown or invalid.
    """
    if isinstance(column, str):
        column = {"name": column}
    if not isinstance(column, Mapping | DictConfig):
        raise ConfigurationError(
            f"{field} has {column!r:.60}; it must map fields of a scenario to values"
        )
    fields = dict(column)
    name = str(fields.pop("scenario", fields.get("name", Scenario.name)))
    is_complete = fields.keys() >= {f.name for f in dataclasses.fields(Scenario)}
    named = Scenario() if is_complete else load_scenario(name, field)
    try:
        scenario = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(named), fields))
    except OmegaConfBaseException as error:
        raise ConfigurationError(describe(error, f"{field}: ")) from error
    except OverflowError:
        raise ConfigurationError(
            f"{field} contains a number too large for a float: {fields!r:.60}"
        ) from None
    assert isinstance(scenario, Scenario)
    return scenario
