"""What all commands share: their configuration and how they report an error."""

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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import hydra
import numba
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

import samarl
from mrsan import ActionError, ConfigurationError
from samarl.commands.composition import COMPOSITION_ERRORS, compose_cells, unreadable
from samarl.commands.errors import explain
from samarl.commands.help import help_text
from samarl.commands.overrides import CommandLine
from samarl.configuration import first, import_plugins, refuse_bombs, register_schemas
from samarl.files import find_folder
from samarl.launch import launcher, rank
from samarl.messages import unknown_field

_WAIT_FOR_FIRST = 5.0  # s, for the first process to say what is wrong
# What a user's mistake raises in a task; other errors are bugs.
_IN_A_TASK = (ConfigurationError, ActionError, OmegaConfBaseException, OSError, MemoryError)


def run_command(
    task: Callable[[DictConfig], Any],
    config_name: str,
    check: Callable[[DictConfig], Any] | None = None,
    **schemas: type,
) -> None:
    """Run a Hydra task; a mistake of the user's ends in one line and exit code 2.

    Args:
        task: what to do with the composed configuration.
        config_name: the primary file in `conf/`.
        check: what to do with the configuration of every cell of a sweep before the first is run,
            to find mistakes early.
        **schemas: dataclasses that the configuration names in its defaults.
    """
    words = sys.argv[1:]
    if "--version" in words:
        print(f"samarl {samarl.__version__}")
        return
    _prepare_process(words)
    for name, schema in schemas.items():
        ConfigStore.instance().store(name=name, node=schema)
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
            for config in compose_cells(config_name, command):
                _check_plugins_and_keys(config)
                if check is not None:
                    check(config)
    except KeyboardInterrupt:
        _stop("interrupted")
    except (*_IN_A_TASK, *COMPOSITION_ERRORS) as error:
        _fail(error, folder)
    sys.argv = [sys.argv[0], *command.words()]
    _run_hydra(task, config_name, folder)


def _prepare_process(words: Sequence[str]) -> None:
    os.environ["SAMARL_SWEEP"] = _sweep_name(words)
    for stream in (sys.stdout, sys.stderr):  # a terminal may know only ASCII
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing; see `_fail`
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # a user's own agents live where the command is run
    OmegaConf.register_new_resolver("first", first, replace=True)
    register_schemas()


def _check_folder(folder: Path | None) -> None:
    """Check the user's `--config-dir`, if there is one."""
    if folder is not None:
        if not folder.is_dir():
            raise ConfigurationError(f"--config-dir is {str(folder)!r}; it must be a folder")
        refuse_bombs(folder)


def _run_hydra(task: Callable[[DictConfig], Any], config_name: str, folder: Path | None) -> None:
    """Let Hydra compose the configuration from `sys.argv` and run `task` with it."""
    has_started = False
    decorate = hydra.main(
        version_base="1.3", config_path=str(find_folder("conf")), config_name=config_name
    )

    @functools.wraps(task)
    def checked(config: DictConfig) -> Any:
        # Reported here, not outside: Hydra would print a second line about the failed job.
        nonlocal has_started
        has_started = True
        try:
            _take_threads()
            _check_plugins_and_keys(config)
            result = task(config)
            sys.stdout.flush()
            return result
        except BrokenPipeError:
            _leave_quietly()
        except _IN_A_TASK as error:
            _remove_empty_folder()
            _fail(error, folder)
        except KeyboardInterrupt:
            _remove_empty_folder()
            raise

    try:
        decorate(checked)()
    except BrokenPipeError:
        _leave_quietly()
    except KeyboardInterrupt as interruption:
        _stop("; ".join(["interrupted", *map(str, interruption.args)]))
    except COMPOSITION_ERRORS as error:
        if has_started and isinstance(error, UnicodeError):
            raise
        _fail(error, folder)
    except Exception as error:
        if type(error).__module__.startswith("submitit"):  # of a cell that ran elsewhere
            _fail(error)
        if has_started:
            raise
        _fail(unreadable(error))


def _check_plugins_and_keys(config: DictConfig) -> None:
    _refuse_unknown_keys(config, "")
    import_plugins(config.plugins)


def _take_threads() -> None:
    """A cell that a cluster's launcher runs beside others takes the cores that it was given."""
    hydra_config = HydraConfig.get()
    if hydra_config.mode == RunMode.MULTIRUN and "cpus_per_task" in hydra_config.launcher:
        threads = hydra_config.launcher.cpus_per_task or 1
        threads = min(threads, numba.config.NUMBA_NUM_THREADS)
        numba.config.NUMBA_NUM_THREADS = threads  # before they start, as that sets torch's as well
        os.environ["OMP_NUM_THREADS"] = str(threads)  # of torch, which is not loaded yet


def _sweep_name(words: Sequence[str]) -> str:
    """A folder for a sweep: what is swept, and a digest that tells it from other sweeps."""
    aside = ("hydra", "evaluation.batch")  # what leaves the figures as they are
    settings = sorted(w for w in words if "=" in w and not w.startswith(aside))
    swept = [w.partition("=")[0].rpartition(".")[2] for w in settings if "," in w or "(" in w]
    digest = hashlib.sha256("\n".join(settings).encode()).hexdigest()[:8]
    return "-".join([*(re.sub(r"\W+", "_", key) for key in swept[:4]), digest])


def command_line(program: str) -> str:
    """The command that is running, as one would type it."""
    hydra_config = HydraConfig.get()
    words = [*launcher(), program]
    for source in hydra_config.runtime.config_sources:
        if source.provider == "command-line":
            words += ["--config-dir", source.path]
    return shlex.join([*words, *hydra_config.overrides.task])


def _refuse_unknown_keys(config: DictConfig, path: str) -> None:
    """`+key=value` adds keys that no schema knows."""
    kind = OmegaConf.get_type(config)
    known = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else None
    for key in map(str, config):
        if known is not None and key not in known:
            raise ConfigurationError(unknown_field(path, key, known))
        node = config._get_node(key)
        if isinstance(node, DictConfig) and not node._is_none():
            _refuse_unknown_keys(node, f"{path}{key}.")


def _remove_empty_folder() -> None:
    """The folder that was made for this run, if nothing was written into it."""
    folder = HydraConfig.get().runtime.output_dir
    if os.path.realpath(folder) != os.getcwd():  # where it runs was there before
        with contextlib.suppress(OSError):
            os.rmdir(folder)


def _leave_quietly() -> NoReturn:
    """The reader of what is printed, `head` for example, has seen enough."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(1)


def _stop(message: str) -> NoReturn:
    """End an interrupted command; of several processes only the first says so."""
    if rank() == 0:
        print(message, file=sys.stderr)
    sys.exit(130)


def _fail(error: Exception, folder: Path | None = None) -> NoReturn:
    """Say in one line what is wrong and leave with exit code 2.

    Of several processes only one should say it. The others wait first: their launcher ends them.

    Args:
        error: the user's mistake.
        folder: the user's `--config-dir`.
    """
    if rank() > 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        time.sleep(_WAIT_FOR_FIRST)
    print(f"error: {explain(error, folder)}", file=sys.stderr)
    sys.exit(2)
