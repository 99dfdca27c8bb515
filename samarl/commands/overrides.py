"""The words of a command line, in the form that Hydra's grammar reads.

In that grammar parentheses, commas, quotes, `=` and letters beyond a to z have meanings of their
own. Paths are therefore quoted here before Hydra reads them, and whatever else it cannot read is
either quoted as text, for the field's own check to judge, or refused.
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString, ValueType
from hydra.errors import HydraException

from mrsan import ConfigurationError
from samarl.files import find_folder

PATH_FIELDS = frozenset(
    {"checkpoint", "init_from", "lookahead_predictor", "output", "predictor", "recording",
     "recordings", "results", "resume", "run_dir"}
)  # fmt: skip
PATH_SETTINGS = frozenset({"hydra.run.dir", "hydra.sweep.dir", "hydra.sweep.subdir"})
_FLAGS = frozenset(
    {"--help", "-h", "--hydra-help", "--version", "--run", "-r", "--multirun", "-m", "--resolve",
     "--shell-completion", "-sc"}
)  # fmt: skip
_OPTIONS = frozenset(
    {"--config-dir", "-cd", "--config-name", "-cn", "--config-path", "-cp", "--cfg", "-c",
     "--package", "-p", "--info", "-i", "--experimental-rerun"}
)  # fmt: skip
# One of several values: in quotes, or up to the next comma.
_ELEMENT = re.compile(r"""\s*('(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^,]*?)\s*,""", re.DOTALL)


@dataclass(frozen=True)
class CommandLine:
    """The options and the settings of a command."""

    options: list[str]  # such as --config-dir, with their values
    settings: list[str]  # name=value
    folder: Path | None = None  # the user's own configuration files: --config-dir

    @classmethod
    def parse(cls, words: Sequence[str]) -> CommandLine:
        """Sort the words of a command line, without the program.

        Raises:
            ConfigurationError: names a word that is no option and no setting.
        """
        options: list[str] = []
        settings: list[str] = []
        folder = None
        remaining = iter(words)
        for word in remaining:
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
                    f"{word!r:.60} is no option; settings are written without dashes, as in "
                    "agent=orca (see --help)"
                )
        return cls(options, settings, folder)

    @cached_property
    def is_sweep(self) -> bool:
        """Whether every combination of several values is to be run."""
        return not {"-m", "--multirun"}.isdisjoint(self.options) or (
            "hydra.mode=MULTIRUN" in self.settings
        )

    def quoted(self) -> CommandLine:
        """Quote the values that Hydra would not read as they are.

        Raises:
            ConfigurationError: names a setting that cannot be read at all.
        """
        parser = OverridesParser.create()
        settings = [_quoted_setting(word, self.is_sweep, parser) for word in self.settings]
        return replace(self, settings=settings)

    def words(self) -> list[str]:
        """The command line that Hydra reads: options first, which it cannot find later."""
        return [*self.options, *self.settings]

    def cells(self, loader: ConfigLoader) -> Iterator[list[str]]:
        """The settings of each run of a sweep; `loader` knows the files that a glob matches."""
        overrides = OverridesParser.create(loader).parse_overrides(self.settings)
        choices = {override.get_key_element(): _choices(override) for override in overrides}
        for cell in itertools.product(*choices.values()):
            yield list(cell)


def _choices(override: Override) -> list[str]:
    """The settings, each with one value, that an override stands for."""
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
            f"{word!r:.60} is no setting; write name=value, as in scenario.robots=5 (see --help)"
        )
    if name.rpartition(".")[2] in PATH_FIELDS or name in PATH_SETTINGS:
        return f"{key}={_quoted_paths(value, is_sweep, parser)}"
    override = _parsed(word, parser)
    if override is None:
        if value.startswith(("[", "{")):
            raise ConfigurationError(
                f"{name} is {value!r:.60}; a list is written [a,b] and names with values "
                "{a: 1, b: 2}, with quotes around texts such as 'a (1)'"
            )
        return f"{key}={_in_quotes(value)}"
    if override.is_sweep_override() and not is_sweep:
        raise ConfigurationError(
            f"{name} is {value!r:.60}; it takes one value (add -m to run with each of them, or "
            "write [a,b] for a list)"
        )
    content = override.value()
    is_group = (find_folder("conf") / name).is_dir()
    if is_group and (content is None or isinstance(content, int | float)):
        return f"{key}={_in_quotes(value)}"  # the name of a file
    if isinstance(content, int) and abs(content) > sys.float_info.max:
        return f"{key}={_in_quotes(value)}"  # which no number can hold
    return word


def _quoted_paths(value: str, is_sweep: bool, parser: OverridesParser) -> str:
    """The value of a field that holds a path; several, between commas, in a sweep."""
    if not is_sweep:
        return _quoted_path(value, parser)
    override = _parsed(f"x={value}", parser)
    if override is not None and override.value_type in (
        ValueType.CHOICE_SWEEP, ValueType.GLOB_CHOICE_SWEEP
    ):  # fmt: skip
        return value
    paths = [match[1] for match in _ELEMENT.finditer(f"{value},")]
    return ",".join(_quoted_path(path, parser) or "''" for path in paths)


def _quoted_path(text: str, parser: OverridesParser) -> str:
    """The path `text`, unless that is null or in quotes already."""
    if not text or text.lower() == "null":
        return text
    override = _parsed(f"x={text}", parser)
    if override is not None and not override.is_sweep_override():
        if isinstance(override._value, QuotedString):
            return text
        if override.value() == text and not text.endswith("\\"):  # which would escape a comma
            return text
    return _in_quotes(text)


def _in_quotes(text: str) -> str:
    return QuotedString(text, Quote.single).with_quotes()


def _parsed(word: str, parser: OverridesParser) -> Override | None:
    """What Hydra reads; None if it cannot."""
    try:
        return parser.parse_override(word)
    except (HydraException, ValueError, RecursionError):
        return None
