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

from mrsan import Groups, Place, Reactions, Reward, Scenario
from mrsan.fields import permitted_range
from samarl.agents.build import find_class
from samarl.commands.composition import composed, config_loader
from samarl.commands.overrides import CommandLine
from samarl.evaluation.runner import Evaluation
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
    folder = find_folder("conf").resolve()
    with config_loader(command.folder) as (loader, search_path):
        settings = [*command.settings, *search_path]
        config = composed(config_name, settings)
        choices = {
            group: str(choice)
            for group, choice in config.hydra.runtime.choices.items()
            if not group.startswith("hydra/")
        }
        options = {group: loader.get_group_options(group) for group in choices}
    template = OmegaConf.to_container(config.hydra.help)
    assert isinstance(template, dict)
    config = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    meanings = _meanings(config, folder / f"{config_name}.yaml", choices)
    groups = [
        f"{group}: {', '.join(name for name in names if not name.endswith('schema'))}"
        for group, names in options.items()
    ]
    return "\n".join(
        [
            template["header"].strip(),
            "",
            *([_GROUPS, *groups, ""] if groups else []),
            "Settings (change with path.of.setting=value; see the examples):",
            annotated(_plain(config), meanings),
            template["footer"].strip(),
        ]
    )


def _meanings(config: DictConfig, primary: Path, choices: dict[str, str]) -> Meanings:
    """Return the meanings of all settings, from the YAML files and from the dataclasses.

    Args:
        config: the composed configuration.
        primary: the primary file.
        choices: the selected file of each group.
    """
    meanings = comments_in_yaml(primary)
    for group, choice in choices.items():
        comments = _comments_of_choice(primary.parent / group, choice)
        meanings |= {f"{group}.{path}": text for path, text in comments.items()}
    for path, cls in _classes(config).items():
        for name, (comment, limits) in meanings_in_class(cls).items():
            key = f"{path}.{name}"
            meanings[key] = " ".join(filter(None, [meanings.get(key, comment), limits]))
    return meanings


def _plain(config: DictConfig) -> str:
    """Return the settings as YAML, choices by name."""
    return OmegaConf.to_yaml(OmegaConf.create(OmegaConf.to_container(config, enum_to_str=True)))


def annotated(yaml: str, meanings: Meanings) -> str:
    """Return a YAML document with the meaning of its setting behind each line."""
    lines = []
    for line, path in _lines_with_paths(yaml):
        meaning = meanings.get(path, "")
        lines.append(f"{line:<{_WIDTH}}  # {meaning}" if meaning else line)
    return "\n".join(lines)


def comments_in_yaml(path: Path) -> Meanings:
    """Return the comments at the ends of the lines of a YAML file, by path of their key."""
    comments: Meanings = {}
    for line, key in _lines_with_paths(path.read_text(encoding="utf-8")):
        match = re.match(r" *[\w-]+:(?! \{)[^#]*# (.*)$", line)
        if match:
            comments[key] = match[1]
    return comments


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


def _scenario_classes(path: str) -> dict[str, Any]:
    """Return the dataclasses of a scenario at a path of the configuration."""
    parts = {"reward": Reward, "place": Place, "reactions": Reactions, "groups": Groups}
    return {path: Scenario, **{f"{path}.{name}": cls for name, cls in parts.items()}}


def _classes(config: DictConfig) -> dict[str, Any]:
    """Return the dataclasses of the settings, by path."""
    classes: dict[str, Any] = {}
    if "scenario" in config:
        classes |= _scenario_classes("scenario")
    if "evaluation" in config:
        classes["evaluation"] = Evaluation
    if "engine" in config:
        classes["engine"] = OmegaConf.get_type(config.engine)
    if "agent" in config:
        classes["agent"] = find_class(config.agent._target_)
    if "training" in config:
        classes["training"] = Training
    if "trainer" in config:
        # Imported here because they take seconds, which the help of other commands does not need.
        from samarl.algorithms import ALGORITHMS
        from samarl.encoders import ENCODERS
        from samarl.policies.policy import POLICIES
        from samarl.training.config import TrainerConfig
        from samarl.training.curriculum import CurriculumStage

        classes |= {
            "trainer": TrainerConfig,
            "curriculum.stages": CurriculumStage,
            **_scenario_classes("curriculum.stages.scenario"),
            "algorithm": ALGORITHMS[config.algorithm.name].config,
            "policy": POLICIES[config.policy.name].config,
            "encoder": ENCODERS[config.encoder.name].config,
        }
    return classes
