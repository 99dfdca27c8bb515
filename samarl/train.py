"""`samarl-train`: train a policy, or go on with an interrupted training."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numba
from omegaconf import MISSING, DictConfig, OmegaConf

from mrsan import ConfigurationError, Scenario
from mrsan.scenario import check_numbers, number
from samarl.agents.planners.perimeter import Route
from samarl.cli import command_line, run_command


@dataclass
class Group:
    """A scenario that is trained on, and how many worlds of it."""

    worlds: int = number(MISSING, 1, 10**6)
    route: Route = Route.goal  # along which the macro level is rewarded for progress: goal, round
    scenario: Scenario = field(default_factory=Scenario)


@dataclass
class Train:
    """Schema of `conf/train.yaml`."""

    folder: str = MISSING
    initial: str | None = None
    groups: list[Group] = field(default_factory=list)
    training: Any = MISSING
    architecture: Any = MISSING
    mappo: Any = MISSING


def main() -> None:
    """Entry point."""
    run_command(train, "train", train_schema=Train)


def train(config: DictConfig) -> None:
    """Train; the same command again goes on where the last one was interrupted."""
    from samarl.agents.hierarchical import Architecture
    from samarl.algorithms.mappo import MAPPO
    from samarl.training.loop import Trainer, Training

    def build(schema: type, name: str) -> Any:
        merged = OmegaConf.merge(OmegaConf.structured(schema), config[name])
        return OmegaConf.to_object(merged)

    groups: list[Group] = OmegaConf.to_object(config.groups)  # type: ignore[assignment]
    for index, group in enumerate(groups):
        check_numbers(group, f"groups[{index}]")
    if not groups:
        raise ConfigurationError("groups is []; it must name at least one scenario to train on")
    training = build(Training, "training")
    architecture, mappo = build(Architecture, "architecture"), build(MAPPO, "mappo")
    check_numbers(architecture, "architecture")
    check_numbers(mappo, "mappo")
    if architecture.width % architecture.heads:
        raise ConfigurationError(
            f"architecture.heads is {architecture.heads}; it must divide architecture.width "
            f"({architecture.width})"
        )
    kinematics = {group.scenario.kinematics.name for group in groups}
    if len(kinematics) > 1:
        raise ConfigurationError(
            f"groups have kinematics {', '.join(sorted(kinematics))}; one policy needs one kind"
        )
    numba.set_num_threads(min(training.threads, numba.config.NUMBA_NUM_THREADS))
    command = command_line("samarl-train")
    pairs = [(group.scenario, group.worlds, group.route) for group in groups]
    folder = Path(config.folder)
    initial = None if config.initial is None else Path(config.initial)
    trainer = Trainer(folder, training, architecture, mappo, pairs, command, initial)
    if trainer.steps_done:
        print(f"going on at step {trainer.steps_done} of {training.steps}")
    trainer.run()
    print(f"written to {folder}: best validation success {100 * trainer.best:.1f} %")


if __name__ == "__main__":
    main()
