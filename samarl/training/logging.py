"""Curves while training: TensorBoard always, Weights & Biases if asked for."""

from __future__ import annotations

from collections.abc import Mapping
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
                project=wandb, name=folder.name, dir=folder, config=configuration,
                sync_tensorboard=True,
            )  # fmt: skip
        purge = steps_done + 1 if steps_done else None
        self._writer = SummaryWriter(str(folder / "tensorboard"), purge_step=purge)

    def log(self, row: Mapping[str, float], step: int) -> None:
        """Write one row of the curve."""
        for key, value in row.items():
            self._writer.add_scalar(key, value, step)

    def close(self) -> None:
        """Write what is left."""
        self._writer.close()
