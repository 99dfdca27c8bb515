"""One-line messages for errors of Hydra, OmegaConf and YAML."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from hydra.errors import HydraException, MissingConfigException
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException
from yaml import MarkedYAMLError

from mrsan import ConfigurationError
from mrsan.suggestions import choice_hint
from samarl.messages import describe

_JARGON = re.compile(r"(full_key|object_type|reference_type)\b|See https://hydra\.cc|\^$")
# Messages of Hydra and OmegaConf, and their replacements.
_REWORDED = {
    r"Could not append to config\. An item is already at '(.+?)'": (
        r"\1 already exists; write it without +"
    ),
    r"Could not delete from config\. '(.+?)' does not exist": (
        r"~\1 deletes nothing: \1 is not known; see --help"
    ),
    r"Could not delete from config\. The value of '(.+?)' is (.+) and not (.+)\.": (
        r"~\1 has the value \3; it must be \2 or omitted"
    ),
    r"Error merging override ~([^=\n]+)": r"~\1 deletes a required field; set it instead",
    r"force-add of config groups is not supported: '\+\+([^=]+)=.*": (
        r"\1 is a group; write \1=NAME without +"
    ),
    r"Invalid loaded object type: (\w+)": (
        r"a configuration file holds only a single value (\1); it must map names to values"
    ),
    r"Multiple values for (.+?)\. ": r"\1 is already selected; write \1=NAME without +",
    r"Could not override '(.+?)'\. No match in the defaults list": (
        r"\1 is not a group of this command; see --help"
    ),
    r"Could not override '(.+?)'\.\nDid you mean to override (.+?)\?": (
        r"\1 is not known; did you mean \2?"
    ),
}


def explain(error: BaseException, folder: Path | None = None) -> str:
    """Return one line that names the field, its value and what it must be.

    Args:
        error: an error of a command, or of Hydra while composing the configuration.
        folder: the folder of `--config-dir`, whose files may be the cause.
    """
    if isinstance(error, MissingConfigException) and error.missing_cfg_file:
        group, _, name = error.missing_cfg_file.rpartition("/")
        group = group or "--config-name"
        names = [option for option in error.options or () if not option.endswith("schema")]
        file = re.match(r"In '(.+/.+)':", str(error))
        where = f"{file[1]}.yaml: " if file else ""
        return f"{where}{group} is {name!r}, which does not exist; {choice_hint(name, names)}"
    if isinstance(error, MarkedYAMLError) and error.problem_mark:
        mark = error.problem_mark
        return f"{mark.name} is not YAML: line {mark.line + 1}: {error.problem}"
    if isinstance(error, UnicodeDecodeError):
        return _not_utf8(error, folder)
    for pattern, replacement in _REWORDED.items():
        if match := re.match(pattern, str(error)):
            return match.expand(replacement)
    if isinstance(error, HydraException | OmegaConfBaseException):
        for cause in _chain(error):
            if isinstance(cause, OmegaConfBaseException):
                return _describe_setting(cause, str(error))
    message = str(error).split("Config search path:")[0] or type(error).__name__
    if isinstance(error, OSError) and error.errno and error.filename is None:  # from Hydra
        message = f"a file below {os.getcwd()} cannot be written ({error.strerror})"
    if error.__cause__ and not isinstance(error, ConfigurationError):
        message += f"\n{error.__cause__}"
    lines = [line.strip().removesuffix(":") for line in message.splitlines()]
    return "; ".join(line for line in lines if line and not _JARGON.match(line))


def _describe_setting(cause: OmegaConfBaseException, message: str) -> str:
    """Describe OmegaConf's error in the setting or file named by Hydra's message."""
    override = re.match(r"Error merging override \+*([^=]+)=(.*)", message, re.DOTALL)
    override = override or re.match(r"Could not override '([^'@]+)'()", message)
    if override:
        key, value = override.groups()
        if key.startswith(f"{cause.full_key}."):
            if isinstance(cause, ConfigKeyError | ConfigAttributeError):
                return describe(cause)
            return f"{key} is not known; {cause.full_key} has a single value"
        if str(cause.full_key).startswith(key):
            return describe(cause, value=value)
        return describe(cause, f"{key}: " if cause.full_key else key, value)
    if file := re.match(r"In '([^']+)':", message):
        if not cause.full_key:
            return f"{file[1]}.yaml is not a mapping from names to values"
        return describe(cause, f"{file[1]}.yaml: ")
    return describe(cause)


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _not_utf8(error: UnicodeDecodeError, folder: Path | None) -> str:
    """Return a message with the configuration file that cannot be decoded."""
    for path in sorted(folder.rglob("*.yaml")) if folder else ():
        if path.is_file() and error.object in path.read_bytes():
            return f"{path} is not UTF-8 text ({error.reason}); save it as UTF-8"
    return f"a configuration file is not UTF-8 text ({error.reason}); save it as UTF-8"
