"""Settings as dataclass fields: each with its range, its unit and what it means."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import field
from enum import Enum
from operator import attrgetter
from typing import Any, TypeVar, get_type_hints

import numpy as np

from mrsan.suggestions import choice_hint

T = TypeVar("T")


class ConfigurationError(ValueError):
    """A setting that cannot be used; the message names it, its value and what would be right."""


class UnknownFieldError(ConfigurationError, TypeError):
    """A keyword that names no field; also a `TypeError`, which libraries expect then."""


def number(
    default: Any,
    low: float,
    high: float,
    *,
    above: bool = False,
    kw_only: bool = False,
    unit: str = "",
    help: str = "",
) -> Any:
    """Declare a number with a default.

    Args:
        default: its default.
        low: smallest permitted value.
        high: largest permitted value.
        above: the value must exceed `low`.
        kw_only: it can only be passed by name, so it may precede fields without a default.
        unit: its unit, such as `m/s`; empty for a number without one.
        help: what it means, for `--help`.
    """
    metadata = _metadata(low, high, above, unit, help)
    return field(default=default, kw_only=kw_only, metadata=metadata)


def required(low: float, high: float, *, unit: str = "", help: str = "") -> Any:
    """Declare a number without a default; see `number`."""
    return field(metadata=_metadata(low, high, False, unit, help))


def setting(default: Any, *, kw_only: bool = False, help: str = "") -> Any:
    """Declare a switch, a choice, a text or another setting that is not a number.

    Args:
        default: its default.
        kw_only: it can only be passed by name, so it may precede fields without a default.
        help: what it means, for `--help`.
    """
    return field(default=default, kw_only=kw_only, metadata={"help": help})


def short_repr(settings: Any, others: Mapping[str, str | None] | None = None) -> str:
    """Return a dataclass as Python code with the fields that differ from their defaults.

    `others` is code for some of its fields, written at the end; None leaves a field out.
    """
    others = others or {}
    shown = []
    for f in dataclasses.fields(settings):
        value = getattr(settings, f.name)
        factory = f.default_factory
        default = f.default if factory is dataclasses.MISSING else factory()
        if f.name not in others and f.init and value != default:
            is_choice = isinstance(value, Enum)
            text = f"{type(value).__name__}.{value.name}" if is_choice else repr(value)
            shown.append(f"{f.name}={text}")
    shown += [f"{name}={code}" for name, code in others.items() if code is not None]
    return f"{type(settings).__name__}({', '.join(shown)})"


def _metadata(low: float, high: float, above: bool, unit: str, help: str) -> dict[str, Any]:
    return {"low": low, "high": high, "above": above, "unit": unit, "help": help}


def permitted_range(metadata: Any) -> str:
    """Return the range of a number, such as `(0, 360]`, from the metadata of its field."""
    bracket = "(" if metadata["above"] else "["
    return f"{bracket}{metadata['low']:g}, {metadata['high']:g}]"


_KERNEL_FORMS: dict[Any, Callable[[Any], Any]] = {float: np.float32, int: int, bool: bool}


def kernel_form(hint: Any) -> Callable[[Any], Any] | None:
    """Return what converts values of a type to the form that kernels take; None if they do not."""
    if isinstance(hint, type) and issubclass(hint, Enum):
        return attrgetter("value")
    return _KERNEL_FORMS.get(hint)


def from_mapping(cls: type[T], value: Any, path: str) -> T:
    """Return an instance of a dataclass, or the one whose fields a mapping names.

    Args:
        cls: the dataclass.
        value: an instance, or a mapping from some names of its fields to values.
        path: of the setting in messages, such as `scenario.reward`.

    Raises:
        ConfigurationError: it is neither, or a field is unknown.
    """
    if isinstance(value, cls):
        return value
    if not isinstance(value, Mapping):
        raise ConfigurationError(
            f"{path} is {value!r:.60}; it must be a {cls.__name__} or a mapping with fields of it"
        )
    names = [f.name for f in dataclasses.fields(cls)]  # type: ignore[arg-type]
    for name in value:
        if name not in names:
            hint = choice_hint(str(name), names, f"{cls.__name__} has no such field")
            raise ConfigurationError(f"{path}.{name} is not known; {hint}")
    return cls(**value)


def check_numbers(config: Any, path: str) -> None:
    """Check every number, switch and choice of a dataclass; names of choices become their enums.

    `path` is the prefix of its fields in messages, such as `scenario`; it may be empty.

    Raises:
        ConfigurationError: names the first invalid field, its value and its range.
    """
    hints = get_type_hints(type(config))
    for f in dataclasses.fields(config):
        name, value, hint = f"{path}.{f.name}", getattr(config, f.name), hints[f.name]
        name = name.removeprefix(".")
        if isinstance(hint, type) and issubclass(hint, Enum):
            if isinstance(value, str) and value in hint.__members__:
                setattr(config, f.name, hint[value])
            elif not isinstance(value, hint):
                choices = ", ".join(hint.__members__)
                raise ConfigurationError(f"{name} is {value!r}; it must be one of {choices}")
        elif hint is bool:
            if not isinstance(value, bool):
                raise ConfigurationError(f"{name} is {value!r}; it must be true or false")
        elif "low" in f.metadata:
            _check_number(name, value, hint, f.metadata)


def _check_number(name: str, value: Any, hint: Any, metadata: Any) -> None:
    types = getattr(hint, "__args__", (hint,))
    optional = type(None) in types
    if optional and value is None:
        return
    integral = int in types
    number_types = (int, np.integer) if integral else (int, float, np.integer, np.floating)
    low, high, above = metadata["low"], metadata["high"], metadata["above"]
    valid = isinstance(value, number_types) and not isinstance(value, bool) and low <= value <= high
    if not valid or (above and value == low):
        verb = "be a whole number" if integral else "lie"
        null = " or be null" if optional else ""
        raise ConfigurationError(
            f"{name} is {value!r}; it must {verb} in {permitted_range(metadata)}{null}"
        )
