"""Error messages for settings, which name the field, its value and what it must be."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable
from typing import Any, get_type_hints

from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    GrammarParseError,
    InterpolationResolutionError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)

from mrsan import ConfigurationError
from mrsan.fields import check_numbers
from mrsan.suggestions import choice_hint, closest_names, renamed

_LIST, _MAPPING = "a list such as [a,b]", "a mapping such as {name: value}"
# Patterns in OmegaConf's messages about wrong types, and what the value must be.
_REQUIREMENTS = (
    (r"converted to Integer", "a whole number"),
    (r"converted to Float", "a number"),
    (r"valid bool", "true or false"),
    (r"to string", "a string"),
    (r"is not Optional", "other than null"),
    (r"not a ListConfig", _LIST),
    (r"not a subclass|to Dict\[", _MAPPING),
    (r"^Key .* is incompatible", "a mapping whose names are strings"),
)


def unknown_field(path: str, key: str, fields: Iterable[str]) -> str:
    """Return the message for an unknown field `key` at `path`, with the one probably meant."""
    names = [name for name in fields if not name.startswith("_")]
    prefix = path.rpartition(": ")[2]
    if new := renamed(key, names):
        return f"{path}{key} is not known; it is now {prefix}{new}"
    if close := closest_names(key, names, 1):
        return f"{path}{key} is not known; did you mean {prefix}{close[0]}?"
    return f"{path}{key} is not known; {choice_hint(key, names, 'see --help for all fields')}"


def describe(error: OmegaConfBaseException, path: str = "", value: Any = None) -> str:
    """Describe an error of OmegaConf.

    Args:
        error: the error.
        path: prefix of the fields, such as `agent.`.
        value: value of the setting, for errors that do not contain it.

    Returns:
        One line that names the field, its value and what it must be.
    """
    name = f"{path}{error.full_key or ''}".removesuffix(".")
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return _unknown_field(error, name)
    if isinstance(error, MissingMandatoryValue):
        return f"{name} has no value; set it with {name}=..."
    reason = (error.msg or str(error)).splitlines()[0]
    if isinstance(error, InterpolationResolutionError | GrammarParseError):
        return f"{name} refers to a value that cannot be resolved ({reason})"
    if "not Optional" in reason:
        return f"{name} is null; {_range_of(error, None) or 'it must have a value'}"
    value = value if error.value is None else error.value
    if match := re.match(r"Merge error: \w+ is not a subclass of (\w+)\. value: (.*)", reason):
        separator = "" if not name or name.endswith(" ") else "."
        name, value = f"{name}{separator}{_field_of_type(error.object_type, match[1])}", match[2]
    if reason.startswith("Cannot merge"):  # a list with a mapping, or the reverse
        requirement = f"it must be {_LIST if error.object_type is list else _MAPPING}"
    else:
        requirement = _range_of(error, value) or _requirement(reason)
    return f"{name} is {value!r:.60}; {requirement}"


def _field_of_type(owner: Any, type_name: str) -> str:
    """Return the name of the field of a dataclass that holds a dataclass."""
    hints = get_type_hints(owner)
    return next(name for name in hints if getattr(hints[name], "__name__", "") == type_name)


def _unknown_field(error: OmegaConfBaseException, name: str) -> str:
    key, parent = str(error.key), error.parent_node
    where = name.removesuffix(key)
    if not isinstance(parent, DictConfig):
        return unknown_field(where, key, [])
    fields = [str(other) for other in parent if other != "hydra"]
    if not where and not closest_names(key, fields):  # it may be a field of a group
        paths: dict[str, str] = {}
        for group in fields:
            node = parent._get_node(group)
            if isinstance(node, DictConfig) and not node._is_none() and not node._is_missing():
                paths |= {str(other): f"{group}.{other!s}" for other in node}
        if new := renamed(key, paths):
            name, equals, content = new.partition("=")
            return f"{key} is not known; it is now {paths[name]}{equals}{content}"
        if close := closest_names(key, paths, 1):
            return f"{key} is not known; did you mean {paths[close[0]]}?"
    return unknown_field(where, key, fields)


def _range_of(error: OmegaConfBaseException, value: Any) -> str | None:
    """Return the range that `check_numbers` requires, if it refuses the value."""
    owner, key = error.object_type, str(error.key)
    if not (isinstance(owner, type) and dataclasses.is_dataclass(owner)):
        return None
    metadata = {field.name: field.metadata for field in dataclasses.fields(owner)}
    if key not in metadata:
        return None
    field = dataclasses.field(metadata=metadata[key])
    single = dataclasses.make_dataclass("Single", [(key, get_type_hints(owner)[key], field)])
    try:
        check_numbers(single(value), "")
    except ConfigurationError as refusal:
        return str(refusal).partition("; ")[2]
    return None


def _requirement(reason: str) -> str:
    """Return the requirement behind OmegaConf's reason, or the reason itself."""
    if choices := re.search(r"expected one of \[(.*)\]", reason):
        return f"it must be one of {choices[1]}"
    for pattern, requirement in _REQUIREMENTS:
        if re.search(pattern, reason):
            return f"it must be {requirement}"
    return reason
