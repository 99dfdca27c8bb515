"""`samarl-train`: train a policy, or go on with an interrupted training."""

from __future__ import annotations

import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.hydra_config import HydraConfig
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError
from mrsan.scenario import check_numbers
from samarl.commands.cli import command_line, run_command
from samarl.training.curriculum import Group

if TYPE_CHECKING:
    from samarl.training.loop import Trainer


@dataclass
class Train:
    """Schema of `conf/train.yaml`."""

    folder: str = MISSING
    resume: str | None = None
    initial: str | None = None
    plugins: list[str] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    training: Any = MISSING
    architecture: Any = MISSING
    mappo: Any = MISSING


def main() -> None:
    """Entry point."""
    run_command(train, "train", train_schema=Train)


def train(config: DictConfig) -> None:
    """Train; the same command again goes on where the last one was interrupted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # is like Ctrl-C: saves
    if config.resume is not None:
        config = begun_as(config)
    trainer = build_trainer(config, command_line("samarl-train"))
    if trainer.steps_done:
        print(f"going on at step {trainer.steps_done} of {trainer.training.steps}")
    trainer.run()
    print(f"written to {trainer.folder}: best validation success {100 * trainer.best:.1f} %")


def begun_as(config: DictConfig) -> DictConfig:
    """The configuration of the run in the folder `config.resume`, with `FREE` from `config`.

    Raises:
        ConfigurationError: the folder holds no run, or other settings were given as well.
    """
    from samarl.training.loop import FREE, own_settings

    free = [*(f"training.{name}" for name in FREE), "plugins"]
    for override in HydraConfig.get().overrides.task:
        if override.partition("=")[0] not in ("resume", *free):
            raise ConfigurationError(
                f"resume is {config.resume!r} beside {override}; a run goes on with its own "
                f"settings, beside it there may only be {', '.join(free)}"
            )
    own = own_settings(Path(config.resume))
    own["training"] |= {name: config.training[name] for name in FREE}
    return OmegaConf.merge(config, own, {"folder": config.resume})  # type: ignore[return-value]


def build_trainer(config: DictConfig, command: str) -> Trainer:
    """The training run that a composed `conf/train.yaml` describes.

    Args:
        config: the composed configuration.
        command: what started it, for the record.

    Raises:
        ConfigurationError: a number is wrong, or the folder holds another run.
    """
    from samarl.algorithms.mappo import MAPPO
    from samarl.policies.checkpoint import find_policy
    from samarl.policies.hierarchical import Architecture
    from samarl.training.loop import Trainer, Training

    def build(schema: type, name: str) -> Any:
        merged = OmegaConf.merge(OmegaConf.structured(schema), config[name])
        return OmegaConf.to_object(merged)

    groups: list[Group] = OmegaConf.to_object(config.groups)  # type: ignore[assignment]
    for index, group in enumerate(groups):
        group.check(f"groups[{index}]")
    for share in (0.0, *(group.end for group in groups)):
        if share < 1.0 and not any(group.begin <= share < group.end for group in groups):
            raise ConfigurationError(
                f"groups has none for the time from {share:g} of the training on; it must have one"
            )
    training = build(Training, "training")
    architecture, mappo = build(Architecture, "architecture"), build(MAPPO, "mappo")
    check_numbers(architecture, "architecture")
    check_numbers(mappo, "mappo")
    if architecture.width % architecture.heads:
        raise ConfigurationError(
            f"architecture.heads is {architecture.heads}; it must divide architecture.width "
            f"({architecture.width})"
        )
    initial = None if config.initial is None else find_policy(config.initial, "initial")
    return Trainer(Path(config.folder), training, architecture, mappo, groups, command, initial)


if __name__ == "__main__":
    main()
