"""The settings of a training run: composed from `conf/train.yaml`, or those of a saved run."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING, DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from mrsan import ConfigurationError, Scenario
from mrsan.fields import check_numbers, number
from mrsan.suggestions import choice_hint
from samarl.configuration import (
    composed,
    hydra_tree,
    import_plugins,
    register_schemas,
    scenario_in,
    scenario_of,
)
from samarl.messages import describe
from samarl.policies.card import find_policy
from samarl.registry import checked_fields
from samarl.training.config import TrainerConfig, run_configuration
from samarl.training.curriculum import CurriculumStage, check_stages, single_stage


@dataclass
class StageConfig(CurriculumStage):
    """A stage in `conf/curriculum/`, with the changed fields of its scenario."""

    scenario: Any = field(default_factory=dict)  # `name`: the scenario they change; or only that


@dataclass
class Curriculum:
    """Schema of `conf/curriculum/`."""

    stages: list[StageConfig] = field(default_factory=list)
    guide: str | None = None  # of the stages that refer to it
    teachers: dict[str, str | None] = field(default_factory=dict)  # of the stages that refer to one


@dataclass
class Train:
    """Schema of `conf/train.yaml`."""

    run_dir: str = MISSING
    resume: str | None = None
    init_from: str | None = None
    plugins: list[str] = field(default_factory=list)
    encoder: Any = MISSING
    policy: Any = MISSING
    algorithm: Any = MISSING
    curriculum: Curriculum = field(default_factory=Curriculum)
    scenario: Any = MISSING
    worlds: int | None = number(None, 1, 10**6)
    trainer: Any = MISSING


def train_schema() -> DictConfig:
    """Return the schema of `conf/train.yaml`."""
    schema = OmegaConf.structured(Train)
    # A scenario of a stage lists changed fields only; `scenario_of` checks their names.
    OmegaConf.set_struct(schema.curriculum, False)
    return schema


@dataclass(frozen=True)
class RunSettings:
    """All that determines a training run."""

    folder: Path
    trainer: TrainerConfig
    policy: Mapping[str, Any]  # with `name` and the encoder
    algorithm: Mapping[str, Any]  # with `name`
    stages: list[CurriculumStage]
    init_from: Path | None = None
    plugins: Sequence[str] = ()

    def configuration(self) -> dict[str, Any]:
        """Return the part that is saved, and that a resumed run must have as well."""
        return run_configuration(self.trainer, self.policy, self.algorithm, self.stages)

    def to_json(self) -> str:
        """Return all settings for another process, see `settings_from_json`."""
        return json.dumps(
            {
                "configuration": self.configuration() | {"trainer": asdict(self.trainer)},
                "folder": str(self.folder),
                "init_from": None if self.init_from is None else str(self.init_from),
                "plugins": list(self.plugins),
            }
        )


def settings_from_json(text: str) -> RunSettings:
    """Return the settings of `RunSettings.to_json`; import the plugins."""
    values = json.loads(text)
    import_plugins(values["plugins"])
    init_from = values["init_from"] and Path(values["init_from"])
    return settings_from(
        values["configuration"],
        Path(values["folder"]),
        init_from=init_from,
        plugins=values["plugins"],
    )


def settings_from(
    configuration: Mapping[str, Any],
    folder: Path,
    *,
    scenario: Scenario | None = None,
    worlds: int | None = None,
    init_from: Path | None = None,
    plugins: Sequence[str] = (),
    explicit: Collection[str] = (),
) -> RunSettings:
    """Return checked settings.

    Args:
        configuration: `trainer`, `policy`, `algorithm` and `curriculum` as nested mappings.
        folder: of the run.
        scenario: replaces the curriculum by one stage if it is explicit or differs from SAMARL's.
        worlds: of this stage; None: as many as at the end of the curriculum.
        init_from: policy with the initial weights.
        plugins: imported modules.
        explicit: settings of the user, such as `scenario` or `algorithm.macro_std`, as opposed to
            those of files.

    Raises:
        ConfigurationError: a setting is not valid.
    """
    groups = {name.partition(".")[0] for name in explicit}
    stages = stages_from(configuration["curriculum"]["stages"])
    check_numbers(Train(worlds=worlds), "")
    if scenario is not None and ("scenario" in groups or scenario != Scenario()):
        if "curriculum" in groups:
            raise ConfigurationError(
                "scenario is set, and curriculum as well; one of them must be left out, because "
                "the stages of a curriculum have scenarios of their own"
            )
        stages = [single_stage(stages, scenario, worlds)]
    elif worlds is not None:
        raise ConfigurationError(
            f"worlds is {worlds}; it must be null without a scenario (the stages of a curriculum "
            "have their own)"
        )
    trainer = TrainerConfig(**checked_fields(TrainerConfig, configuration["trainer"], "trainer"))
    check_numbers(trainer, "trainer")
    policy, algorithm = configuration["policy"], configuration["algorithm"]
    _refuse_macro_settings(str(policy.get("name")), algorithm, explicit)
    return RunSettings(folder, trainer, policy, algorithm, stages, init_from, tuple(plugins))


def stages_from(values: Sequence[Mapping[str, Any] | CurriculumStage]) -> list[CurriculumStage]:
    """Return the checked stages of a curriculum.

    Raises:
        ConfigurationError: a setting is not valid.
    """
    stages = []
    for index, stage in enumerate(values):
        if not isinstance(stage, CurriculumStage):
            path = f"curriculum.stages[{index}]"
            fields = checked_fields(StageConfig, stage, path)
            fields["scenario"] = scenario_of(fields["scenario"], f"{path}.scenario")
            stage = CurriculumStage(**fields)
        stages.append(stage)
    check_stages(stages)
    return stages


def composed_settings(
    folder: Path | None,
    choices: Mapping[str, Any],
    *,
    scenario: Scenario | None,
    worlds: int | None,
    init_from: str | None,
    plugins: Sequence[str],
) -> RunSettings:
    """Return the settings of a new run.

    Args:
        folder: of the run; None: that of the recipe.
        choices: for each group of `conf/train.yaml` None, the name of a file, or a mapping of
            changed fields, in which `name` is the name of the file. For `curriculum` also a list
            of stages.
        scenario: replaces the curriculum.
        worlds: see `settings_from`.
        init_from: policy with the initial weights; None: that of the recipe.
        plugins: imported modules.

    Raises:
        ConfigurationError: a setting or a file is wrong.
    """
    given = {group: choice for group, choice in choices.items() if choice is not None}
    mappings = {group: dict(c) for group, c in given.items() if isinstance(c, Mapping)}
    names = {group: m.pop("name") for group, m in mappings.items() if "name" in m}
    names |= {group: c for group, c in given.items() if isinstance(c, str)}
    register_schemas(train_schema=train_schema())
    with hydra_tree() as loader:
        for group, name in names.items():
            options = loader.get_group_options(group)
            if name not in options:
                raise ConfigurationError(
                    f"{group} is {name!r}, which does not exist; {choice_hint(name, options)}"
                )
        config = composed("train", [f"{group}={name}" for group, name in names.items()])
    for group, mapping in mappings.items():
        try:
            OmegaConf.update(config, group, mapping)
        except OmegaConfBaseException as error:
            raise ConfigurationError(describe(error)) from error
    parts = ("trainer", "policy", "algorithm", "curriculum")
    configuration = {part: OmegaConf.to_container(config[part], resolve=True) for part in parts}
    if isinstance(stages := given.get("curriculum"), Sequence) and not isinstance(stages, str):
        configuration["curriculum"] = {"stages": stages}
    init_from = config.init_from if init_from is None else init_from
    explicit = {*given, *(f"{group}.{key}" for group, m in mappings.items() for key in m)}
    return settings_from(
        configuration,
        Path(config.run_dir) if folder is None else folder,
        scenario=scenario_in(config) if scenario is None else scenario,
        worlds=config.worlds if worlds is None else worlds,
        init_from=None if init_from is None else find_policy(init_from, "init_from"),
        plugins=plugins,
        explicit=explicit if scenario is None else {*explicit, "scenario"},
    )


def resumed_settings(
    folder: Path, trainer: Mapping[str, Any], plugins: Sequence[str] = ()
) -> RunSettings:
    """Return the settings of a saved run.

    Args:
        folder: of the run.
        trainer: changes of its `trainer`: `RESUME_OVERRIDABLE` and `steps`.
        plugins: imported modules.

    Raises:
        ConfigurationError: the folder holds no run, or a setting is not valid.
    """
    from samarl.training.run_dir import read_progress  # imports torch, which --help does not need

    saved = read_progress(folder)["configuration"]
    trainer = {**saved["trainer"], **trainer}
    return settings_from({**saved, "trainer": trainer}, folder, plugins=plugins)


def check_settings(settings: RunSettings) -> None:
    """Check settings as far as possible without starting the training run.

    Raises:
        ConfigurationError: a setting is not valid, or the folder contains another run.
    """
    from samarl.algorithms import ALGORITHMS
    from samarl.files import check_writable
    from samarl.training.resume import check_same_run
    from samarl.training.run_dir import STATE, read_progress
    from samarl.training.setup import build_policy

    build_policy(settings.policy, settings.stages[0].driver_scenario)
    for stage in settings.stages:
        stage.scenario.load_recording()
    ALGORITHMS.config(settings.algorithm)
    check_writable(settings.folder / STATE, "run_dir")
    if (settings.folder / STATE).is_file():
        progress = read_progress(settings.folder)
        check_same_run(progress, settings.configuration(), {}, settings.folder)


def _refuse_macro_settings(
    policy: str, algorithm: Mapping[str, Any], explicit: Collection[str]
) -> None:
    """Refuse explicit settings of a macro level if the policy has none.

    Recipes may have them: most are for policies of one and of two levels.

    Raises:
        ConfigurationError: a setting would have no effect.
    """
    macro = [name for name in explicit if name.startswith("algorithm.macro_")]
    if not macro:
        return
    import samarl.policies.checkpoint  # noqa: F401 (registers policies)
    from samarl.policies.policy import MACRO, POLICIES

    if MACRO not in POLICIES[policy].cls.levels:
        raise ConfigurationError(
            f"{macro[0]} is {algorithm[macro[0].removeprefix('algorithm.')]}; it must not be set "
            f"with policy.name {policy}, which has no macro level"
        )
