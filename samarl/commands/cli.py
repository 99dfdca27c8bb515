"""Common parts of all commands: composing the configuration and reporting errors."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import io
import os
import re
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

import hydra
import numba
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

import samarl
from mrsan import ActionError, ConfigurationError, PluginError
from samarl.commands.composition import COMPOSITION_ERRORS, compose_cells, unreadable
from samarl.commands.errors import explain
from samarl.commands.help import help_text
from samarl.commands.overrides import CommandLine
from samarl.configuration import first, import_plugins, register_schemas, reject_alias_bombs
from samarl.errors import TrainingError
from samarl.files import find_folder
from samarl.launch import launcher, rank
from samarl.messages import unknown_field

# Settings that a sweep may change when it is resumed: they do not affect results, or let runs grow.
_SAME_SWEEP = ("evaluation.batch", "trainer.steps", "trainer.threads", "trainer.wandb")
_RANK0_REPORT_SECONDS = 5.0  # for which other processes let rank 0 report an error
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


def run_command(
    task: Callable[[DictConfig], Any],
    config_name: str,
    check: Callable[[DictConfig], tuple[str, Path] | None] | None = None,
    **schemas: Any,
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
    prepare_hydra(**schemas)
    folder = None
    try:
        command = CommandLine.parse(words)
        folder = command.folder
        _check_folder(folder)
        command = command.quoted()
        if {"--help", "-h"} & set(words):
            print(help_text(config_name, command))
            return
        if command.is_sweep:
            _check_cells(compose_cells(config_name, command), check)
    except KeyboardInterrupt:
        _stop("interrupted")
    except (*_USER_ERRORS, *COMPOSITION_ERRORS) as error:
        _fail(error, folder)
    sys.argv = [sys.argv[0], *command.words()]
    _run_hydra(task, config_name, folder)


def _check_cells(
    cells: Iterator[DictConfig], check: Callable[[DictConfig], tuple[str, Path] | None] | None
) -> None:
    """Check every cell of a sweep, see `run_command`.

    Raises:
        ConfigurationError: a cell is not valid, or two of them would write the same file.
    """
    outputs: set[Path] = set()
    for config in cells:
        check_plugins_and_keys(config)
        if check is None or (output := check(config)) is None:
            continue
        name, path = output
        if path.resolve() in outputs:
            raise ConfigurationError(
                f"{name} is {str(path)!r} in several cells of the sweep; it must differ, as in "
                f"'{name}=outputs/${{hydra:job.override_dirname}}{path.suffix}'"
            )
        outputs.add(path.resolve())


def _prepare_process(words: Sequence[str]) -> None:
    os.environ["SAMARL_SWEEP"] = _sweep_name(words)
    for stream in (sys.stdout, sys.stderr):  # some terminals support ASCII only
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing; see `_fail`
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # so that plugins in the current folder can be imported


def prepare_hydra(**schemas: Any) -> None:
    """Register what the files of `conf/` refer to.

    Args:
        **schemas: dataclasses used as schemas in the defaults list of a configuration, or their
            structured configurations.
    """
    OmegaConf.register_new_resolver("first", first, replace=True)
    register_schemas()
    for name, schema in schemas.items():
        ConfigStore.instance().store(name=name, node=schema)


def _check_folder(folder: Path | None) -> None:
    """Check the folder of `--config-dir`, if there is one.

    Raises:
        ConfigurationError: it is not a folder, or a file in it has too many values.
    """
    if folder is not None:
        if not folder.is_dir():
            raise ConfigurationError(f"--config-dir is {str(folder)!r}; it must be a folder")
        reject_alias_bombs(folder)


def _run_hydra(task: Callable[[DictConfig], Any], config_name: str, folder: Path | None) -> None:
    """Let Hydra compose the configuration from `sys.argv` and run `task` with it."""
    has_started = False
    decorate = hydra.main(
        version_base="1.3", config_path=str(find_folder("conf")), config_name=config_name
    )

    @functools.wraps(task)
    def checked(config: DictConfig) -> Any:
        # Reported here, since Hydra would print a second line about the failed job.
        nonlocal has_started
        has_started = True
        try:
            _limit_threads()
            check_plugins_and_keys(config)
            result = task(config)
            sys.stdout.flush()
            return result
        except BrokenPipeError:
            _exit_on_broken_pipe()
        except (*_USER_ERRORS, HydraException, YAMLError) as error:  # files may be composed here
            _remove_empty_folder()
            _fail(error, folder)
        except KeyboardInterrupt:
            _remove_empty_folder()
            raise

    try:
        decorate(checked)()
    except BrokenPipeError:
        _exit_on_broken_pipe()
    except KeyboardInterrupt as interruption:
        _stop("; ".join(["interrupted", *map(str, interruption.args)]))
    except COMPOSITION_ERRORS as error:
        if has_started and isinstance(error, UnicodeError):
            raise
        _fail(error, folder)
    except Exception as error:
        if type(error).__module__.startswith("submitit"):  # raised in a cell
            _fail(error)
        if has_started:
            raise
        _fail(unreadable(error))


def check_plugins_and_keys(config: DictConfig) -> None:
    """Reject unknown settings and import the plugins.

    Raises:
        ConfigurationError: a setting is unknown, or a plugin cannot be imported.
    """
    _reject_unknown_keys(config, "")
    import_plugins(config.plugins)


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


def _reject_unknown_keys(config: DictConfig, path: str) -> None:
    """Reject keys that are not in the schema, which `+key=value` can add.

    Raises:
        ConfigurationError: a key is unknown.
    """
    kind = OmegaConf.get_type(config)
    fields = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else None
    for key in map(str, config):
        if fields is not None and key not in fields:
            raise ConfigurationError(unknown_field(path, key, fields))
        node = config._get_node(key)
        if isinstance(node, DictConfig) and not node._is_none():
            _reject_unknown_keys(node, f"{path}{key}.")


def _remove_empty_folder() -> None:
    """Remove the output folder of this run if it is empty."""
    folder = HydraConfig.get().runtime.output_dir
    if os.path.realpath(folder) != os.getcwd():  # the current folder existed before
        with contextlib.suppress(OSError):
            os.rmdir(folder)


def _exit_on_broken_pipe() -> NoReturn:
    """Exit silently because the reader of the output, such as `head`, has closed it."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(1)


def _stop(message: str) -> NoReturn:
    """Exit an interrupted command; only rank 0 prints the message."""
    if rank() == 0:
        print(message, file=sys.stderr)
    sys.exit(130)


def _fail(error: Exception, folder: Path | None = None) -> NoReturn:
    """Print the error in one line and exit with code 2.

    Processes other than rank 0 wait first, so that the launcher usually ends them before they
    print the same error.

    Args:
        error: the user error.
        folder: the folder of `--config-dir`.
    """
    if rank() > 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        time.sleep(_RANK0_REPORT_SECONDS)
    print(f"error: {explain(error, folder)}", file=sys.stderr)
    sys.exit(2)
