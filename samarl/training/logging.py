"""Learning curves: TensorBoard always, Weights & Biases if configured, and a progress bar."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from mrsan import ConfigurationError
from samarl.launch import rank
from samarl.progress import progress_bar


class Logger(contextlib.AbstractContextManager["Logger"]):
    """Write scalars and show the progress; only rank 0 of several processes does.

    What an interrupted run logged after its last save is removed from TensorBoard's curves.
    """

    def __init__(
        self,
        folder: Path,
        wandb: str | None,
        configuration: dict[str, Any],
        steps_done: int,
        total_steps: int,
    ) -> None:
        """Start logging.

        Args:
            folder: of the run; the curves are written to its subfolder `tensorboard`.
            wandb: project of Weights & Biases that receives the curves too; None: none.
            configuration: of the run, for Weights & Biases.
            steps_done: environment steps so far.
            total_steps: environment steps of the whole training.

        Raises:
            ConfigurationError: wandb is not installed, or the folder cannot be written.
        """
        self._folder = folder / "tensorboard"
        self._writer: SummaryWriter | None = None
        if rank() == 0:
            if wandb is not None:
                _start_wandb(wandb, folder, configuration)
            threading.excepthook = _ignore_write_errors
            with self._report_write_errors():
                self._writer = SummaryWriter(str(self._folder), purge_step=steps_done + 1)
        self._total_steps = total_steps
        self._bar = progress_bar(
            total=total_steps,
            initial=steps_done,
            desc="training",
            unit="step",
            unit_scale=True,
            disable=rank() != 0,
        )

    def log(self, row: Mapping[str, float], steps_done: int) -> None:
        """Log one row of the learning curve.

        Raises:
            ConfigurationError: the folder cannot be written.
        """
        if self._writer is not None:
            with self._report_write_errors():
                for key, value in row.items():
                    self._writer.add_scalar(key, value, steps_done)
        self._bar.set_postfix_str(f"success {100 * row['charts/success']:.1f} %", refresh=False)
        shown = min(steps_done, self._total_steps)  # the last round may exceed the total
        self._bar.update(shown - self._bar.n)

    def write(self, line: str) -> None:
        """Print a line without disturbing the progress bar."""
        if rank() == 0:
            tqdm.write(line, file=sys.stderr)

    def __exit__(self, *_: Any) -> None:
        """Write buffered scalars.

        Raises:
            ConfigurationError: the folder cannot be written.
        """
        self._bar.close()
        if self._writer is not None:
            with self._report_write_errors():
                self._writer.close()

    @contextlib.contextmanager
    def _report_write_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ConfigurationError(
                f"{self._folder} cannot be written ({error.strerror or error})"
            ) from None


def _start_wandb(project: str, folder: Path, configuration: dict[str, Any]) -> None:
    try:
        import wandb
    except ImportError as error:
        raise ConfigurationError(
            f"trainer.wandb is {project!r}; it needs: pip install wandb"
        ) from error
    wandb.init(
        project=project,
        name=folder.name,
        dir=folder,
        config=configuration,
        sync_tensorboard=True,
    )


def _ignore_write_errors(arguments: threading.ExceptHookArgs) -> None:
    """Suppress write errors of TensorBoard's thread: the main thread raises them again."""
    if not isinstance(arguments.exc_value, OSError):
        threading.__excepthook__(arguments)
