"""`samarl-train`: train a policy or resume an interrupted training."""

from __future__ import annotations

import logging
import re
import shlex
import signal
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario, World
from mrsan.compile_ahead import compile_ahead
from mrsan.fields import check_numbers, number
from samarl.commands.cli import check_plugins_and_keys, command_line, prepare_hydra, run_command
from samarl.commands.composition import compose_cells
from samarl.commands.overrides import CommandLine
from samarl.configuration import scenario_in, scenario_of
from samarl.files import check_writable
from samarl.launch import copies, launcher, rank
from samarl.registry import checked_fields
from samarl.training.curriculum import CurriculumStage, check_stages, single_stage

if TYPE_CHECKING:
    from samarl.training.config import TrainerConfig
    from samarl.training.trainer import Trainer


@dataclass
class StageConfig(CurriculumStage):
    """A stage in `conf/curriculum/`, with the changed fields of its scenario."""

    scenario: Any = field(default_factory=dict)  # `name`: the scenario they change; or only that


@dataclass
class Curriculum:
    """Schema of `conf/curriculum/`."""

    stages: list[StageConfig] = field(default_factory=list)


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


def main() -> None:
    """Entry point."""
    run_command(train, "train", check_training, train_schema=train_schema())


def train(config: DictConfig) -> None:
    """Train a policy; running the same command again resumes an interrupted training."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # like Ctrl-C
    _run_in_processes(config, sys.argv[1:], command_line("samarl-train"))


def train_in_process(words: list[str]) -> Path:
    """Train as `samarl-train` does, in this process; return the folder of the run.

    Args:
        words: of the command line.

    Raises:
        ConfigurationError: or one of `COMPOSITION_ERRORS`: a setting or a file is wrong.
    """
    prepare_hydra(train_schema=train_schema())
    command = CommandLine.parse(words).quoted()
    if command.is_sweep:
        raise ConfigurationError("a sweep (-m) trains several policies; call train for each")
    outer = HydraConfig.instance().cfg
    try:
        for config in compose_cells("train", command):
            check_plugins_and_keys(config)
            text = shlex.join(["samarl-train", *words])
            folder = _run_in_processes(config, command.words(), text)
    finally:
        HydraConfig.instance().cfg = outer
    return folder


def _run_in_processes(config: DictConfig, words: list[str], command: str) -> Path:
    """Train in `trainer.processes` processes; return the folder of the run.

    Args:
        config: the composed configuration.
        words: of the command line, for the other processes.
        command: the command line, recorded as provenance.
    """
    if config.resume is not None:
        config = resumed_config(config)
    processes = settings_in(config).trainer.processes
    if processes > 1 and HydraConfig.get().mode is RunMode.MULTIRUN:
        raise ConfigurationError(
            f"trainer.processes is {processes}; it must be 1 in a sweep, which runs its cells side "
            "by side"
        )
    with copies(processes, "samarl.commands.train", words):
        return _run(config, command)


def _run(config: DictConfig, command: str) -> Path:
    """Train in this process, of possibly several; return the folder of the run."""
    trainer = build_trainer(config, command)
    if rank() == 0:
        with compile_ahead(World(trainer.stages[0].scenario)):
            pass
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it logs every replay buffer
    resume_command = shlex.join([*launcher(), "samarl-train", f"resume={trainer.run_dir.folder}"])
    if rank() > 0:
        pass  # rank 0 prints it
    elif trainer.steps_done >= trainer.config.steps:
        more = f"{resume_command} trainer.steps={2 * trainer.config.steps}"
        print(f"this run is finished; to continue it: {more}")
    elif trainer.steps_done:
        print(f"resuming at step {trainer.steps_done} of {trainer.config.steps}")
    try:
        trainer.run()
    except KeyboardInterrupt:
        advice = f"resume with: {resume_command}"
        if HydraConfig.get().mode is RunMode.MULTIRUN:
            advice = "the same command resumes the sweep"
        raise KeyboardInterrupt(advice) from None
    if rank() == 0:
        print(
            f"written to {trainer.run_dir.folder}: "
            f"best validation success {100 * trainer.progress.best_success:.1f} %"
        )
    return trainer.run_dir.folder


def resumed_config(config: DictConfig) -> DictConfig:
    """Return the configuration of the run in `config.resume`, with settings that may change.

    Raises:
        ConfigurationError: the folder contains no run, or other settings are set as well.
    """
    from samarl.training.resume import RESUME_OVERRIDABLE
    from samarl.training.run_dir import read_progress

    overridable = [*(f"trainer.{name}" for name in RESUME_OVERRIDABLE), "trainer.steps", "plugins"]
    overrides = {o.partition("=")[0]: o for o in HydraConfig.get().overrides.task}
    for name, override in overrides.items():
        if name not in ("resume", *overridable):
            raise ConfigurationError(
                f"resume is {config.resume!r} with {override}; a resumed run keeps its own "
                f"settings, except {', '.join(overridable)}"
            )
    saved = read_progress(Path(config.resume))["configuration"]
    saved["trainer"] |= {name: config.trainer[name] for name in RESUME_OVERRIDABLE}
    if "trainer.steps" in overrides:
        saved["trainer"]["steps"] = config.trainer.steps
    plain = OmegaConf.create({**OmegaConf.to_container(config), **saved})  # type: ignore[dict-item]
    own = {"run_dir": config.resume, "scenario": None}  # its stages are saved
    return OmegaConf.merge(plain, own)  # type: ignore[return-value]


def build_trainer(config: DictConfig, command: str) -> Trainer:
    """Build the trainer of a composed `conf/train.yaml`.

    Args:
        config: the composed configuration.
        command: the command line, recorded as provenance.

    Raises:
        ConfigurationError: a setting is not valid, or the folder contains another run.
    """
    from samarl.training.trainer import Trainer

    settings = settings_in(config)
    return Trainer(
        run_folder(config),
        settings.trainer,
        settings.policy,
        settings.algorithm,
        settings.stages,
        command,
        settings.init_from,
    )


def run_folder(config: DictConfig) -> Path:
    """Return the folder of a run: in a sweep without `run_dir` each cell has its own."""
    if HydraConfig.initialized() and (hydra := HydraConfig.get()).mode is RunMode.MULTIRUN:
        names = {override.partition("=")[0] for override in hydra.overrides.task}
        if names.isdisjoint(("run_dir", "resume")):
            return Path(hydra.sweep.dir) / hydra.sweep.subdir
    return Path(config.run_dir)


def check_training(config: DictConfig) -> tuple[str, Path]:
    """Check the settings of a cell of a sweep without starting its training.

    Returns:
        The setting `run_dir`, see `run_command`.

    Raises:
        ConfigurationError: a setting is not valid, or the folder contains another run.
    """
    from samarl.algorithms import ALGORITHMS
    from samarl.training.config import run_configuration
    from samarl.training.resume import check_same_run
    from samarl.training.run_dir import STATE, read_progress
    from samarl.training.setup import build_policy

    if config.resume is not None:
        config = resumed_config(config)
    settings = settings_in(config)
    build_policy(settings.policy, settings.stages[0].scenario)
    for stage in settings.stages:
        stage.scenario.load_recording()
    ALGORITHMS.config(settings.algorithm)
    folder = run_folder(config)
    check_writable(folder / STATE, "run_dir")
    if (folder / STATE).is_file():
        configuration = run_configuration(
            settings.trainer, settings.policy, settings.algorithm, settings.stages
        )
        check_same_run(read_progress(folder), configuration, {}, folder)
    return "run_dir", folder


class Settings(NamedTuple):
    """The settings of a training run."""

    stages: list[CurriculumStage]
    trainer: TrainerConfig
    policy: dict[str, Any]  # with `name`
    algorithm: dict[str, Any]  # with `name`
    init_from: Path | None


def settings_in(config: DictConfig) -> Settings:
    """Return the checked settings of a composed `conf/train.yaml`.

    Raises:
        ConfigurationError: a setting is not valid.
    """
    from samarl.policies.checkpoint import find_policy
    from samarl.training.config import TrainerConfig

    stages = stages_in(config)
    trainer = TrainerConfig(**checked_fields(TrainerConfig, config.trainer, "trainer"))
    policy, algorithm = (
        OmegaConf.to_container(config[name], resolve=True) for name in ("policy", "algorithm")
    )
    check_numbers(trainer, "trainer")
    _refuse_macro_settings(str(policy.get("name")))  # type: ignore[union-attr]
    init_from = None if config.init_from is None else find_policy(config.init_from, "init_from")
    return Settings(stages, trainer, policy, algorithm, init_from)  # type: ignore[arg-type]


def _refuse_macro_settings(policy: str) -> None:
    """Refuse settings of a macro level on the command line if the policy has none.

    Recipes may have them: most are for policies of one and of two levels.

    Raises:
        ConfigurationError: a setting would have no effect.
    """
    from samarl.policies.policy import MACRO, POLICIES

    if MACRO in POLICIES[policy].cls.levels or not HydraConfig.initialized():
        return
    for override in HydraConfig.get().overrides.task:
        name, _, value = override.lstrip("+").partition("=")
        if name.startswith("algorithm.macro_"):
            raise ConfigurationError(
                f"{name} is {value}; it must not be set with policy.name {policy}, which has no "
                "macro level"
            )


def stages_in(config: DictConfig) -> list[CurriculumStage]:
    """Return the stages of the curriculum, or one stage with the scenario if that is set.

    Raises:
        ConfigurationError: a setting is not valid.
    """
    curriculum: Any = OmegaConf.to_container(config.curriculum, resolve=True)
    stages = []
    for index, values in enumerate(curriculum["stages"]):
        path = f"curriculum.stages[{index}]"
        fields = checked_fields(StageConfig, values, path)
        fields["scenario"] = scenario_of(fields["scenario"], f"{path}.scenario")
        stages.append(CurriculumStage(**fields))
    check_stages(stages)
    check_numbers(Train(worlds=config.worlds), "")
    scenario = _single_scenario(config)
    if scenario is not None:
        return [single_stage(stages, scenario, config.worlds)]
    if config.worlds is not None:
        raise ConfigurationError(
            f"worlds is {config.worlds}; it must be null without a scenario (the stages of a "
            "curriculum have their own)"
        )
    return stages


def _single_scenario(config: DictConfig) -> Scenario | None:
    """Return the scenario that replaces the curriculum: one that is set, or differs from SAMARL's.

    Raises:
        ConfigurationError: it is not valid, or the curriculum is set as well.
    """
    if config.scenario is None:
        return None
    scenario = scenario_in(config)
    overrides = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    names = {re.split("[.=@]", override.lstrip("+~"))[0] for override in overrides}
    if "scenario" not in names and scenario == Scenario():
        return None
    if "curriculum" in names:
        raise ConfigurationError(
            "scenario is set, and curriculum as well; one of them must be left out, because the "
            "stages of a curriculum have scenarios of their own"
        )
    return scenario


if __name__ == "__main__":
    main()
