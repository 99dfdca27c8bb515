"""The folder of a training run: one training at a time, and everything that is needed to go on."""

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
LAST, BEST = "last.safetensors", "best.safetensors"  # policies
FORMAT = 3


class RunDir:
    """A run's files; locked as long as this object lives."""

    def __init__(self, folder: Path) -> None:
        """Take the folder.

        Raises:
            ConfigurationError: another training writes into it.
        """
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._lock = (folder / ".lock").open("w")
        try:
            if rank() == 0:  # of several processes of a training
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise ConfigurationError(
                f"run_dir is {str(folder)!r}, into which another process trains; choose another"
            ) from error

    def release(self) -> None:
        """Let others have the folder."""
        self._lock.close()

    @property
    def has_checkpoint(self) -> bool:
        """There is something to go on from."""
        return (self.folder / STATE).is_file()

    def save(self, tensors: dict[str, Tensor], progress: dict[str, Any]) -> None:
        """Write the state and the curve."""
        text = json.dumps(progress)
        metadata = {"format": str(FORMAT), "progress": text, "sha256": _digest(tensors, text)}
        write_tensors(self.folder / STATE, tensors, metadata)
        rows = progress["rows"]
        keys = list(dict.fromkeys(key for row in rows for key in row))
        table = io.StringIO()
        writer = csv.DictWriter(table, keys, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        write_text(self.folder / "progress.csv", table.getvalue())

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """The state and the progress.

        Raises:
            ConfigurationError: see `read_progress`.
        """
        path, progress = self.folder / STATE, read_progress(self.folder)
        with attribute_errors_to(path), safe_open(path, "pt") as file:
            metadata = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            if metadata.get("sha256") not in (None, _digest(tensors, metadata["progress"])):
                raise ValueError("it is not what was saved")  # what is older has no digest
        return tensors, progress


def read_progress(folder: Path) -> dict[str, Any]:
    """How far the run in a folder is, and its configuration.

    Raises:
        ConfigurationError: the folder holds no run, or a damaged one or an older one.
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
            f"{path} was begun by another version of the trainer; begin again in another run_dir"
        )
    return progress


def _digest(tensors: dict[str, Tensor], progress: str) -> str:
    """Of everything in a state."""
    found = hashlib.sha256(progress.encode())
    for name, tensor in sorted(tensors.items()):
        found.update(f"{name} {tensor.dtype} {list(tensor.shape)}".encode())
        found.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return found.hexdigest()
