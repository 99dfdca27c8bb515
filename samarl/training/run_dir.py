"""The folder of a training run, which one training at a time may use."""

from __future__ import annotations

import csv
import fcntl
import hashlib
import io
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from torch import Tensor

from mrsan import ConfigurationError
from samarl.files import write_text
from samarl.launch import rank
from samarl.policies.checkpoint import attribute_errors_to, write_tensors

STATE = "state.safetensors"
FORMAT = 5  # of STATE


class RunDir:
    """The files of a run; the folder is locked as long as this object exists."""

    def __init__(self, folder: Path) -> None:
        """Create and lock the folder.

        Raises:
            ConfigurationError: another training run uses the folder.
        """
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = (folder / ".lock").open("wb")
        try:
            if rank() == 0:  # on behalf of all processes of the training run
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ConfigurationError(
                f"run_dir is {str(folder)!r}, which another training run is using; choose another"
            ) from error

    def release(self) -> None:
        """Unlock the folder."""
        self._lock.close()

    @property
    def has_checkpoint(self) -> bool:
        """Whether the folder contains a state from which training can resume."""
        return (self.folder / STATE).is_file()

    def save(self, tensors: dict[str, Tensor], progress: dict[str, Any]) -> None:
        """Write the state and `progress.csv`, the learning curve.

        Args:
            tensors: see `flatten_state`.
            progress: everything else, as JSON; `rows` is the learning curve.
        """
        text = json.dumps(progress)
        metadata = {"format": str(FORMAT), "progress": text, "sha256": _digest(tensors, text)}
        write_tensors(self.folder / STATE, tensors, metadata)
        rows = progress["rows"]
        columns = list(dict.fromkeys(key for row in rows for key in row))
        table = io.StringIO()
        writer = csv.DictWriter(table, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(self.folder / "progress.csv", table.getvalue())

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return the tensors and the progress that were saved.

        Raises:
            ConfigurationError: see `read_progress`.
        """
        path, progress = self.folder / STATE, read_progress(self.folder)
        with attribute_errors_to(path), safe_open(path, "pt") as file:
            metadata = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            if metadata["sha256"] != _digest(tensors, metadata["progress"]):
                raise ValueError("its content does not match its digest")
        return tensors, progress


def read_progress(folder: Path) -> dict[str, Any]:
    """Return the progress of the run in a folder, with its configuration.

    Raises:
        ConfigurationError: the folder holds no run, or a damaged one, or one in another format.
    """
    path = folder / STATE
    if not path.is_file():
        raise ConfigurationError(
            f"resume is {str(folder)!r}; it must be the folder of a run, which holds {STATE}"
        )
    with attribute_errors_to(path), safe_open(path, "pt") as file:
        metadata = file.metadata()
        progress: dict[str, Any] = json.loads(metadata["progress"])
        for part in ("trainer", "policy", "algorithm", "curriculum"):
            if not isinstance(progress["configuration"][part], dict):
                raise ValueError(f"it has no configuration of the {part}")
    if metadata.get("format") != str(FORMAT):
        raise ConfigurationError(
            f"{path} was written by another version of the trainer; choose another run_dir"
        )
    return progress


def _digest(tensors: dict[str, Tensor], progress: str) -> str:
    """Return a digest of everything in a state."""
    digest = hashlib.sha256(progress.encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {list(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()
