"""`--help`: every setting with its default, its range, its unit and what it means.

Nothing is written twice: ranges and meanings come from the fields of the dataclasses that check the
settings (`mrsan.fields`), and from the comments in `conf/`.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from mrsan import Reward, Scenario
from mrsan.fields import permitted_range
from samarl.agents.build import find_class
from samarl.commands.composition import composed, config_loader
from samarl.commands.overrides import CommandLine
from samarl.evaluation.runner import Evaluation
from samarl.files import find_folder
from samarl.prediction.training import Training

_WIDTH = 42  # of the settings; what they mean stands beside them
_GROUPS = "Groups (choose with group=name; help of a choice: group=name --help):"
Meanings = dict[str, str]  # by the path of a setting, such as scenario.reward.arrival


def help_text(config_name: str, command: CommandLine) -> str:
    """Return what `--help` prints.

    Args:
        config_name: the primary file in `conf/`.
        command: its settings are composed, so that the help describes what they choose.
    """
    folder = find_folder("conf").resolve()
    with config_loader(command.folder) as (loader, search_path):
        settings = [*command.settings, *search_path]
        config = composed(config_name, settings)
        choices = {
            group: str(choice) for group, choice in config.hydra.runtime.choices.items()
            if not group.startswith("hydra/")
        }  # fmt: skip
        options = {group: loader.get_group_options(group) for group in choices}
    described = OmegaConf.to_container(config.hydra.help)
    assert isinstance(described, dict)
    config = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    meanings = comments_in_yaml(folder / f"{config_name}.yaml")
    for group, choice in choices.items():
        of_files = _comments_of_choice(folder / group, choice)
        meanings |= {f"{group}.{path}": text for path, text in of_files.items()}
    for path, cls in _classes(config).items():
        for name, text in meanings_in_class(cls).items():
            key = f"{path}.{name}"
            note, limits = text
            meanings[key] = " ".join(filter(None, [meanings.get(key, note), limits]))
    groups = [
        f"{group}: {', '.join(name for name in names if name != 'schema')}"
        for group, names in options.items()
    ]
    return "\n".join(
        [
            described["header"].strip(), "",
            *([_GROUPS, *groups, ""] if groups else []),
            "Settings (change with path.of.setting=value; see the examples):",
            annotated(_shortened(config), meanings), described["footer"].strip(),
        ]
    )  # fmt: skip


def _shortened(config: DictConfig) -> str:
    """The settings as YAML; of what a curriculum trains on only what is not as by default."""
    content: Any = OmegaConf.to_container(config, enum_to_str=True)
    default = OmegaConf.to_container(OmegaConf.structured(Scenario), enum_to_str=True)
    assert isinstance(default, dict)
    for stage in content.get("curriculum", {}).get("stages", []):
        scenario = stage["scenario"]
        stage["scenario"] = {k: v for k, v in scenario.items() if v != default[k]}
    return OmegaConf.to_yaml(OmegaConf.create(content))


def annotated(yaml: str, meanings: Meanings) -> str:
    """The lines of a YAML document, each with what its setting means."""
    lines = []
    for line, path in _lines_with_paths(yaml):
        meaning = meanings.get(path, "")
        lines.append(f"{line:<{_WIDTH}}  # {meaning}" if meaning else line)
    return "\n".join(lines)


def comments_in_yaml(path: Path) -> Meanings:
    """The comments at the ends of the lines of a YAML file, by the path of their key."""
    found: Meanings = {}
    for line, key in _lines_with_paths(path.read_text(encoding="utf-8")):
        comment = re.match(r" *[\w-]+:(?! \{)[^#]*# (.*)$", line)
        if comment:
            found[key] = comment[1]
    return found


def _lines_with_paths(yaml: str) -> Iterator[tuple[str, str]]:
    """Each line of a YAML document with the path of its key; empty where it has none."""
    above: list[tuple[int, str]] = []  # the keys above, each with its indentation
    for line in yaml.splitlines():
        found = re.match(r"( *(?:- )?)([\w-]+):", line)
        if found:
            above = [(depth, key) for depth, key in above if depth < len(found[1])]
            above.append((len(found[1]), found[2]))
        yield line, ".".join(key for _, key in above) if found else ""


def meanings_in_class(cls: type) -> dict[str, tuple[str, str]]:
    """Return of each field of a dataclass its meaning with the unit, and its range or choices."""
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
    """The comments of a file of a group, and of those that it is based on."""
    path = folder / f"{choice}.yaml"
    if not path.is_file():
        return {}
    content: Any = OmegaConf.load(path)
    based_on = content.get("defaults", [])
    found: Meanings = {}
    for base in based_on:
        if isinstance(base, str) and base != "_self_":
            found |= _comments_of_choice(folder, base)
    return found | comments_in_yaml(path)


def _classes(config: DictConfig) -> dict[str, Any]:
    """The dataclasses that check the settings, by the path of what they check."""
    classes: dict[str, Any] = {}
    if "scenario" in config:
        classes |= {"scenario": Scenario, "scenario.reward": Reward}
    if "evaluation" in config:
        classes["evaluation"] = Evaluation
    if "agent" in config:
        classes["agent"] = find_class(config.agent._target_)
    if "training" in config:
        classes["training"] = Training
    if "trainer" in config:
        # Only here: they take seconds to import, for which help of other commands does not wait.
        from samarl.algorithms import ALGORITHMS
        from samarl.encoders import ENCODERS
        from samarl.policies.policy import POLICIES
        from samarl.training.curriculum import CurriculumStage
        from samarl.training.trainer import TrainerConfig

        classes |= {
            "trainer": TrainerConfig, "curriculum.stages": CurriculumStage,
            "curriculum.stages.scenario": Scenario, "curriculum.stages.scenario.reward": Reward,
            "algorithm": ALGORITHMS[config.algorithm.name].config,
            "policy": POLICIES[config.policy.name].config,
            "encoder": ENCODERS[config.encoder.name].config,
        }  # fmt: skip
    return classes
