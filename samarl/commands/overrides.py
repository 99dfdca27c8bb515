"""Command lines in the form that Hydra's grammar accepts.

Parentheses, commas, quotes, `=` and non-ASCII letters are special in that grammar. Therefore paths
are quoted before Hydra parses them. Other values that it cannot parse are either quoted as strings,
so that the check of the field reports them, or rejected here.
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString, ValueType
from hydra.errors import HydraException

from mrsan import ConfigurationError
from samarl.files import find_folder

PATH_FIELDS = frozenset(
    {
        "checkpoint",
        "init_from",
        "lookahead_predictor",
        "map",
        "output",
        "predictor",
        "recording",
        "recordings",
        "results",
        "resume",
        "run_dir",
    }
)
PATH_SETTINGS = frozenset({"hydra.run.dir", "hydra.sweep.dir", "hydra.sweep.subdir"})
_FLAGS = frozenset(
    {
        "--help",
        "-h",
        "--hydra-help",
        "--version",
        "--run",
        "-r",
        "--multirun",
        "-m",
        "--resolve",
        "--shell-completion",
        "-sc",
    }
)
_OPTIONS = frozenset(
    {
        "--config-dir",
        "-cd",
        "--config-name",
        "-cn",
        "--config-path",
        "-cp",
        "--cfg",
        "-c",
        "--package",
        "-p",
        "--info",
        "-i",
        "--experimental-rerun",
    }
)
_EXCLUDED_FROM_NAMES = "hydra.job.config.override_dirname.exclude_keys"
# One of several values, in quotes or up to the next comma.
_ELEMENT = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,]*?)\s*,""", re.DOTALL)


@dataclass(frozen=True)
class CommandLine:
    """The options and settings of a command."""

    options: list[str]  # for example --config-dir, with their values
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
            elif name in _OPTIONS:
                following = [] if equals else list(itertools.islice(remaining, 1))
                if not equals and not following:
                    raise ConfigurationError(f"{word} has no value; write {word}=VALUE")
                options += [word, *following]
                if name in ("--config-dir", "-cd"):
                    folder = Path(value if equals else following[0])
            elif word in _FLAGS:
                options.append(word)
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
            ConfigurationError: a setting cannot be parsed.
        """
        parser = OverridesParser.create()
        settings = [_quoted_setting(word, self.is_sweep, parser) for word in self.settings]
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


def as_override(name: str, value: Any) -> str:
    """Return the setting of a command line that assigns a value of Python.

    Args:
        name: path of the setting.
        value: a string, number, bool, enum, path or None, or a list or mapping of them.
    """
    return f"{name}={value if isinstance(value, str) else _in_grammar(value)}"


def _in_grammar(value: Any) -> str:
    """Return a value as Hydra's grammar writes it."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_in_grammar(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_in_grammar, value)) + "]"
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, bool) or value is None:
        return str(value).lower().replace("none", "null")
    return _in_quotes(str(value)) if isinstance(value, str | Path) else str(value)


def _choices(override: Override) -> list[str]:
    """Return the single-valued settings that an override expands to."""
    key = override.get_key_element()
    if override.is_sweep_override():
        return [f"{key}={value}" for value in override.sweep_string_iterator()]
    return [str(override.input_line)]


def _quoted_setting(word: str, is_sweep: bool, parser: OverridesParser) -> str:
    key, equals, value = word.partition("=")
    name = key.lstrip("+").partition("@")[0]
    is_complete = bool(name.strip("~")) and (equals or key.startswith("~"))
    if not is_complete or _parsed(f"{key}{equals}", parser) is None:
        raise ConfigurationError(
            f"{word!r:.60} is not a setting; write name=value, as in scenario.robots=5 (see --help)"
        )
    if name.rpartition(".")[2] in PATH_FIELDS or name in PATH_SETTINGS:
        return f"{key}={_quoted_paths(value, is_sweep, parser)}"
    override = _parsed(word, parser)
    if override is None:
        if value.startswith(("[", "{")):
            raise ConfigurationError(
                f"{name} is {value!r:.60}; it must be a list [a,b] or a mapping {{a: 1, b: 2}}, "
                "with quotes around strings such as 'a (1)'"
            )
        return f"{key}={_in_quotes(value)}"
    if override.is_sweep_override() and not is_sweep:
        raise ConfigurationError(
            f"{name} is {value!r:.60}; it must be a single value (add -m to run each of them, or "
            "write [a,b] for a list)"
        )
    content = override.value()
    is_group = (find_folder("conf") / name).is_dir()
    if is_group and isinstance(content, list):
        raise ConfigurationError(f"{name} is {value!r:.60}; it must be a single name")
    if is_group and (content is None or isinstance(content, int | float)):
        return f"{key}={_in_quotes(value)}"  # the name of a file
    if isinstance(content, int) and abs(content) > sys.float_info.max:
        return f"{key}={_in_quotes(value)}"  # too large for a float
    return word


def _quoted_paths(value: str, is_sweep: bool, parser: OverridesParser) -> str:
    """Quote the value of a path field; in a sweep it may be several values."""
    if not is_sweep:
        return _quoted_path(value, parser)
    override = _parsed(f"x={value}", parser)
    if override is not None and override.value_type in (
        ValueType.CHOICE_SWEEP,
        ValueType.GLOB_CHOICE_SWEEP,
    ):
        return value
    paths = [match[1] for match in _ELEMENT.finditer(f"{value},")]
    return ",".join(_quoted_path(path, parser) or "''" for path in paths)


def _quoted_path(text: str, parser: OverridesParser) -> str:
    """Quote a path unless it is null or already quoted."""
    if not text or text.lower() == "null":
        return text
    override = _parsed(f"x={text}", parser)
    if override is not None and not override.is_sweep_override():
        if isinstance(override._value, QuotedString):
            return text
        if override.value() == text and not text.endswith(
            "\\"
        ):  # a trailing backslash would escape a comma
            return text
    return _in_quotes(text)


def _in_quotes(text: str) -> str:
    return QuotedString(text, Quote.single).with_quotes()


def _parsed(word: str, parser: OverridesParser) -> Override | None:
    """Return the override as parsed by Hydra, or None if it cannot parse it."""
    try:
        return parser.parse_override(word)
    except (HydraException, ValueError, RecursionError):
        return None
