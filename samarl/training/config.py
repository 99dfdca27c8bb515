"""Settings of a training run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from mrsan.fields import number, required, setting
from samarl.training.curriculum import CurriculumStage

MAX_SEEDS = 2**20


@dataclass
class TrainerConfig:
    """Schema of `conf/trainer/`."""

    steps: int = required(1, 10**12, help="environment steps, of all worlds together")
    rollout: int = required(1, 100000, help="steps per world between updates")
    seed: int = required(0, MAX_SEEDS - 1, help="seed of the weights, the noise and the cases")
    threads: int = required(1, 1024, help="threads of torch and the simulator in each process")
    validate_every: int = required(1, 10**12, help="environment steps between validations")
    validation_cases: int = required(1, 10**6, help="validation cases")
    save_every: int = required(1, 10**12, help="environment steps between checkpoints")
    ema_decay: float = required(
        0.0, 0.9999, help="decay of the moving average of the weights, per update"
    )
    least_participation: float = number(
        1.0,
        0.0,
        1.0,
        above=True,
        help="least share of the rounds in which a stage takes part, see conf/trainer",
    )
    processes: int = number(1, 1, 256, help="processes that train together on this machine")
    device: str = setting("cpu", help="device of the networks; the simulation runs on the CPU")
    wandb: str | None = setting(None, help="project that also receives the TensorBoard curves")


def run_configuration(
    config: TrainerConfig,
    policy: Mapping[str, Any],
    algorithm: Mapping[str, Any],
    stages: list[CurriculumStage],
) -> dict[str, Any]:
    """Return the configuration of a run as it is saved, which a resumed run must have as well."""
    configuration = {
        "trainer": asdict(config),
        "policy": dict(policy),
        "algorithm": dict(algorithm),
        "curriculum": {"stages": [asdict(stage) for stage in stages]},
    }
    return dict(json.loads(json.dumps(configuration, default=str)))
