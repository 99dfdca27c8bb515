"""Training to the end of a run, in one or several processes.

`python -m samarl.training.run FILE` is one of the other processes; FILE holds its settings.
"""

from __future__ import annotations

import contextlib
import json
import logging
import shlex
import signal
import sys
import tempfile
from pathlib import Path

from mrsan import ConfigurationError, PluginError, World
from mrsan.compile_ahead import compile_ahead
from samarl.errors import TrainingError
from samarl.launch import copies, launcher, let_rank_0_report, rank, world_size
from samarl.training.settings import RunSettings, settings_from_json
from samarl.training.trainer import Trainer


def run_training(settings: RunSettings, command: str, advice: str | None = None) -> None:
    """Train to the end in `trainer.processes` processes, or resume the run in the folder.

    Args:
        settings: of the run.
        command: the command or the call that started it, recorded as provenance.
        advice: how to resume after an interrupt; None: `samarl-train resume=FOLDER`.

    Raises:
        ConfigurationError: a setting is not valid, or the folder contains another run.
        TrainingError: the training run failed.
        KeyboardInterrupt: it was interrupted; the message is the advice.
    """
    processes = settings.trainer.processes
    with contextlib.ExitStack() as stack:
        if processes > 1 and world_size() == 1:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            file = folder / "settings.json"
            file.write_text(json.dumps([settings.to_json(), command]), encoding="utf-8")
            stack.enter_context(copies(processes, __name__, [str(file)]))
        _run(settings, command, advice)


def build_trainer(settings: RunSettings, command: str) -> Trainer:
    """Return the trainer of these settings.

    Raises:
        ConfigurationError: a setting is not valid, or the folder contains another run.
    """
    return Trainer(
        settings.folder,
        settings.trainer,
        settings.policy,
        settings.algorithm,
        settings.stages,
        command,
        settings.init_from,
    )


def _run(settings: RunSettings, command: str, advice: str | None) -> None:
    """Train in this process, of possibly several."""
    trainer = build_trainer(settings, command)
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it logs every replay buffer
    resume_command = shlex.join([*launcher(), "samarl-train", f"resume={settings.folder}"])
    if rank() == 0:
        with compile_ahead(World(trainer.stages[0].scenario)):
            pass
        if trainer.steps_done >= trainer.config.steps:
            more = f"{resume_command} trainer.steps={2 * trainer.config.steps}"
            print(f"this run is finished; to continue it: {more}")
        elif trainer.steps_done:
            print(f"resuming at step {trainer.steps_done} of {trainer.config.steps}")
    try:
        trainer.run()
    except KeyboardInterrupt:
        raise KeyboardInterrupt(advice or f"resume with: {resume_command}") from None
    if rank() == 0:
        best = 100 * trainer.progress.best_success
        print(f"written to {settings.folder}: best validation success {best:.1f} %")


def main() -> None:
    """Train in one of the processes that `run_training` starts."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # like Ctrl-C
    settings, command = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    try:
        _run(settings_from_json(settings), command, None)
    except KeyboardInterrupt:
        sys.exit(130)
    except (ConfigurationError, PluginError, TrainingError, OSError, MemoryError) as error:
        let_rank_0_report()
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
