"""What all commands share: composing their configuration with Hydra, and errors in one line."""

from __future__ import annotations

import contextlib
import copy
import functools
import hashlib
import io
import os
import re
import shlex
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import hydra
import numba
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import OmegaConfBaseException

import samarl
from mrsan import ActionError, ConfigurationError, PluginError
from samarl.agents import ScopeWarning
from samarl.commands.overrides import CommandLine
from samarl.configuration import composed, hydra_tree, import_plugins, register_schemas
from samarl.errors import TrainingError
from samarl.files import find_folder
from samarl.launch import launcher, let_rank_0_report, rank
from samarl.messages import explain

# Settings that a sweep may change when it is resumed: they do not affect results, or let runs grow.
_SAME_SWEEP = ("evaluation.batch", "trainer.steps", "trainer.threads", "trainer.wandb")
# Errors that the user causes in a task; all others are bugs.
_USER_ERRORS = (
    ConfigurationError,
    ActionError,
    PluginError,
    TrainingError,
    OmegaConfBaseException,
    OSError,
    MemoryError,
)
Check = Callable[[DictConfig], tuple[str, Path] | None]


def run_command(
    task: Callable[[DictConfig], Any], config_name: str, check: Check | None = None, **schemas: Any
) -> None:
    """Run a Hydra task; user errors are reported in one line with exit code 2.

    Args:
        task: function of the composed configuration.
        config_name: name of the primary file in `conf/`.
        check: function called with the configuration of every cell of a sweep before the first
            cell is run, to find errors early. It returns the file or folder that no other cell may
            write, with the name of its setting, or None.
        **schemas: dataclasses used as schemas in the defaults list of the configuration.
    """
    words = sys.argv[1:]
    if "--version" in words:
        print(f"samarl {samarl.__version__}")
        return
    _prepare_process(words)
    register_schemas(**schemas)
    in_hydra = False

    @functools.wraps(task)
    def run(config: DictConfig) -> Any:
        # Errors are reported here, since Hydra would print a second line about the failed job.
        nonlocal in_hydra
        in_hydra = False
        try:
            _limit_threads()
            import_plugins(config.plugins)
            result = task(config)
            sys.stdout.flush()
            return result
        except (*_USER_ERRORS, KeyboardInterrupt) as error:
            _remove_empty_folder()
            if isinstance(error, KeyboardInterrupt):
                raise
            _fail(error)

    try:
        command = CommandLine.parse(words)
        if command.is_help:
            from samarl.commands.help import help_text  # imports what is only described

            print(help_text(config_name, command))
            return
        if command.is_sweep:
            _check_cells(config_name, command, check)
        sys.argv = [sys.argv[0], *command.words()]
        in_hydra = True
        conf = str(find_folder("conf"))
        hydra.main(version_base="1.3", config_path=conf, config_name=config_name)(run)()
    except KeyboardInterrupt as interruption:
        if rank() == 0:
            print("; ".join(["interrupted", *map(str, interruption.args)]), file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        is_of_cell = type(error).__module__.startswith("submitit")
        if not (in_hydra or is_of_cell or isinstance(error, _USER_ERRORS)):
            raise
        _fail(error)


def _prepare_process(words: Sequence[str]) -> None:
    os.environ["SAMARL_SWEEP"] = _sweep_name(words)
    for stream in (sys.stdout, sys.stderr):  # some terminals support ASCII only
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing; see `_fail`
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # so that plugins in the current folder can be imported
    warnings.simplefilter("ignore", ScopeWarning)  # commands print a note instead


def _check_cells(config_name: str, command: CommandLine, check: Check | None) -> None:
    """Check every cell of a sweep, see `run_command`.

    Raises:
        ConfigurationError: a cell is not valid, or two of them would write the same file.
    """
    outputs: set[Path] = set()
    for config in compose_cells(config_name, command):
        import_plugins(config.plugins)
        if check is None or (output := check(config)) is None:
            continue
        name, path = output
        if path.resolve() in outputs:
            raise ConfigurationError(
                f"{name} is {str(path)!r} in several cells of the sweep; it must differ, as in "
                f"'{name}=outputs/${{hydra:job.override_dirname}}{path.suffix}'"
            )
        outputs.add(path.resolve())


def compose_cells(config_name: str, command: CommandLine) -> Iterator[DictConfig]:
    """Compose the configuration of every cell of a sweep.

    `HydraConfig` holds the choices of the cell yielded last.
    """
    with hydra_tree(command.folder) as loader:
        for cell in command.cells(loader):
            config = composed(config_name, cell)
            config.hydra.mode = RunMode.MULTIRUN if command.is_sweep else RunMode.RUN
            HydraConfig.instance().set_config(config)
            cell_config = copy.deepcopy(config)
            with open_dict(cell_config):
                del cell_config["hydra"]
            yield cell_config


def _limit_threads() -> None:
    """Limit a cell of a sweep on a cluster to the cores assigned to it."""
    hydra_config = HydraConfig.get()
    if hydra_config.mode == RunMode.MULTIRUN and "cpus_per_task" in hydra_config.launcher:
        threads = hydra_config.launcher.cpus_per_task or 1
        threads = min(threads, numba.config.NUMBA_NUM_THREADS)
        numba.config.NUMBA_NUM_THREADS = threads  # read when they start, as by torch
        os.environ["OMP_NUM_THREADS"] = str(threads)  # for torch, which is not loaded yet


def _sweep_name(words: Sequence[str]) -> str:
    """Return the folder name of a sweep: the swept keys and a digest of all settings."""
    settings = sorted(w for w in words if "=" in w and not w.startswith("hydra"))
    swept = [w.partition("=")[0].rpartition(".")[2] for w in settings if "," in w or "(" in w]
    settings = [w for w in settings if w.partition("=")[0] not in _SAME_SWEEP]
    digest = hashlib.sha256("\n".join(settings).encode(errors="replace")).hexdigest()[:8]
    return "-".join([*(re.sub(r"\W+", "_", key) for key in swept[:4]), digest])


def command_line(program: str) -> str:
    """Return the running command as typed in a shell."""
    hydra_config = HydraConfig.get()
    words = [*launcher(), program]
    for source in hydra_config.runtime.config_sources:
        if source.provider == "command-line":
            folder, here = Path(source.path), Path.cwd()
            shown = folder.relative_to(here) if folder.is_relative_to(here) else folder
            words += ["--config-dir", str(shown)]
    return shlex.join([*words, *hydra_config.overrides.task])


def _remove_empty_folder() -> None:
    """Remove the output folder of this run if it is empty."""
    folder = HydraConfig.get().runtime.output_dir
    if os.path.realpath(folder) != os.getcwd():  # the current folder existed before
        with contextlib.suppress(OSError):
            os.rmdir(folder)


def _fail(error: Exception) -> NoReturn:
    """Print the error in one line and exit with code 2."""
    if isinstance(error, BrokenPipeError):  # the reader of the output, such as `head`, closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    let_rank_0_report()
    print(f"error: {explain(error)}", file=sys.stderr)
    sys.exit(2)
