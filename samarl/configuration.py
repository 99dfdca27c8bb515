"""The Hydra configuration tree `conf/`: its schemas and its files."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.config_search_path import SearchPathQuery
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.core.plugins import Plugins
from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrsan import TASKS, ConfigurationError, Scenario
from mrsan.scenario import scenario_of_case
from mrsan.suggestions import choice_hint
from samarl.evaluation.methods import split_method
from samarl.evaluation.runner import Evaluation
from samarl.files import find_folder
from samarl.messages import describe, explain
from samarl.physics.engine import ENGINES, Engine
from samarl.policies.card import find_policy, is_policy, read_card
from samarl.user_files import YAML, PathChoices, name_of

T = TypeVar("T")


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


def register_schemas(**schemas: Any) -> None:
    """Register all that the files in `conf/` refer to: schemas, resolvers and choices by path.

    `schemas` are further dataclasses, by their names in the defaults lists.
    """
    OmegaConf.register_new_resolver("first", first, replace=True)
    OmegaConf.register_new_resolver("label", name_of, replace=True)
    Plugins.instance().register(PathChoices)
    store = ConfigStore.instance()
    for name, schema in schemas.items():
        store.store(name=name, node=schema)
    store.store(name="config_schema", node=Config)
    scenario = OmegaConf.structured(Scenario)
    for node in (scenario.crowd_settings, scenario.sensors, scenario.reward.terms):
        OmegaConf.set_struct(node, False)  # their keys depend on what is registered
    store.store(group="scenario", name="schema", node=scenario)
    for name, task in TASKS.items():  # `scenario=doorway` and `scenario=mrsan/Doorway-v0`
        node = {"defaults": ["/scenario/schema@_here_", "_self_"], **task.fields}
        store.store(group="scenario", name=name, node=node)
        folder, _, version = task.id.partition("/")
        store.store(group=f"scenario/{folder}", name=version, node=node)
    store.store(group="evaluation", name="schema", node=Evaluation)
    for engine, cls in ENGINES.items():
        store.store(group="engine", name=f"{engine}_schema", node=cls)


def scenario_in(config: DictConfig) -> Scenario:
    """Return the checked scenario of a composed configuration.

    With a case file it is that of the file, with the fields that the configuration changes.

    Raises:
        ConfigurationError: the scenario is not valid.
    """
    scenario = _object_in(config, "scenario", Scenario, "samarl")
    if scenario.case_file is None:
        return scenario
    named = Scenario()
    with contextlib.suppress(ConfigurationError):  # the name of a scenario may be the user's own
        named = load_scenario(scenario.name)
    changes = {
        name: value for name, value in vars(scenario).items() if value != getattr(named, name)
    }
    return scenario_of_case(changes.pop("case_file"), changes)


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
    with hydra_tree() as loader:
        return sorted(loader.get_group_options("agent"))


def available_scenarios() -> list[str]:
    """Return the names of tasks and of scenarios in `conf/scenario/` and in `--config-dir`."""
    with hydra_tree() as loader:
        names = set(loader.get_group_options("scenario")) - {"schema"}
    return sorted(names) + [task.id for task in TASKS.values()]


def load_agent_config(name: str, field: str = "agent") -> dict[str, Any]:
    """Return the configuration of an agent.

    Args:
        name: of its file in `conf/agent/`, or a path or policy as in `PathChoices`.
        field: name of the setting that holds `name`, for error messages.

    Raises:
        ConfigurationError: there is no such agent.
    """
    config = OmegaConf.to_container(_chosen("agent", name, field).agent)
    assert isinstance(config, dict)
    return {str(key): value for key, value in config.items()}


def load_method_config(method: str, field: str = "agents") -> dict[str, Any]:
    """Return the configuration of an agent with settings, such as `cadrl shield=true`.

    Args:
        method: the agent, see `load_agent_config`, and the settings.
        field: name of the setting that holds `method`, for error messages.

    Raises:
        ConfigurationError: there is no such agent.
    """
    name, settings = split_method(method)
    return load_agent_config(name, field) | settings


def load_scenario(name: str, field: str = "scenario") -> Scenario:
    """Return a scenario.

    Args:
        name: of a task, its file in `conf/scenario/` or in `--config-dir`, or the path of a
            YAML file in the same form.
        field: name of the setting that holds `name`, for error messages.

    Raises:
        ConfigurationError: there is no such scenario.
    """
    is_file = Path(name).suffix in YAML
    return scenario_in(_chosen("scenario", name, field)) if is_file else _named(name, field)


@cache
def _named(name: str, field: str) -> Scenario:
    return scenario_in(_chosen("scenario", name, field))


def _chosen(group: str, name: str, field: str) -> DictConfig:
    """Compose `conf/config.yaml` with a choice of a group.

    Raises:
        ConfigurationError: there is no such choice, or a file is wrong.
    """
    with hydra_tree():
        names = available_agents() if group == "agent" else available_scenarios()
        if name not in names and not PathChoices("paths", "paths://").is_config(f"{group}/{name}"):
            where = group if field == group else f"{field}: {group}"
            hint = choice_hint(
                name, names, "samarl-evaluate --help lists names; files end in .yaml"
            )
            raise ConfigurationError(f"{where} is {name!r}, which does not exist; {hint}")
        return composed("config", [f"{group}={in_quotes(name)}"])


def is_own_policy(agent: str) -> bool:
    """Return whether the name of an agent is that of a policy, see `find_policy`."""
    return agent not in available_agents() and is_policy(agent)


def training_scenario(checkpoint: str) -> Scenario:
    """Return the scenario that a policy was trained for, with all people present.

    Of the scenarios with which a curriculum ends, it is the one with the most worlds; of equals the
    first. It is SAMARL's if the card of the policy names none.

    Raises:
        ConfigurationError: there is no such policy, or its scenario cannot be read.
    """
    configuration = read_card(find_policy(checkpoint)).provenance.get("configuration") or {}
    stages = (configuration.get("curriculum") or {}).get("stages", [])
    final = [stage for stage in stages if stage.get("end", 1.0) == 1.0]
    if not final:
        return load_scenario(Scenario.name)
    fields = max(final, key=lambda stage: stage["worlds"])["scenario"]
    try:
        return replace(scenario_of(fields, f"the scenario of {checkpoint}"), humans_min=None)
    except ConfigurationError as error:
        raise ConfigurationError(f"{error}; name a scenario instead (scenario=NAME)") from error


def composed(config_name: str, settings: Sequence[str]) -> DictConfig:
    """Compose a configuration, with Hydra's own part, within `hydra_tree`.

    Args:
        config_name: the primary file in `conf/`.
        settings: what is changed in it.

    Raises:
        ConfigurationError: a setting or a file is wrong.
    """
    try:
        return compose(config_name, list(settings), return_hydra_config=True)
    except Exception as error:  # Hydra, OmegaConf and PyYAML raise whatever they come across
        raise ConfigurationError(explain(error)) from error


def in_quotes(text: str) -> str:
    """Return a text as Hydra's grammar quotes it."""
    return QuotedString(text, Quote.single).with_quotes()


@contextlib.contextmanager
def hydra_tree(folder: Path | None = None) -> Iterator[ConfigLoader]:
    """Yield the configuration loader of the running command, or one for `conf/` outside of it.

    Files in `folder` come first, as with `--config-dir`.
    """
    hydra = GlobalHydra.instance()
    if hydra.is_initialized():
        yield hydra.config_loader()
        return
    register_schemas()
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()
        if folder is not None:
            path = loader.get_search_path()
            anchor = SearchPathQuery(provider="schema")
            path.prepend("command-line", f"file://{folder.resolve()}", anchor)
            loader.repository.initialize_sources(path)
        yield loader


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
