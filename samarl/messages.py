"""One-line messages for errors of Hydra, OmegaConf and YAML."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from hydra.errors import HydraException, MissingConfigException
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)
from yaml import MarkedYAMLError

from mrsan import ConfigurationError
from mrsan.suggestions import choice_hint, closest_names, renamed

_JARGON = re.compile(r"(full_key|object_type|reference_type)\b|See https://hydra\.cc|\^$")


def unknown_field(path: str, key: str, fields: Iterable[str] | Mapping[str, str]) -> str:
    """Return the message for an unknown field `key` at `path`, with the one probably meant.

    Args:
        path: prefix of the field, such as `scenario.`.
        key: its name.
        fields: the known names at this path, as a mapping with the path of each.
    """
    names = [name for name in fields if not name.startswith("_")]
    paths = fields if isinstance(fields, Mapping) else {name: name for name in names}
    prefix = path.rpartition(": ")[2]
    if new := renamed(key, names):
        name, equals, value = new.partition("=")
        hint = f"it is now {prefix}{paths[name]}{equals}{value}"
    elif close := closest_names(key, names, 1):
        hint = f"did you mean {prefix}{paths[close[0]]}?"
    else:
        hint = choice_hint(key, names, "see --help for all fields")
    return f"{path}{key} is not known; {hint}"


def describe(error: OmegaConfBaseException, path: str = "") -> str:
    """Return one line for an error of OmegaConf, with the field.

    `path` is the prefix of the field, such as `agent.`.
    """
    name = f"{path}{error.full_key or ''}".removesuffix(".")
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return _describe_unknown(error, name)
    if isinstance(error, MissingMandatoryValue):
        return f"{name} has no value; set it with {name}=..."
    reason = (error.msg or str(error)).splitlines()[0].rstrip(":")
    return f"{name.rstrip(': ')}: {reason}"


def _describe_unknown(error: OmegaConfBaseException, name: str) -> str:
    key, parent = str(error.key), error.parent_node
    where = name.removesuffix(key)
    if not isinstance(parent, DictConfig):
        return f"{name} is not known; {where.removesuffix('.')} has a single value"
    paths = {str(field): str(field) for field in parent if field != "hydra"}
    if not where:  # it may be a field of a group
        for group in list(paths):
            node = parent._get_node(group)
            if isinstance(node, DictConfig) and not node._is_none() and not node._is_missing():
                paths |= {str(f): f"{group}.{f!s}" for f in node if f not in paths}
    return unknown_field(where, key, paths)


def explain(error: BaseException, folder: Path | None = None) -> str:
    """Return one line for an error of a command, or of composing its configuration.

    Files in `folder`, that of `--config-dir`, may be the cause.
    """
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.partition("/")
        names = [option for option in error.options or () if not option.endswith("schema")]
        file = re.match(r"In '(.+/.+)':", str(error))
        where = f"{file[1]}.yaml: " if file else ""
        hint = "-m runs each of several" if "," in name else choice_hint(name, names)
        return f"{where}{group} is {name!r}, which does not exist; {hint}"
    if isinstance(error, MarkedYAMLError) and error.problem_mark:
        mark = error.problem_mark
        return f"{mark.name} is not YAML: line {mark.line + 1}: {error.problem}"
    if isinstance(error, UnicodeDecodeError):
        files = folder.rglob("*.yaml") if folder else ()
        names = [str(p) for p in files if p.is_file() and error.object in p.read_bytes()]
        name = names[0] if names else "a configuration file"
        return f"{name} is not UTF-8 text ({error.reason}); save it as UTF-8"
    if isinstance(error, HydraException | OmegaConfBaseException):
        for cause in _causes(error):
            if isinstance(cause, OmegaConfBaseException) and cause.full_key:
                file = re.match(r"In '([^']+)':", str(error))
                return describe(cause, f"{file[1]}.yaml: " if file else "")
    message = str(error).split("Config search path:")[0] or type(error).__name__
    if isinstance(error, OSError) and error.errno and error.filename is None:  # from Hydra
        message = f"a file below {Path.cwd()} cannot be written ({error.strerror})"
    if error.__cause__ and not isinstance(error, ConfigurationError):
        message += f"\n{error.__cause__}"
    lines = [line.strip().removesuffix(":") for line in message.splitlines()]
    return "; ".join(line for line in lines if line and not _JARGON.match(line))


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
