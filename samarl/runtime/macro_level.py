"""An exported macro level: whether a robot enters a passage or queues."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError
from samarl.planning.passage_features import MATE
from samarl.runtime.description import MACRO_LEVEL_KEY
from samarl.runtime.network import open_session


class MacroLevel:
    """The network of an ONNX file that `samarl-export` wrote."""

    def __init__(self, path: str | Path) -> None:
        """Load a file.

        Raises:
            ConfigurationError: there is no such file, or it is damaged or another kind of file.
        """
        if not Path(path).is_file():
            raise ConfigurationError(
                f"macro_level is {str(path)!r}; there is no such file, samarl-export writes one"
            )
        try:
            self._load(Path(path).read_bytes())
        except Exception as error:  # a damaged file may lead to any
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ConfigurationError(f"{path} cannot be used: {reason:.300}") from error
        if MACRO_LEVEL_KEY not in self._session.get_modelmeta().custom_metadata_map:
            raise ConfigurationError(
                f"macro_level is {str(path)!r}; it must be an exported macro level"
            )

    def __getstate__(self) -> bytes:
        """Return the file's content; onnxruntime's session cannot be pickled."""
        return self._content

    def __setstate__(self, content: bytes) -> None:
        """Open the network of a pickled or copied macro level."""
        self._load(content)

    def _load(self, content: bytes) -> None:
        self._content, self._session = content, open_session(content)

    def choose(self, own: NDArray[np.float32], mates: NDArray[np.float32]) -> int:
        """Return `QUEUE` or `ENTER` for a robot's own numbers [OWN] and its team-mates' [K, MATE].

        Both are described in `samarl.planning.passage_features`.
        """
        if not len(mates):  # one of whom the robot knows nothing counts as much as nobody
            mates = np.zeros((1, MATE), np.float32)
        (logits,) = self._session.run(None, {"own": own[None], "mates": mates[None]})
        return int(logits[0].argmax())
