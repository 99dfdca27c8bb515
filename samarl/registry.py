"""Names under which classes are known to YAML files and to checkpoints."""

from __future__ import annotations

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
    """A class and the dataclass of its numbers."""

    made: type[T]
    config: type


def needed(*, help: str = "") -> Any:
    """Declare a dataclass field without a default that is not a number.

    Args:
        help: what it means, for `--help`.
    """
    return field(metadata={"help": help})


def _check_named(values: Any, path: str) -> None:
    if not isinstance(values, Mapping | DictConfig):
        raise ConfigurationError(f"{path} is {values!r:.60}; it must be names with their values")


def checked_fields(schema: Any, values: Any, path: str) -> dict[str, Any]:
    """Return the fields of a dataclass from `values`, which must fit their names and types.

    Args:
        schema: the dataclass.
        values: names with their values.
        path: prefix of the fields in errors, such as `agent`.

    Raises:
        ConfigurationError: names the field that is unknown, missing or wrong.
    """
    _check_named(values, path)
    try:
        merged = OmegaConf.merge(OmegaConf.structured(schema), values)
        fields = OmegaConf.to_container(merged, throw_on_missing=True)
    except OverflowError:
        raise ConfigurationError(f"{path} has a number that is too large for a float") from None
    except OmegaConfBaseException as error:
        raise ConfigurationError(describe(error, f"{path}.")) from error
    assert isinstance(fields, dict)
    return {str(key): value for key, value in fields.items()}


class Registry(Generic[T]):
    """The classes of one kind, each by a name and with the dataclass of its numbers.

    A YAML file of this kind holds `name` and the fields of that dataclass. Only names that some
    imported module registered are ever resolved.
    """

    def __init__(self, kind: str) -> None:
        """Begin empty; `kind` is how errors call it."""
        self.kind = kind
        self._entries: dict[str, Entry[T]] = {}

    def register(self, name: str, config: type) -> Callable[[C], C]:
        """Make a class known by `name`, with the dataclass of its numbers."""

        def add(made: C) -> C:
            self._entries[name] = Entry(made, config)
            return made

        return add

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __getitem__(self, name: str) -> Entry[T]:
        if name not in self._entries:
            raise ConfigurationError(
                f"{self.kind}.name is {name!r}; it must be among {', '.join(self._entries)} "
                "(one's own becomes known by plugins=[its_module])"
            )
        return self._entries[name]

    def config(self, values: Mapping[str, Any]) -> Any:
        """The checked dataclass that `values` (with `name`) describes.

        Raises:
            ConfigurationError: names the field that is unknown, missing or wrong.
        """
        _check_named(values, self.kind)
        fields = {str(key): value for key, value in values.items() if key != "name"}
        schema = self[str(values.get("name"))].config
        config = schema(**checked_fields(schema, fields, self.kind))
        check_numbers(config, self.kind)
        return config
