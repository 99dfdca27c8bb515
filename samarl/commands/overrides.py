"""Command lines in the form that Hydra's grammar accepts.

Parentheses, commas, quotes, `=` and non-ASCII letters are special in that grammar, but common in
paths. Values that Hydra could not parse are therefore quoted: they are taken as text.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException

from mrsan import ConfigurationError
from samarl.configuration import in_quotes
from samarl.files import find_folder

# fmt: off
_FLAGS = {"--help", "-h", "--hydra-help", "--version", "--run", "-r", "--multirun", "-m",
          "--resolve", "--shell-completion", "-sc"}
_OPTIONS = {"--config-dir", "-cd", "--config-name", "-cn", "--config-path", "-cp", "--cfg", "-c",
            "--package", "-p", "--info", "-i", "--experimental-rerun"}
# fmt: on
_EXCLUDED_FROM_NAMES = "hydra.job.config.override_dirname.exclude_keys"
# One of several values, in quotes or up to the next comma.
_ELEMENT = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,]*?)\s*,""", re.DOTALL)


@dataclass(frozen=True)
class CommandLine:
    """The options and settings of a command."""

    options: list[str]  # for example --config-dir=FOLDER
    settings: list[str]  # name=value
    folder: Path | None = None  # of --config-dir

    @classmethod
    def parse(cls, words: Sequence[str]) -> CommandLine:
        """Parse the words of a command line, without the program.

        Raises:
            ConfigurationError: an option is unknown or has no value.
        """
        options: list[str] = []
        settings: list[str] = []
        folder = None
        remaining = iter(words)
        for word in remaining:
            if word != word.encode(errors="ignore").decode():  # bytes of another encoding
                raise ConfigurationError(f"{word!r} is not UTF-8; rename its file or folder")
            name, equals, value = word.partition("=")
            if not word.startswith("-"):
                settings.append(word)
            elif word in _FLAGS:
                options.append(word)
            elif name in _OPTIONS:
                value = value if equals else next(remaining, "")
                if not value:
                    raise ConfigurationError(f"{name} has no value; write {name}=VALUE")
                options.append(f"{name}={value}")
                if name in ("--config-dir", "-cd"):
                    folder = Path(value)
            else:
                raise ConfigurationError(
                    f"{word!r:.60} is not an option; settings are written without dashes, as in "
                    "agent=orca (see --help)"
                )
        return cls(options, settings, folder)

    @cached_property
    def is_sweep(self) -> bool:
        """Whether the command runs every combination of several values."""
        return not {"-m", "--multirun"}.isdisjoint(self.options) or (
            "hydra.mode=MULTIRUN" in self.settings
        )

    def quoted(self) -> CommandLine:
        """Quote the values that Hydra could not parse otherwise.

        Raises:
            ConfigurationError: a word is not a setting.
        """
        parser = OverridesParser.create()
        settings = [_quoted(word, self.is_sweep, parser) for word in self.settings]
        if self.is_sweep:  # cells are named by the settings in which they differ
            overrides = [parser.parse_override(word) for word in settings]
            fixed = [o.key_or_group for o in overrides if not o.is_sweep_override()]
            settings.append(f"{_EXCLUDED_FROM_NAMES}=[{','.join(fixed)}]")
        return replace(self, settings=settings)

    def words(self) -> list[str]:
        """Return the command line for Hydra, which requires options first."""
        return [*self.options, *self.settings]

    def cells(self, loader: ConfigLoader) -> Iterator[list[str]]:
        """Yield the settings of each cell of a sweep; `loader` lists the files matched by globs."""
        overrides = OverridesParser.create(loader).parse_overrides(self.settings)
        choices = {override.get_key_element(): _choices(override) for override in overrides}
        for cell in itertools.product(*choices.values()):
            yield list(cell)


def _choices(override: Override) -> list[str]:
    """Return the single-valued settings that an override expands to."""
    if override.is_sweep_override():
        key = override.get_key_element()
        return [f"{key}={value}" for value in override.sweep_string_iterator()]
    return [str(override.input_line)]


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
