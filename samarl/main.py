"""Entry points of the commands; an interrupt during imports is reported in one line."""

from __future__ import annotations

import sys
from functools import partial
from importlib import import_module


def _run(command: str) -> None:
    try:
        import_module(f"samarl.commands.{command}").main()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


evaluate, bench, render, record, train, report, predictor, export, recording = (
    partial(_run, command)
    for command in (
        "evaluate",
        "bench",
        "render",
        "record",
        "train",
        "report",
        "predictor",
        "export",
        "recording",
    )
)
