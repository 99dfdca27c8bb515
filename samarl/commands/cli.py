"""What all commands share: their configuration and how they report an error."""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import functools
import hashlib
import io
import os
import re
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn

import hydra
import numba
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException
from yaml import YAMLError

import samarl
from mrsan import ActionError, ConfigurationError
from samarl.agents import Agent
from samarl.commands.help import help_text, own_folder
from samarl.configuration import first, import_plugins, refuse_bombs, register_schemas
from samarl.files import find_folder
from samarl.launch import launcher, rank

_WAIT_FOR_FIRST = 5.0  # s, for the first process to say what is wrong


def chosen_agent(config: DictConfig) -> DictConfig:
    """The configuration of the agent, with the checkpoint that was asked for."""
    agent: DictConfig = config.agent
    if config.checkpoint is not None:
        if "checkpoint" not in agent:
            raise ConfigurationError(
                f"checkpoint is {config.checkpoint!r}; it must be null for an agent without one "
                "(agent=samarl has one)"
            )
        agent.checkpoint = config.checkpoint
    return agent


def print_scope_warning(agent: Agent) -> None:
    """Say what a user should know of an agent in its scenario, if there is anything."""
    if warning := agent.scope_warning():
        print(f"note: {warning}", file=sys.stderr)


def run_command(task: Callable[[DictConfig], Any], config_name: str, **schemas: type) -> None:
    """Run a Hydra task; a mistake of the user's ends in one line and exit code 2.

    Args:
        task: what to do with the composed configuration.
        config_name: the primary file in `conf/`.
        **schemas: dataclasses that the configuration names in its defaults.
    """
    if "--version" in sys.argv[1:]:
        print(f"samarl {samarl.__version__}")
        return
    os.environ["SAMARL_SWEEP"] = _sweep_name(sys.argv[1:])
    for stream in (sys.stdout, sys.stderr):  # a terminal may know only ASCII
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing; it is said below.
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())  # a user's own agents live where the command is run
    OmegaConf.register_new_resolver("first", first, replace=True)
    register_schemas()
    for name, schema in schemas.items():
        ConfigStore.instance().store(name=name, node=schema)
    try:
        if own := own_folder(sys.argv[1:]):
            refuse_bombs(own)
    except ConfigurationError as error:
        _fail(error)
    if {"--help", "-h"} & set(sys.argv[1:]):
        try:
            print(help_text(config_name, sys.argv[1:]))
        except (HydraException, OmegaConfBaseException, ConfigurationError) as error:
            _fail(error)
        return
    begun = False
    decorate = hydra.main(
        version_base="1.3", config_path=str(find_folder("conf")), config_name=config_name
    )

    @functools.wraps(task)
    def checked(config: DictConfig) -> Any:
        # Reported here, not outside: Hydra would print a second line about the failed job.
        nonlocal begun
        begun = True
        try:
            _take_threads()
            _refuse_unknown_keys(config, "")
            import_plugins(config.plugins)
            result = task(config)
            sys.stdout.flush()
            return result
        except BrokenPipeError:
            _leave_quietly()
        except (
            ConfigurationError, ActionError, OmegaConfBaseException, OSError, MemoryError
        ) as error:  # fmt: skip
            _remove_empty_folder()
            _fail(error)
        except KeyboardInterrupt:
            _remove_empty_folder()
            raise

    try:
        decorate(checked)()
    except BrokenPipeError:
        _leave_quietly()
    except (HydraException, OmegaConfBaseException, YAMLError, OSError) as error:
        _fail(error)
    except KeyboardInterrupt as interruption:
        if rank() == 0:
            print("; ".join(["interrupted", *map(str, interruption.args)]), file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        if type(error).__module__.startswith("submitit"):  # of a cell that ran elsewhere
            _fail(error)
        if begun:
            raise
        # Hydra, OmegaConf and PyYAML raise whatever they come across while they compose.
        _fail(ConfigurationError(f"the configuration cannot be read ({error})"))


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
            raise ConfigurationError(_not_known(path, key, known))
        node = config._get_node(key)
        if isinstance(node, DictConfig) and not node._is_none():
            _refuse_unknown_keys(node, f"{path}{key}.")


def _not_known(path: str, key: str, known: Iterable[str]) -> str:
    """What to say of a field that is not there: the one that is probably meant, or all."""
    names = sorted(name for name in known if not name.startswith("_"))
    meant = [name for name in names if name.startswith(key)]
    meant += [name for name in names if "".join(word[:1] for word in name.split("_")) == key]
    meant += difflib.get_close_matches(key, names)
    if meant:
        return f"{path}{key} is not known; did you mean {path}{meant[0]}?"
    return f"{path}{key} is not known; it must be one of {', '.join(names)}"


def _unknown_key(error: BaseException | None) -> str | None:
    """The same, where the error comes from a field that Hydra or OmegaConf does not find."""
    while error is not None:
        parent = getattr(error, "parent_node", None)
        if isinstance(error, ConfigKeyError | ConfigAttributeError) and isinstance(
            parent, DictConfig
        ):
            path = str(error.full_key).rpartition(".")[0]
            return _not_known(f"{path}." if path else "", str(error.key), map(str, parent))
        error = error.__cause__
    return None


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


def _fail(error: Exception) -> NoReturn:
    """Say in one line what is wrong and leave with exit code 2.

    Of several processes only one should say it. The others wait first: their launcher ends them.
    """
    if rank() > 0:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        time.sleep(_WAIT_FOR_FIRST)
    if unknown := _unknown_key(error):
        print(f"error: {unknown}", file=sys.stderr)
        sys.exit(2)
    message = str(error).split("Config search path:")[0] or type(error).__name__
    if isinstance(error, OSError) and error.errno and error.filename is None:  # of Hydra, say
        message = f"a file below {os.getcwd()} cannot be written ({error.strerror})"
    if error.__cause__ and str(error.__cause__) not in message:
        message += f"\n{error.__cause__}"
    key = getattr(error, "full_key", None)
    if key and key not in message:
        message = f"{key}: {message}"
    lines = [line.strip().removesuffix(":") for line in message.splitlines() if line.strip()]
    print("error: " + "; ".join(lines), file=sys.stderr)
    sys.exit(2)
