"""Run commands from the Python tools."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path


def run(
    command: Sequence[str], *, cwd: Path | None = None, env: Mapping[str, str] | None = None
) -> None:
    """Run a command to its end; if it fails, exit with its code, because it has printed why.

    Ctrl-C reaches the command as well, so this waits until the command has ended by itself.
    """
    sys.stdout.flush()
    with subprocess.Popen(command, cwd=cwd, env=env) as process:
        while process.poll() is None:
            try:
                process.wait()
            except KeyboardInterrupt:
                continue
    if process.returncode:
        sys.exit(process.returncode if process.returncode > 0 else 128 - process.returncode)
