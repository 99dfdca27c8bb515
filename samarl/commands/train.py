"""`samarl-train`: train a policy or resume an interrupted training run."""

from __future__ import annotations

import signal
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from mrsan import ConfigurationError
from samarl.commands.cli import command_line, run_command
from samarl.configuration import scenario_in
from samarl.policies.card import find_policy
from samarl.training.resume import RESUME_OVERRIDABLE
from samarl.training.settings import (
    RunSettings,
    check_settings,
    resumed_settings,
    settings_from,
    train_schema,
)


def main() -> None:
    """Entry point."""
    run_command(train, "train", check_training, train_schema=train_schema())


def train(config: DictConfig) -> None:
    """Train a policy; the same command resumes an interrupted training run."""
    from samarl.training.run import run_training  # imports torch, which --help does not need

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # like Ctrl-C
    settings, in_sweep = settings_in(config), HydraConfig.get().mode is RunMode.MULTIRUN
    advice = "the same command resumes the sweep" if in_sweep else None
    run_training(settings, command_line("samarl-train"), advice)


def check_training(config: DictConfig) -> tuple[str, Path]:
    """Check the settings of a cell of a sweep without starting it.

    Returns:
        The setting `run_dir`, see `run_command`.

    Raises:
        ConfigurationError: a setting is not valid, or the folder contains another run.
    """
    settings = settings_in(config)
    if settings.trainer.processes > 1:
        raise ConfigurationError(
            f"trainer.processes is {settings.trainer.processes}; it must be 1 in a sweep, which "
            "runs its cells side by side"
        )
    check_settings(settings)
    return "run_dir", settings.folder


def settings_in(config: DictConfig) -> RunSettings:
    """Return the settings of a composed `conf/train.yaml`.

    Raises:
        ConfigurationError: a setting is not valid.
    """
    words = HydraConfig.get().overrides.task if HydraConfig.initialized() else []
    names = [word.partition("=")[0] for word in words]
    if config.resume is not None:
        return _resumed(config, names)
    parts = ("trainer", "policy", "algorithm", "curriculum")
    init_from = config.init_from
    return settings_from(
        {part: OmegaConf.to_container(config[part], resolve=True) for part in parts},
        _folder(config, names),
        scenario=None if config.scenario is None else scenario_in(config),
        worlds=config.worlds,
        init_from=None if init_from is None else find_policy(init_from, "init_from"),
        plugins=list(config.plugins),
        explicit=names,
    )


def _resumed(config: DictConfig, names: list[str]) -> RunSettings:
    """Return the settings of the run in `resume`.

    Raises:
        ConfigurationError: the folder contains no run, or settings are set that may not change.
    """
    changeable = [f"trainer.{name}" for name in (*RESUME_OVERRIDABLE, "steps")]
    for name in names:
        if name not in ("resume", "plugins", *changeable):
            raise ConfigurationError(
                f"resume is {config.resume!r} with {name}; a resumed run keeps its own settings, "
                f"except {', '.join([*changeable, 'plugins'])}"
            )
    fields = [name.removeprefix("trainer.") for name in names if name in changeable]
    trainer = {field: config.trainer[field] for field in fields}
    return resumed_settings(Path(config.resume), trainer, list(config.plugins))


def _folder(config: DictConfig, names: list[str]) -> Path:
    """Return the folder of a run: in a sweep without `run_dir` each cell has its own."""
    is_initialized = HydraConfig.initialized() and "run_dir" not in names
    if is_initialized and (hydra := HydraConfig.get()).mode is RunMode.MULTIRUN:
        return Path(hydra.sweep.dir) / hydra.sweep.subdir
    return Path(config.run_dir)


if __name__ == "__main__":
    main()
