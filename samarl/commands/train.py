"""`samarl-train`: train a policy, or go on with an interrupted training."""

from __future__ import annotations

import logging
import shlex
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from hydra.core.hydra_config import HydraConfig
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError
from mrsan.fields import check_numbers
from samarl.commands.cli import command_line, run_command
from samarl.launch import launcher, rank
from samarl.registry import checked_fields
from samarl.training.curriculum import CurriculumStage, check_stages

if TYPE_CHECKING:
    from samarl.training.trainer import Trainer, TrainerConfig


@dataclass
class Curriculum:
    """Schema of `conf/curriculum/`."""

    stages: list[CurriculumStage] = field(default_factory=list)


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
    trainer: Any = MISSING


def main() -> None:
    """Entry point."""
    run_command(train, "train", check_training, train_schema=Train)


def train(config: DictConfig) -> None:
    """Train; the same command again goes on where the last one was interrupted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # is like Ctrl-C
    if config.resume is not None:
        config = begun_as(config)
    trainer = build_trainer(config, command_line("samarl-train"))
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every replay
    again = shlex.join([*launcher(), "samarl-train", f"resume={trainer.run_dir.folder}"])
    if rank() > 0:
        pass  # the first process says it
    elif trainer.steps_done >= trainer.config.steps:
        print(f"this run is finished; for more: {again} trainer.steps={2 * trainer.config.steps}")
    elif trainer.steps_done:
        print(f"going on at step {trainer.steps_done} of {trainer.config.steps}")
    try:
        trainer.run()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"go on with: {again}") from None
    if rank() == 0:
        print(
            f"written to {trainer.run_dir.folder}: "
            f"best validation success {100 * trainer.best:.1f} %"
        )


def begun_as(config: DictConfig) -> DictConfig:
    """The configuration of the run in `config.resume`, with what may change from `config`.

    Raises:
        ConfigurationError: the folder holds no run, or other settings were given as well.
    """
    from samarl.training.run_dir import read_progress
    from samarl.training.trainer import RESUME_OVERRIDABLE

    free = [*(f"trainer.{name}" for name in RESUME_OVERRIDABLE), "trainer.steps", "plugins"]
    given = {o.partition("=")[0]: o for o in HydraConfig.get().overrides.task}
    for name, override in given.items():
        if name not in ("resume", *free):
            raise ConfigurationError(
                f"resume is {config.resume!r} beside {override}; a run goes on with its own "
                f"settings, beside it there may only be {', '.join(free)}"
            )
    own = read_progress(Path(config.resume))["configuration"]
    own["trainer"] |= {name: config.trainer[name] for name in RESUME_OVERRIDABLE}
    if "trainer.steps" in given:
        own["trainer"]["steps"] = config.trainer.steps
    plain = OmegaConf.create({**OmegaConf.to_container(config), **own})  # type: ignore[dict-item]
    return OmegaConf.merge(plain, {"run_dir": config.resume})  # type: ignore[return-value]


def build_trainer(config: DictConfig, command: str) -> Trainer:
    """The training run that a composed `conf/train.yaml` describes.

    Args:
        config: the composed configuration.
        command: what started it, for the record.

    Raises:
        ConfigurationError: a number is wrong, or the folder holds another run.
    """
    from samarl.training.trainer import Trainer

    settings = settings_in(config)
    return Trainer(
        Path(config.run_dir), settings.trainer, settings.policy, settings.algorithm,
        settings.stages, command, settings.init_from,
    )  # fmt: skip


def check_training(config: DictConfig) -> None:
    """Check the settings of one training of several without beginning it.

    Raises:
        ConfigurationError: names what is wrong.
    """
    from samarl.algorithms import ALGORITHMS
    from samarl.policies.checkpoint import make_policy

    if config.resume is not None:
        config = begun_as(config)
    settings = settings_in(config)
    sizes = {key: value for key, value in settings.policy.items() if key != "name"}
    make_policy(settings.policy["name"], sizes, settings.stages[0].scenario.action_size)
    for stage in settings.stages:
        stage.scenario.load_recording()
    ALGORITHMS.config(settings.algorithm)


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
        ConfigurationError: names the setting that is wrong.
    """
    from samarl.policies.checkpoint import find_policy
    from samarl.training.trainer import TrainerConfig

    stages: list[CurriculumStage] = OmegaConf.to_object(
        OmegaConf.merge(OmegaConf.structured(Curriculum), config.curriculum)
    ).stages  # type: ignore[union-attr]
    check_stages(stages)
    trainer = TrainerConfig(**checked_fields(TrainerConfig, config.trainer, "trainer"))
    policy, algorithm = (
        OmegaConf.to_container(config[name], resolve=True) for name in ("policy", "algorithm")
    )
    check_numbers(trainer, "trainer")
    init_from = None if config.init_from is None else find_policy(config.init_from, "init_from")
    return Settings(stages, trainer, policy, algorithm, init_from)  # type: ignore[arg-type]


if __name__ == "__main__":
    main()
