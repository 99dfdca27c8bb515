"""Run commands in new processes that need not import PyTorch and TorchRL again.

The processes are forked from one that has imported the libraries, which saves several seconds each.
"""

import atexit
import multiprocessing
import os
import runpy
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path

_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload(
    [
        "hydra",
        "matplotlib",
        "mrsan",
        "samarl.training.trainer",
        "torchrl.modules",
        "torchrl.objectives",
    ]
)


def run_module(
    module: str, *arguments: str, cwd: Path, timeout: float = 240.0, **variables: str
) -> subprocess.CompletedProcess[str]:
    """Do what `python -m <module> <arguments>` does.

    Args:
        module: its name.
        arguments: of the command line.
        cwd: the folder to run in.
        timeout: s.
        variables: of the environment, in addition to those of this process; not `PYTHON...`, which
            a process reads at its start.

    Raises:
        subprocess.TimeoutExpired: it took longer and was killed.
    """
    pipes = [_context.Pipe(duplex=False) for _ in ("stdout", "stderr")]
    written = [end for _, end in pipes]
    environment = dict(os.environ | variables)
    environment.pop("HYDRA_FULL_ERROR", None)  # it turns errors of one line into tracebacks
    process = _context.Process(
        target=_run, args=(module, arguments, str(cwd), environment, written)
    )
    process.start()
    for end in written:
        end.close()
    with ThreadPoolExecutor(2) as readers:
        # Until the end of the file: processes that the command has started may write last.
        texts = readers.map(_read_all, [end for end, _ in pipes])
        process.join(timeout)
        if process.exitcode is None:
            process.kill()
            process.join()
            raise subprocess.TimeoutExpired(module, timeout)
        return subprocess.CompletedProcess([module, *arguments], process.exitcode, *texts)


def _read_all(pipe: Connection) -> str:
    with os.fdopen(os.dup(pipe.fileno())) as file:
        return file.read()


def _run(
    module: str,
    arguments: tuple[str, ...],
    cwd: str,
    environment: dict[str, str],
    pipes: list[Connection],
) -> None:
    for number, pipe in enumerate(pipes, 1):
        os.dup2(pipe.fileno(), number)
        pipe.close()
    sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [module, *arguments]
    sys.path[0] = cwd
    sys.modules.pop(module, None)
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    finally:  # what the interpreter does at its end, and a forked process does not
        threading._shutdown()  # type: ignore[attr-defined]
        atexit._run_exitfuncs()
