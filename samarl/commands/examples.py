"""`samarl-examples`: copy the examples that are included in the package."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from mrsan import ConfigurationError
from samarl.commands.console import Parser, run
from samarl.files import check_writable, find_folder


def main() -> None:
    """Entry point."""
    parser = Parser(
        "samarl-examples",
        "Copy the examples: a notebook, programs that use other libraries, a map of ROS, and a ROS "
        "2 node that drives a robot.",
        "new or empty folder",
        metavar="FOLDER",
    )
    run(parser, _copy)


def _copy(arguments: argparse.Namespace) -> None:
    """Copy the examples.

    Raises:
        ConfigurationError: the folder is not empty or cannot be written.
    """
    folder: Path = arguments.folder
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ConfigurationError(f"FOLDER is {str(folder)!r}; it must be a new or empty folder")
    check_writable(folder / "README.md", "FOLDER")
    ignored = shutil.ignore_patterns("__pycache__", "outputs", ".*")
    try:
        shutil.copytree(find_folder("examples"), folder, ignore=ignored, dirs_exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{folder} cannot be written ({error})") from None
    print(f"written to {folder}; {folder / 'README.md'} describes them")


if __name__ == "__main__":
    main()
