"""The network of an exported policy, run by onnxruntime on one core, and its memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from mrsan import ConfigurationError, Observation
from samarl.runtime.description import MEMORY, NEXT_MEMORY, Description

_TYPES = {"tensor(float)": np.float32, "tensor(int64)": np.int64, "tensor(bool)": np.bool_}
_ALWAYS_PRESENT = (
    "ego",
    "humans",
    "humans_known",
    "robots",
    "robots_known",
    "walls",
    "walls_known",
    "is_init",
    "route",
)


def open_session(content: bytes) -> onnxruntime.InferenceSession:
    """Return a session of onnxruntime that uses one core, because the networks are small."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


class Network:
    """An ONNX file and its memory from step to step."""

    def __init__(self, path: str | Path) -> None:
        """Load a file that `samarl-export` wrote.

        Raises:
            ConfigurationError: there is no such file, or it is not described.
        """
        if not Path(path).is_file():
            raise ConfigurationError("there is no such file; samarl-export writes one")
        self._load(Path(path).read_bytes())
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        """Return the file's content and the memory; onnxruntime's session cannot be pickled."""
        names = ("_content", "_memory", "_is_init", "description")
        return {name: getattr(self, name) for name in names}

    def __setstate__(self, saved: dict[str, Any]) -> None:
        """Continue where the pickled or copied network was."""
        self._load(saved["_content"])
        vars(self).update(saved, _memory=dict(saved["_memory"]))

    def _load(self, content: bytes) -> None:
        self._content = content
        self._session = open_session(content)
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.description = Description.of_metadata(metadata)
        self._inputs = {tensor.name: tensor for tensor in self._session.get_inputs()}
        self._outputs = [tensor.name for tensor in self._session.get_outputs()]
        self.looks_ahead = "value" in self._outputs
        self.needs_route = self.looks_ahead or "route" in self._inputs
        self.sensor_inputs: dict[str, tuple[tuple[int, ...], type]] = {
            name: (tuple(tensor.shape[2:]), _TYPES[tensor.type])
            for name, tensor in self._inputs.items()
            if name not in _ALWAYS_PRESENT and not name.startswith(MEMORY)
        }
        # The number of walls that the network observes; 0 if it observes none.
        self.walls = self._inputs["walls"].shape[2] if "walls" in self._inputs else 0

    def reset(self) -> None:
        """Clear the memory."""
        self._memory = {
            name: np.zeros(tensor.shape, _TYPES[tensor.type])
            for name, tensor in self._inputs.items()
            if name.startswith(MEMORY)
        }
        self._is_init = True

    def clear_slots(self, kind: str, slots: list[int]) -> None:
        """Clear the memory of `humans` or `robots` in slots that now hold somebody else."""
        if not slots:
            return
        robots = self._inputs["robots"].shape[2]
        for name, (slot_kind, axis) in self.description.slots.items():
            if slot_kind in (kind, "everybody"):
                first = robots if slot_kind == "everybody" and kind == "humans" else 0
                before: list[Any] = [slice(None)] * axis
                self._memory[f"{MEMORY}{name}"][(*before, [first + k for k in slots])] = 0

    def action(self, tracks: Observation, route: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the action, [1, 1, A] in [-1, 1].

        Args:
            tracks: [1, 1, ...].
            route: [1, 1, 2] where the route leads next in the body frame, m.
        """
        is_init = np.array([self._is_init])
        outputs = self._run(tracks, is_init=is_init, route=route[0], **self._memory)
        self._is_init = False
        for name in self._memory:
            self._memory[name] = outputs[f"{NEXT_MEMORY}{name.removeprefix(MEMORY)}"]
        return outputs["action"][None].clip(-1.0, 1.0)  # the tanh of ONNX may round beyond

    def values(self, tracks: Observation) -> NDArray[np.float32]:
        """Return the values of C predicted outcomes, [C]."""
        return self._run(tracks)["value"]

    def _run(self, tracks: Observation, **others: NDArray[Any]) -> dict[str, NDArray[Any]]:
        arrays = {**tracks.arrays("known"), **others}
        inputs = {name: arrays[name] for name in self._inputs}
        return dict(zip(self._outputs, self._session.run(None, inputs), strict=True))
