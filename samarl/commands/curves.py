"""`samarl-curves`: draw the learning curves of training runs."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from samarl.commands.console import Parser, run
from samarl.files import check_writable


def main() -> None:
    """Entry point."""
    parser = Parser(
        "samarl-curves",
        "Draw the learning curves of training runs, also of those that have not ended: a page on "
        "which runs and quantities are chosen, and a picture. Runs whose folders differ only in "
        "the seed, such as mine_seed0 and mine_seed1, are one line with a band.",
        "folder of a training run, or a folder that contains some, such as that of a sweep",
        metavar="FOLDER",
        nargs="+",
    )
    parser.add_argument(
        "--output",
        type=Path,
        metavar="FOLDER",
        default=Path("outputs/curves"),
        help="new folder, or that of an earlier report (default: %(default)s)",
    )
    run(parser, _draw)


def _draw(arguments: argparse.Namespace) -> None:
    """Draw the curves.

    Raises:
        ConfigurationError: a folder has no curves, or the output cannot be written.
    """
    from samarl.report.build import build_curves  # imports matplotlib, which takes a second
    from samarl.report.curves import read_run_folders

    output: Path = arguments.output
    check_writable(output / "index.html", "--output")
    runs = read_run_folders(arguments.folder)
    build_curves(output, runs, shlex.join(["samarl-curves", *sys.argv[1:]]))
    print(f"written to {output}/index.html and {output}/curves.png")


if __name__ == "__main__":
    main()
