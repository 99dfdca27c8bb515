"""Entry points of the commands; an interrupt during imports is reported in one line."""

from __future__ import annotations

import os
import sys
from functools import partial
from importlib import import_module

import samarl

COMMANDS = {
    "evaluate": "evaluate an agent on fixed cases, or run a sweep of evaluations",
    "bench": "evaluate the agents of a table and compare it with the committed results",
    "submit": "play a table and write a file for the leaderboard",
    "verify": "check a file of samarl-submit and replay some of its cases",
    "render": "draw one case as a picture or a video",
    "play": "open a playground in the browser",
    "record": "write the trajectories of one case as a table",
    "train": "train a policy, or resume a training run",
    "report": "build web pages with tables, curves and replays",
    "predictor": "train and evaluate a predictor of people",
    "macro": "train the macro level of right_of_way and compare it with the rule",
    "export": "export a policy as an ONNX file that runs without torch",
    "recording": "summarise, check, draw and convert a recording of people",
    "map": "show what is understood of a map file",
    "curves": "draw the learning curves of training runs",
    "examples": "copy the examples to a folder",
}


def run(command: str) -> None:
    """Run a command with the words of `sys.argv`, in UTF-8 whatever the locale."""
    if sys.getfilesystemencoding() != "utf-8":  # else paths and output lack most characters
        os.execv(sys.executable, [sys.executable, "-X", "utf8", *sys.orig_argv[1:]])
    try:
        import_module(f"samarl.commands.{command}").main()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)


globals().update({command: partial(run, command) for command in COMMANDS})  # entry points


def main() -> None:
    """List the commands, or run one: `samarl evaluate ...` is `samarl-evaluate ...`."""
    command, *words = sys.argv[1:] or ["--help"]
    if command in COMMANDS:
        sys.argv = [f"samarl-{command}", *words]
        run(command)
    elif command == "--version":
        print(f"samarl {samarl.__version__}")
    elif command in ("--help", "-h"):
        print(_overview())
    else:
        from mrsan.suggestions import choice_hint  # imports the simulator, which takes a second

        hint = choice_hint(command, COMMANDS)
        print(f"error: {command!r:.60} is not a command; {hint}", file=sys.stderr)
        sys.exit(2)


def _overview() -> str:
    """Return the list of commands, one a line."""
    lines = [f"  samarl {name:<10} {about}" for name, about in COMMANDS.items()]
    return "\n".join(
        [
            "Usage: samarl COMMAND [setting=value ...], which is the same as samarl-COMMAND ...",
            "",
            *lines,
            "",
            "samarl COMMAND --help lists the settings of a command; samarl --version prints the "
            "version.",
        ]
    )
