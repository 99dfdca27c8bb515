"""Number and rank of the processes of one training.

`trainer.processes`, `torchrun` or the launcher of a cluster starts a command several times and sets
the environment variables `RANK`, `WORLD_SIZE`, `LOCAL_RANK`, `MASTER_ADDR` and `MASTER_PORT` of
each process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from mrsan import ConfigurationError

T = TypeVar("T")

_REPORT_SECONDS = 5.0  # for which other processes let rank 0 report an error
SHUTDOWN_SECONDS = 10.0  # for which the other processes may end by themselves
COPIES = "SAMARL_COPIES"  # environment variable, set where `copies` started the processes


def world_size() -> int:
    """Return the number of processes."""
    return int(os.environ.get("WORLD_SIZE", 1)) if "RANK" in os.environ else 1


def rank() -> int:
    """Return the rank of this process, from 0; rank 0 validates, logs and writes files."""
    return int(os.environ.get("RANK", 0))


def let_rank_0_report() -> None:
    """Wait in all other processes before they report an error, which rank 0 has as well.

    Usually it ends them meanwhile.
    """
    if rank() > 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        time.sleep(_REPORT_SECONDS)


def launcher() -> list[str]:
    """Return the prefix of a command line that starts it in the same number of processes."""
    if world_size() == 1 or COPIES in os.environ:
        return []
    return ["torchrun", "--nproc-per-node", str(world_size()), "--no-python"]


@contextlib.contextmanager
def copies(number: int, module: str, arguments: Sequence[str]) -> Iterator[None]:
    """Run a command in several processes on this machine: this one, and copies that it starts.

    Nothing is started where the processes exist already, as under `torchrun`.
    """
    if number == 1 or world_size() > 1:
        yield
        return
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    shared = {
        "WORLD_SIZE": str(number),
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": str(port),
        COPIES: str(number),
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),  # for the same plugins
    }
    command = [sys.executable, "-m", module, *arguments]
    own = {**shared, "RANK": "0", "LOCAL_RANK": "0"}
    del own["PYTHONPATH"]
    before = {name: os.environ.get(name) for name in own}
    started = [
        subprocess.Popen(
            command,
            env={**os.environ, **shared, "RANK": str(i), "LOCAL_RANK": str(i)},
            stdin=subprocess.DEVNULL,
        )
        for i in range(1, number)
    ]
    os.environ.update(own)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})
        for process in started:
            try:
                process.wait(timeout=SHUTDOWN_SECONDS)
            except subprocess.TimeoutExpired:
                process.kill()


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
