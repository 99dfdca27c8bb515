"""How many processes train together and which is this one, as their launcher says it.

`torchrun`, or a cluster's launcher in its stead, starts a command several times and tells each copy
in the environment: `RANK`, `WORLD_SIZE`, `LOCAL_RANK`, and where the first one is to be found.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, TypeVar

from mrsan import ConfigurationError

T = TypeVar("T")


def processes() -> int:
    """How many there are."""
    return int(os.environ.get("WORLD_SIZE", 1)) if "RANK" in os.environ else 1


def rank() -> int:
    """The number of this one, from 0; the first validates, logs and writes."""
    return int(os.environ.get("RANK", 0))


def launcher() -> list[str]:
    """What stands before a command that runs in as many processes."""
    several = ["torchrun", "--nproc-per-node", str(processes()), "--no-python"]
    return several if processes() > 1 else []


def local_device(device: str) -> str:
    """The torch device of this process: of several GPUs of a machine each takes its own."""
    several = device == "cuda" and processes() > 1
    return f"cuda:{os.environ.get('LOCAL_RANK', 0)}" if several else device


def share(values: T, name: str, *fields: str) -> T:
    """The same dataclass with what falls to this process of the numbers that count all of them.

    Args:
        values: a dataclass instance.
        name: of the group it stands in, for the error.
        *fields: of its whole numbers, which are divided.

    Raises:
        ConfigurationError: one is no multiple of the number of processes.
    """
    parts: dict[str, Any] = {}
    for field in fields:
        whole = getattr(values, field)
        if whole % processes():
            raise ConfigurationError(
                f"{name}.{field} is {whole}; it must be a multiple of {processes()}, the number "
                "of processes"
            )
        parts[field] = whole // processes()
    return replace(values, **parts)  # type: ignore[type-var]
