"""Which settings a resumed run may change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mrsan import ConfigurationError
from samarl.launch import world_size

RESUME_OVERRIDABLE = ("threads", "wandb")
"""Fields of `TrainerConfig` that a resumed run may change, besides a larger `steps`."""


def check_same_run(
    progress: Mapping[str, Any],
    configuration: Mapping[str, Any],
    provenance: Mapping[str, Any],
    folder: Path,
) -> None:
    """Refuse to resume a run with different settings; only `trainer.steps` may grow.

    Args:
        progress: of the saved run.
        configuration: of this run, see `Trainer.configuration`.
        provenance: of this run; `init_from` is present if the run has initial weights.
        folder: of the run.

    Raises:
        ConfigurationError: names the first setting that differs.
    """
    saved_world_size = progress["world_size"]
    if saved_world_size != world_size():
        raise ConfigurationError(
            f"{folder} holds a run with WORLD_SIZE={saved_world_size}; it cannot be resumed with "
            f"WORLD_SIZE={world_size()}"
        )
    saved_configuration = progress["configuration"]
    steps = configuration["trainer"]["steps"]
    saved_trainer = saved_configuration["trainer"]
    saved_steps = saved_trainer["steps"]
    may_change = {name: saved_trainer.get(name) for name in ("steps", *RESUME_OVERRIDABLE)}
    compared = {**configuration, "trainer": {**configuration["trainer"], **may_change}}
    advice = f"choose another run_dir, or resume the run with its own settings: resume={folder}"
    for name, saved_value, value in _differences(saved_configuration, compared):
        raise ConfigurationError(
            f"{name} is {value!r:.60}; the run in {folder} has {saved_value!r:.60} ({advice})"
        )
    saved_init_from = progress["provenance"].get("init_from")
    if provenance.get("init_from", saved_init_from) != saved_init_from:
        raise ConfigurationError(
            f"init_from is not the policy with which the run in {folder} started ({advice})"
        )
    if steps < saved_steps:
        raise ConfigurationError(
            f"trainer.steps is {steps}; it must be at least {saved_steps}, the steps of the run in "
            f"{folder}, of which {progress['steps_done']} are done"
        )


def _differences(saved: Any, current: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the name and both values of every setting in which two configurations differ."""
    if isinstance(saved, dict) and isinstance(current, dict):
        for key in dict.fromkeys([*saved, *current]):
            name = f"{path}.{key}" if path else str(key)
            yield from _differences(saved.get(key), current.get(key), name)
    elif isinstance(saved, list) and isinstance(current, list) and len(saved) == len(current):
        for index, (saved_item, item) in enumerate(zip(saved, current, strict=True)):
            yield from _differences(saved_item, item, f"{path}[{index}]")
    elif saved != current:
        yield path, saved, current
