"""Curves while training: TensorBoard always, Weights & Biases if asked for."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from mrsan import ConfigurationError


class Logger:
    """Writes scalars; what an interrupted run wrote after its last save is dropped."""

    def __init__(
        self, folder: Path, wandb: str | None, configuration: dict[str, Any], steps_done: int
    ) -> None:
        """Write into `folder`/tensorboard, and to the project `wandb` where it is not None."""
        if wandb is not None:
            try:
                import wandb as service
            except ImportError as error:
                raise ConfigurationError(
                    f"trainer.wandb is {wandb!r}; it needs: pip install wandb"
                ) from error
            service.init(
                project=wandb,
                name=folder.name,
                dir=folder,
                config=configuration,
                sync_tensorboard=True,
            )
        self._folder = folder / "tensorboard"
        threading.excepthook = _except_hook
        with self._writing():
            self._writer = SummaryWriter(str(self._folder), purge_step=steps_done + 1)

    def log(self, row: Mapping[str, float], step: int) -> None:
        """Write one row of the curve.

        Raises:
            ConfigurationError: it cannot be written.
        """
        with self._writing():
            for key, value in row.items():
                self._writer.add_scalar(key, value, step)

    def close(self) -> None:
        """Write what is left; see `log`."""
        with self._writing():
            self._writer.close()

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise ConfigurationError(
                f"{self._folder} cannot be written ({error.strerror or error})"
            ) from None


def _except_hook(arguments: threading.ExceptHookArgs) -> None:
    """Say nothing of what TensorBoard's thread could not write: it is raised again in ours."""
    if not isinstance(arguments.exc_value, OSError):
        threading.__excepthook__(arguments)
