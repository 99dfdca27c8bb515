"""Number and rank of the processes of one training.

`torchrun`, or the launcher of a cluster, starts a command several times and sets the environment
variables `RANK`, `WORLD_SIZE`, `LOCAL_RANK`, `MASTER_ADDR` and `MASTER_PORT` of each process.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, TypeVar

from mrsan import ConfigurationError

T = TypeVar("T")


def world_size() -> int:
    """Return the number of processes."""
    return int(os.environ.get("WORLD_SIZE", 1)) if "RANK" in os.environ else 1


def rank() -> int:
    """Return the rank of this process, from 0; rank 0 validates, logs and writes files."""
    return int(os.environ.get("RANK", 0))


def launcher() -> list[str]:
    """Return the prefix of a command line that starts it in the same number of processes."""
    if world_size() == 1:
        return []
    return ["torchrun", "--nproc-per-node", str(world_size()), "--no-python"]


def local_device(device: str) -> str:
    """Return the torch device of this process: each process on a machine uses its own GPU."""
    if device == "cuda" and world_size() > 1:
        return f"cuda:{os.environ.get('LOCAL_RANK', 0)}"
    return device


def per_process(config: T, name: str, *fields: str) -> T:
    """Return a copy of a configuration with fields divided by the number of processes.

    Args:
        config: a dataclass instance, whose fields are totals over all processes.
        name: of the configuration, for error messages.
        *fields: integer fields to divide.

    Raises:
        ConfigurationError: a field is not a multiple of the number of processes.
    """
    divided: dict[str, Any] = {}
    for field in fields:
        total = getattr(config, field)
        if total % world_size():
            raise ConfigurationError(
                f"{name}.{field} is {total}; it must be a multiple of {world_size()}, the number "
                "of processes"
            )
        divided[field] = total // world_size()
    return replace(config, **divided)  # type: ignore[type-var]
