"""Command lines in the form that Hydra's grammar accepts.

Parentheses, commas, quotes, `=` and non-ASCII letters are special in that grammar, but common in
paths. Values that Hydra could not parse are therefore quoted: they are taken as text.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from mrsan import ConfigurationError
from samarl.configuration import in_quotes
from samarl.files import find_folder
from samarl.user_files import reject_alias_bomb

_EXCLUDED_FROM_NAMES = "hydra.job.config.override_dirname.exclude_keys"
# One of several values, in quotes or up to the next comma.
_ELEMENT = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,]*?)\s*,""", re.DOTALL)


@dataclass(frozen=True)
class CommandLine:
    """The options and settings of a command; values are quoted where Hydra requires it."""

    options: list[str]  # for example --config-dir=FOLDER
    settings: list[str]  # name=value
    folder: Path | None  # of --config-dir
    is_sweep: bool  # it runs every combination of several values
    is_help: bool

    @classmethod
    def parse(cls, words: Sequence[str]) -> CommandLine:
        """Parse the words of a command line, without the program.

        Raises:
            ConfigurationError: an option is unknown or has no value, a word is not a setting, or a
                file in the folder has too many values.
        """
        for word in words:
            if word != word.encode(errors="ignore").decode():  # bytes of another encoding
                raise ConfigurationError(f"{word!r} is not UTF-8; rename its file or folder")
        options = get_args_parser()
        options.error = _refuse
        values = options.parse_intermixed_args(words)
        folder = None if values.config_dir is None else Path(values.config_dir)
        if folder is not None and not folder.is_dir():
            raise ConfigurationError(f"--config-dir is {str(folder)!r}; it must be a folder")
        for path in folder.rglob("*.yaml") if folder else ():
            reject_alias_bomb(path)
        is_sweep = values.multirun or "hydra.mode=MULTIRUN" in values.overrides
        parser = OverridesParser.create()
        settings = [_quoted(word, is_sweep, parser) for word in values.overrides]
        if is_sweep:  # cells are named by the settings in which they differ
            overrides = parser.parse_overrides(settings)
            fixed = [o.key_or_group for o in overrides if not o.is_sweep_override()]
            settings.append(f"{_EXCLUDED_FROM_NAMES}=[{','.join(fixed)}]")
        others = [word for word in words if word not in values.overrides]
        return cls(others, settings, folder, is_sweep, values.help)

    def words(self) -> list[str]:
        """Return the command line for Hydra, which requires options first."""
        return [*self.options, *self.settings]

    def cells(self, loader: ConfigLoader) -> list[list[str]]:
        """Return the settings of each cell of a sweep; `loader` lists the files of globs."""
        if not self.is_sweep:
            return [self.settings]
        overrides = OverridesParser.create(loader).parse_overrides(self.settings)
        return BasicSweeper.split_arguments(overrides, None)[0]


def _refuse(message: str) -> NoReturn:
    raise ConfigurationError(f"{message} (see --help)")


def _quoted(word: str, is_sweep: bool, parser: OverridesParser) -> str:
    """Quote the value of a setting if Hydra could not parse it.

    Raises:
        ConfigurationError: the word is not a setting.
    """
    key, equals, value = word.partition("=")
    if not (key and equals and _parsed(f"{key}=", parser)) or key.startswith(("+", "~")):
        raise ConfigurationError(
            f"{word!r:.60} is not a setting; write name=value, as in scenario.robots=5, without "
            "+ or ~ (see --help)"
        )
    override = _parsed(word, parser)
    if override is not None and is_sweep:
        return word
    if override is not None and not override.is_sweep_override():
        is_group = (find_folder("conf") / key).is_dir()  # its value is the name of a file
        if not is_group or isinstance(override.value(), str):
            return word
    if not is_sweep:
        return f"{key}={in_quotes(value)}"
    elements = [match[1] for match in _ELEMENT.finditer(f"{value},")]
    texts = [e if _parsed(f"x={e}", parser) else in_quotes(e) for e in elements]
    return f"{key}={','.join(texts)}"


def _parsed(word: str, parser: OverridesParser) -> Override | None:
    """Return the override as parsed by Hydra, or None if it cannot parse it."""
    try:
        return parser.parse_override(word)
    except (HydraException, ValueError, RecursionError):
        return None
