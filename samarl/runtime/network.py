"""The network of an exported policy, run by onnxruntime on one core, and its memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from mrsan import ConfigurationError
from samarl.observations.tracker import Tracks
from samarl.runtime.description import Description

_TYPES = {"tensor(float)": np.float32, "tensor(int64)": np.int64, "tensor(bool)": np.bool_}


class Network:
    """An ONNX file and what it remembers from step to step."""

    def __init__(self, path: str | Path) -> None:
        """Load a file that `samarl-export` wrote.

        Raises:
            ConfigurationError: there is none, or it is another kind of file.
        """
        if not Path(path).is_file():
            raise ConfigurationError(f"there is no file {path}; samarl-export writes one")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # it is that small
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has a class of its own for every kind of damage
            reason = str(error).splitlines()[0]
            raise ConfigurationError(
                f"{path} is no ONNX file that can be run ({reason})"
            ) from error
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.description = Description.of_metadata(metadata, path)
        self._inputs = {put.name: put for put in self._session.get_inputs()}
        self._outputs = [put.name for put in self._session.get_outputs()]
        self.looks_ahead = "value" in self._outputs
        self.needs_route = self.looks_ahead or "route" in self._inputs
        self.forget()

    def forget(self) -> None:
        """Begin with nothing."""
        self._memory = {
            name: np.zeros(put.shape, _TYPES[put.type])
            for name, put in self._inputs.items()
            if name.startswith("state.")
        }
        self._begins = True

    def forget_those(self, kind: str, places: list[int]) -> None:
        """What it remembers of "humans" or "robots" in some places, which are somebody else's."""
        if not places:
            return
        robots = self._inputs["robots"].shape[2]
        for name, (of, axis) in self.description.slots.items():
            if of in (kind, "everybody"):
                first = robots if of == "everybody" and kind == "humans" else 0
                where: list[Any] = [slice(None)] * axis
                self._memory[f"state.{name}"][(*where, [first + k for k in places])] = 0

    def action(self, tracks: Tracks, route: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action, [1, 1, A] in [-1, 1]; `route` is where it leads next, [1, 1, 2]."""
        found = self._run(tracks, is_init=np.array([self._begins]), route=route[0], **self._memory)
        self._begins = False
        for name in self._memory:
            self._memory[name] = found[f"next.{name.removeprefix('state.')}"]
        return found["action"][None]

    def values(self, tracks: Tracks) -> NDArray[np.float32]:
        """What C predicted outcomes are worth, [C]."""
        return self._run(tracks)["value"]

    def _run(self, tracks: Tracks, **more: NDArray[Any]) -> dict[str, NDArray[Any]]:
        given = {**tracks._asdict(), **more}
        fed = {name: given[name] for name in self._inputs}
        return dict(zip(self._outputs, self._session.run(None, fed), strict=True))
