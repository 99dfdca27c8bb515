"""One-line messages for errors of Hydra and OmegaConf."""

from __future__ import annotations

import re
from collections.abc import Iterator
from io import TextIOWrapper
from pathlib import Path
from traceback import walk_tb

from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)

from mrsan import ConfigurationError
from mrsan.suggestions import choice_hint, closest_names, renamed


def describe(error: OmegaConfBaseException, path: str = "") -> str:
    """Return one line for an error of OmegaConf, with the field.

    `path` is the prefix of the field, such as `agent.`.
    """
    name = f"{path}{error.full_key or ''}".rstrip(": .")
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return f"{name} is not known; {_hint(error, name.rpartition(': ')[2])}"
    if isinstance(error, MissingMandatoryValue):
        return f"{name} has no value; set it with {name}=..."
    return f"{name}: {str(error).splitlines()[0]}"


def _hint(error: OmegaConfBaseException, name: str) -> str:
    """Return which field is probably meant by an unknown one."""
    key, parent = str(error.key), error.parent_node
    prefix = name.removesuffix(key)
    paths = {str(field): f"{prefix}{field}" for field in parent} if _has_fields(parent) else {}
    if not prefix:  # it may be a field of a group
        for group in list(paths):
            node = parent._get_node(group)
            if group != "hydra" and _has_fields(node):
                paths = {str(field): f"{group}.{field}" for field in node} | paths
    if (new := renamed(key, paths)) or (new := next(iter(closest_names(key, paths, 1)), None)):
        field, equals, value = new.partition("=")
        hint = f"{paths[field]}{equals}{value}"
        return f"it is now {hint}" if renamed(key, paths) else f"did you mean {hint}?"
    return choice_hint(key, paths, "see --help for all fields")


def _has_fields(node: object) -> bool:
    return isinstance(node, DictConfig) and not (node._is_none() or node._is_missing())


def explain(error: BaseException) -> str:
    """Return one line for an error of a command, or of composing its configuration."""
    file = re.match(r"In '(.+/.+)':", str(error))
    where = f"{file[1]}.yaml: " if file else ""
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.partition("/")
        names = [option for option in error.options or () if not option.endswith("schema")]
        return f"{where}{group} is {name!r}, which does not exist; {choice_hint(name, names)}"
    if isinstance(error, UnicodeDecodeError):
        return f"{_file_read(error) or 'a configuration file'} is not UTF-8 text ({error})"
    if isinstance(error, HydraException | OmegaConfBaseException):
        for cause in _causes(error):
            if isinstance(cause, OmegaConfBaseException) and cause.full_key:
                return describe(cause, where)
    if isinstance(error, OSError) and error.errno and error.filename is None:  # from Hydra, say
        return f"a file below {Path.cwd()} cannot be written ({error.strerror})"
    texts = [str(error)]
    if error.__cause__ and not isinstance(error, ConfigurationError):
        texts.append(str(error.__cause__))
    lines = [line.strip() for line in "\n".join(texts).splitlines()]
    return "; ".join(filter(None, lines)) or type(error).__name__


def _file_read(error: UnicodeDecodeError) -> str | None:
    """Return the name of the file that could not be decoded, which the error does not have."""
    files = [frame.f_locals.get("f") for frame, _ in walk_tb(error.__traceback__)]
    return next((file.name for file in files if isinstance(file, TextIOWrapper)), None)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
