"""Which runs may be resumed with which settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mrsan import ConfigurationError
from samarl.launch import world_size


def check_same_run(
    progress: Mapping[str, Any],
    configuration: Mapping[str, Any],
    provenance: Mapping[str, Any],
    folder: Path,
) -> None:
    """Refuse to resume a run with other settings than its own; only `trainer.steps` may grow.

    Args:
        progress: what the run saved.
        configuration: the settings now.
        provenance: the command now, with the initial policy if there is one.
        folder: of the run.

    Raises:
        ConfigurationError: names the first setting that differs.
    """
    saved_world_size = progress.get("processes", 1)
    if saved_world_size != world_size():
        raise ConfigurationError(
            f"{folder} holds a run with WORLD_SIZE={saved_world_size}; it cannot be resumed with "
            f"WORLD_SIZE={world_size()}"
        )
    saved = progress["configuration"]
    steps, saved_steps = (config["trainer"]["steps"] for config in (configuration, saved))
    current = {**configuration, "trainer": {**configuration["trainer"], "steps": saved_steps}}
    advice = f"choose another run_dir, or resume the run with its own settings: resume={folder}"
    for name, before, now in _differences(saved, current):
        raise ConfigurationError(
            f"{name} is {now!r:.60}; the run in {folder} has {before!r:.60} ({advice})"
        )
    initial = progress["made"].get("init_from")
    if provenance.get("init_from", initial) != initial:
        raise ConfigurationError(
            f"init_from is another policy than that of the run in {folder} ({advice})"
        )
    if steps < saved_steps:
        raise ConfigurationError(
            f"trainer.steps is {steps}; it must be at least {saved_steps}, the steps of the run in "
            f"{folder}, of which {progress['steps_done']} are done"
        )


def _differences(saved: Any, current: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the settings in which two configurations differ, with both values."""
    if isinstance(saved, dict) and isinstance(current, dict):
        for key in dict.fromkeys([*saved, *current]):
            name = f"{path}.{key}" if path else str(key)
            yield from _differences(saved.get(key), current.get(key), name)
    elif isinstance(saved, list) and isinstance(current, list) and len(saved) == len(current):
        for index, (before, now) in enumerate(zip(saved, current, strict=True)):
            yield from _differences(before, now, f"{path}[{index}]")
    elif saved != current:
        yield path, saved, current
