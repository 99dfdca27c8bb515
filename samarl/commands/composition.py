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
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from mrsan import ConfigurationError
from samarl.commands.overrides import CommandLine
from samarl.files import find_folder

COMPOSITION_ERRORS = (HydraException, OmegaConfBaseException, YAMLError, OSError, UnicodeError)


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


def composed(config_name: str, settings: list[str]) -> DictConfig:
    """Compose a configuration, with Hydra's own part.

    Args:
        config_name: the primary file in `conf/`.
        settings: what is changed in it.

    Raises:
        ConfigurationError: or one of `COMPOSITION_ERRORS`: a setting or a file is wrong.
    """
    try:
        return compose(config_name, settings, return_hydra_config=True)
    except COMPOSITION_ERRORS:
        raise
    except Exception as error:
        raise unreadable(error) from error


def unreadable(error: Exception) -> ConfigurationError:
    """Name the cause; Hydra, OmegaConf and PyYAML raise whatever they come across."""
    return ConfigurationError(f"the configuration cannot be read ({error})")


def compose_cells(config_name: str, command: CommandLine) -> Iterator[DictConfig]:
    """Compose the configuration of every cell of a sweep.

    `HydraConfig` holds the choices of the cell yielded last.

    Args:
        config_name: name of the primary file in `conf/`.
        command: the sweep.
    """
    with config_loader(command.folder) as (loader, search_path):
        for cell in command.cells(loader):
            config = composed(config_name, [*cell, *search_path])
            config.hydra.mode = RunMode.MULTIRUN if command.is_sweep else RunMode.RUN
            HydraConfig.instance().set_config(config)
            cell_config = copy.deepcopy(config)
            with open_dict(cell_config):
                del cell_config["hydra"]
            yield cell_config
