"""Registries that map the names in YAML files and checkpoints to classes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrsan import ConfigurationError
from mrsan.fields import check_numbers
from samarl.messages import describe

T = TypeVar("T")
C = TypeVar("C", bound=type)


@dataclass(frozen=True)
class Entry(Generic[T]):
    """A registered class and the dataclass of its configuration."""

    cls: type[T]
    config: type


def needed(*, help: str = "") -> Any:
    """Return a required dataclass field that is not a number."""
    return field(metadata={"help": help})


def _check_named(values: Any, path: str) -> None:
    if not isinstance(values, Mapping | DictConfig):
        raise ConfigurationError(f"{path} is {values!r:.60}; it must map names to values")


def checked_fields(schema: Any, values: Any, path: str) -> dict[str, Any]:
    """Return the fields of a dataclass from `values`, checked for names and types.

    `path` is the prefix of the fields in errors, such as `agent`.

    Raises:
        ConfigurationError: a field is unknown, missing or of a wrong type.
    """
    _check_named(values, path)
    try:
        merged = OmegaConf.merge(OmegaConf.structured(schema), values)
        fields = OmegaConf.to_container(merged, throw_on_missing=True)
    except OverflowError:
        raise ConfigurationError(f"{path} contains a number too large for a float") from None
    except OmegaConfBaseException as error:
        raise ConfigurationError(describe(error, f"{path}.")) from error
    assert isinstance(fields, dict)
    return {str(key): value for key, value in fields.items()}


class Registry(Generic[T]):
    """Classes of one kind by name, each with the dataclass of its configuration.

    A YAML file of this kind holds `name` and the fields of that dataclass. Only registered names
    are resolved, so a file can never name arbitrary code.
    """

    def __init__(self, kind: str) -> None:
        """Create an empty registry; `kind` is its name in error messages."""
        self.kind = kind
        self._entries: dict[str, Entry[T]] = {}

    def register(self, name: str, config: type) -> Callable[[C], C]:
        """Return a decorator that registers a class and its configuration under `name`."""
        if not dataclasses.is_dataclass(config):
            raise TypeError(f"the configuration of {name} is {config!r}; it must be a dataclass")

        def add(cls: C) -> C:
            self._entries[name] = Entry(cls, config)
            return cls

        return add

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __getitem__(self, name: str) -> Entry[T]:
        if name not in self._entries:
            raise ConfigurationError(
                f"{self.kind}.name is {name!r}; it must be one of {', '.join(self._entries)} "
                "(plugins=[MODULE] imports a module that registers others)"
            )
        return self._entries[name]

    def config(self, values: Mapping[str, Any]) -> Any:
        """Return the checked configuration dataclass described by `values`, which include `name`.

        Raises:
            ConfigurationError: a field is unknown, missing or of a wrong type.
        """
        _check_named(values, self.kind)
        fields = {str(key): value for key, value in values.items() if key != "name"}
        schema = self[str(values.get("name"))].config
        config = schema(**checked_fields(schema, fields, self.kind))
        check_numbers(config, self.kind)
        return config
