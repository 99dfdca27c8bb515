"""Composition of configurations without running a command."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.config_loader import ConfigLoader
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Quote, QuotedString
from omegaconf import DictConfig, open_dict

from samarl.commands.overrides import CommandLine
from samarl.files import find_folder


@contextlib.contextmanager
def config_loader(folder: Path | None) -> Iterator[tuple[ConfigLoader, list[str]]]:
    """Initialise Hydra outside of a command.

    Args:
        folder: the folder of `--config-dir`.

    Yields:
        The loader of the files in `conf/`, and the override that adds `folder` to the search path.
    """
    with initialize_config_dir(str(find_folder("conf").resolve()), version_base="1.3"):
        search_path = []
        if folder is not None:
            url = QuotedString(f"file://{folder.resolve()}", Quote.single).with_quotes()
            search_path.append(f"hydra.searchpath=[{url}]")
        yield GlobalHydra.instance().config_loader(), search_path


def compose_cells(config_name: str, command: CommandLine) -> Iterator[DictConfig]:
    """Compose the configuration of every cell of a sweep.

    `HydraConfig` holds the choices of the cell yielded last.

    Args:
        config_name: name of the primary file in `conf/`.
        command: the sweep.
    """
    with config_loader(command.folder) as (loader, search_path):
        for cell in command.cells(loader):
            config = compose(config_name, [*cell, *search_path], return_hydra_config=True)
            HydraConfig.instance().set_config(config)
            cell_config = copy.deepcopy(config)
            with open_dict(cell_config):
                del cell_config["hydra"]
            yield cell_config
