"""`--help`: every setting with its default, range, unit and meaning.

Ranges and meanings come from the fields of the settings' dataclasses (`mrsan.fields`) and from the
comments in `conf/`, so they are written in one place only.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from mrsan import Scenario
from mrsan.fields import permitted_range
from samarl.agents.build import find_class
from samarl.commands.overrides import CommandLine
from samarl.configuration import composed, hydra_tree
from samarl.files import find_folder
from samarl.prediction.training import Training

_WIDTH = 42  # of the column of settings; their meanings follow
_GROUPS = "Groups (choose with group=name; help of a choice: group=name --help):"
Meanings = dict[str, str]  # by path of a setting, such as scenario.reward.arrival


def help_text(config_name: str, command: CommandLine) -> str:
    """Return the output of `--help`.

    Args:
        config_name: name of the primary file in `conf/`.
        command: the command line; its settings are composed, so that the help describes them.
    """
    with hydra_tree(command.folder) as loader:
        config = composed(config_name, command.settings)
        chosen = config.hydra.runtime.choices.items()
        choices = {group: str(name) for group, name in chosen if not group.startswith("hydra/")}
        options = {group: loader.get_group_options(group) for group in choices}
    header, footer = config.hydra.help.header, config.hydra.help.footer
    config = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    groups = [
        f"{group}: {', '.join(name for name in names if not name.endswith('schema'))}"
        for group, names in options.items()
    ]
    plain = OmegaConf.to_yaml(OmegaConf.create(OmegaConf.to_container(config, enum_to_str=True)))
    lines = []
    meanings = _meanings(config, find_folder("conf") / f"{config_name}.yaml", choices)
    for line, path in _lines_with_paths(plain):
        meaning = meanings.get(path)
        lines.append(f"{line:<{_WIDTH}}  # {meaning}" if meaning else line)
    settings = "Settings (change with path.of.setting=value; see the examples):"
    groups = [_GROUPS, *groups, ""] if groups else []
    return "\n".join([header.strip(), "", *groups, settings, *lines, footer.strip()])


def _meanings(config: DictConfig, primary: Path, choices: dict[str, str]) -> Meanings:
    """Return the meanings of all settings, from the YAML files and from the dataclasses."""
    meanings = comments_in_yaml(primary)
    for group, choice in choices.items():
        comments = _comments_of_choice(primary.parent / group, choice)
        meanings |= {f"{group}.{path}": text for path, text in comments.items()}
    for path, cls in [*_typed_nodes(config, ""), *_further_classes(config)]:
        for name, (comment, limits) in meanings_in_class(cls).items():
            key = f"{path}{name}"
            meanings[key] = " ".join(filter(None, [meanings.get(key, comment), limits]))
    return meanings


def comments_in_yaml(path: Path) -> Meanings:
    """Return the comments at the ends of the lines of a YAML file, by path of their key."""
    comments: Meanings = {}
    for line, key in _lines_with_paths(path.read_text(encoding="utf-8")):
        match = re.match(r" *[\w-]+:(?! \{)[^#]*# (.*)$", line)
        if match:
            comments[key] = match[1]
    return comments


def _comments_of_choice(folder: Path, choice: str) -> Meanings:
    """Return the comments of a file of a group and of the files in its defaults list."""
    path = folder / f"{choice}.yaml"
    if not path.is_file():
        return {}
    content: Any = OmegaConf.load(path)
    comments: Meanings = {}
    for base in content.get("defaults", []):
        if isinstance(base, str) and base != "_self_":
            comments |= _comments_of_choice(folder, base)
    return comments | comments_in_yaml(path)


def _lines_with_paths(yaml: str) -> Iterator[tuple[str, str]]:
    """Yield each line of a YAML document with the path of its key, empty if it has none."""
    parents: list[tuple[int, str]] = []  # the enclosing keys, each with its indentation
    for line in yaml.splitlines():
        match = re.match(r"( *(?:- )?)([\w-]+):", line)
        if match:
            parents = [(depth, key) for depth, key in parents if depth < len(match[1])]
            parents.append((len(match[1]), match[2]))
        yield line, ".".join(key for _, key in parents) if match else ""


def meanings_in_class(cls: type) -> dict[str, tuple[str, str]]:
    """Return for each field of a dataclass its meaning with the unit, and its range or choices."""
    meanings: dict[str, tuple[str, str]] = {}
    for field in dataclasses.fields(cls):
        limits, metadata = "", field.metadata
        if "low" in metadata:
            limits = permitted_range(metadata)
        elif isinstance(field.default, Enum):
            limits = " | ".join(type(field.default).__members__)
        meaning = ", ".join(filter(None, [metadata.get("help"), metadata.get("unit")]))
        if meaning and isinstance(field.default, Enum):
            meaning += ":"
        meanings[field.name] = (meaning, limits)
    return meanings


def _typed_nodes(node: DictConfig, path: str) -> Iterator[tuple[str, type]]:
    """Yield the dataclasses in a configuration with the prefix of their fields."""
    kind = OmegaConf.get_type(node)
    if dataclasses.is_dataclass(kind):
        yield path, kind
    for key in map(str, node):
        child = node._get_node(key)
        if isinstance(child, DictConfig) and not child._is_none():
            yield from _typed_nodes(child, f"{path}{key}.")


def _further_classes(config: DictConfig) -> Iterator[tuple[str, Any]]:
    """Yield the dataclasses that check settings later, with the prefix of their fields."""
    if "agent" in config:
        yield "agent.", find_class(config.agent._target_)
    if "training" in config:
        yield "training.", Training
    if "trainer" in config:
        # Imported here because they take seconds, which the help of other commands does not need.
        from samarl.algorithms import ALGORITHMS
        from samarl.encoders import ENCODERS
        from samarl.policies.policy import POLICIES
        from samarl.training.config import TrainerConfig
        from samarl.training.curriculum import CurriculumStage

        yield "trainer.", TrainerConfig
        yield "curriculum.stages.", CurriculumStage
        yield from _typed_nodes(OmegaConf.structured(Scenario), "curriculum.stages.scenario.")
        yield "algorithm.", ALGORITHMS[config.algorithm.name].config
        yield "policy.", POLICIES[config.policy.name].config
        yield "encoder.", ENCODERS[config.encoder.name].config
