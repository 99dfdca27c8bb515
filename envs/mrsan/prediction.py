"""Where people will be: one interface, constant velocity, and a small recurrent network.

A predictor is known by a name (`register_predictor`), or it is a file of weights of the network.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mrsan.fields import ConfigurationError
from mrsan.kernels.recurrent import swerve
from mrsan.se2 import rotate_vectors, unrotate_vectors
from mrsan.state import Bools, Floats

SHIPPED = Path(__file__).parent / "predictors"
FORMAT = 1  # of a file of weights with its card
MOST_HISTORY = 200  # positions that a network may read
MOVING = 0.05  # who is slower has no direction of its own, m/s


class Predictor(ABC):
    """Says where people will be, from where they were.

    Axes `...` may be any, the last of them over people that are there together (M); a predictor
    that looks at each person alone need not care. Positions may be in any frame that does not move.
    """

    history: int = 1  # H: so many positions are looked at, the present one included

    def __init__(self, time_step: float) -> None:
        """Predict in steps of `time_step` seconds."""
        self.time_step = np.float32(time_step)

    @abstractmethod
    def predict(self, past: Floats, known: Bools, velocity: Floats, steps: int) -> Floats:
        """Positions after 1..K steps, [..., M, K, 2] in m.

        Args:
            past: [..., M, H, 2] positions, one step apart, m; the last is where they are now.
            known: [..., M, H] bool; what is not known is arbitrary. Of whom the last is not known,
                so is the prediction.
            velocity: [..., M, 2] now, m/s.
            steps: K.
        """


PREDICTORS: dict[str, type[Predictor]] = {}
P = TypeVar("P", bound=type[Predictor])


def register_predictor(name: str) -> Callable[[P], P]:
    """Make a class known by `name`; it is made from the time step alone."""

    def add(made: P) -> P:
        PREDICTORS[name] = made
        return made

    return add


@register_predictor("constant_velocity")
class ConstantVelocity(Predictor):
    """Everybody goes on as now."""

    def predict(self, past: Floats, known: Bools, velocity: Floats, steps: int) -> Floats:
        """See `Predictor.predict`."""
        times = np.arange(1, steps + 1, dtype=np.float32)[:, None] * self.time_step
        return past[..., -1:, :] + velocity[..., None, :] * times


class RecurrentPredictor(ConstantVelocity):
    """Constant velocity and what a small network adds to it, for each person alone.

    All that it reads and says is in the person's own frame, so it turns with the world; who has
    not moved lately has no such frame and stays. With weights of zero it is constant velocity.
    """

    def __init__(self, weights: dict[str, Floats], history: int, time_step: float) -> None:
        """Take the arguments of `mrsan.kernels.recurrent.swerve` by their names."""
        super().__init__(time_step)
        self.history = history
        self.weights = [np.ascontiguousarray(weights[name], np.float32) for name in shapes(1)]

    def predict(self, past: Floats, known: Bools, velocity: Floats, steps: int) -> Floats:
        """See `Predictor.predict`."""
        velocities, readable, ahead = own_frame(past, known, velocity, self.time_step)
        people = velocities.reshape(-1, *velocities.shape[-2:])
        aside = np.empty((len(people), steps, 2), np.float32)
        swerve(
            len(people), people, readable.reshape(-1, readable.shape[-1]), *self.weights,
            self.time_step, aside,
        )  # fmt: skip
        aside = aside.reshape(*velocity.shape[:-1], steps, 2)
        straight = super().predict(past, known, velocity, steps)
        return straight + rotate_vectors(aside, ahead[..., None, :])


def shapes(size: int) -> dict[str, tuple[int, ...]]:
    """Names and shapes of the weights of a network with `size` hidden units."""
    return {
        "w_input": (2, 3 * size), "w_hidden": (size, 3 * size), "bias": (3 * size,),
        "w_output": (size, 2),
    }  # fmt: skip


def own_frame(
    past: Floats, known: Bools, velocity: Floats, time_step: np.float32
) -> tuple[Floats, Bools, Floats]:
    """People's last velocities in frames that look where they went last.

    Returns:
        [..., L, 2] velocities in m/s, the last of them `velocity`, with L = max(H - 1, 1);
        [..., L] which are known; [..., 2] the direction ahead, zero for who did not move.
    """
    before = (past[..., 1:-1, :] - past[..., :-2, :]) / time_step
    readable = known[..., 1:-1] & known[..., :-2]
    before = np.where(readable[..., None], before, np.float32(0.0))
    velocities = np.concatenate([before, velocity[..., None, :]], -2)
    readable = np.concatenate([readable, np.ones((*readable.shape[:-1], 1), np.bool_)], -1)
    speed = np.sqrt((velocities * velocities).sum(-1))
    moved = readable & (speed > MOVING)
    last = moved.shape[-1] - 1 - moved[..., ::-1].argmax(-1)[..., None]
    ahead = np.take_along_axis(velocities, last[..., None], -2)[..., 0, :]
    ahead = ahead / np.maximum(np.take_along_axis(speed, last, -1), np.float32(MOVING))
    ahead = np.where(moved.any(-1, keepdims=True), ahead, np.float32(0.0))
    return unrotate_vectors(velocities, ahead[..., None, :]), readable, ahead


def find_predictor(name: str, time_step: float, field: str = "predictor") -> Predictor:
    """The predictor of a name or of a file of weights.

    Args:
        name: a registered name, a shipped file without its ending, or the path of a file.
        time_step: of the simulator, s.
        field: that holds the name, for errors.

    Raises:
        ConfigurationError: it is none of them; the file is damaged, or made for another time step.
    """
    if name in PREDICTORS:
        return PREDICTORS[name](time_step)
    for path in (Path(name), SHIPPED / f"{name}.safetensors"):
        if path.is_file():
            return load_recurrent(path, time_step, field)
    known = ", ".join([*PREDICTORS, *sorted(path.stem for path in SHIPPED.glob("*.safetensors"))])
    raise ConfigurationError(
        f"{field} is {name!r}; it must be a .safetensors file or one of {known}"
    )


def load_recurrent(path: Path, time_step: float, field: str = "predictor") -> RecurrentPredictor:
    """Read the weights of a network and the card beside them.

    Raises:
        ConfigurationError: see `find_predictor`.
    """
    card_path = path.with_suffix(".json")
    try:
        content = path.read_bytes()
        card = json.loads(card_path.read_text(encoding="utf-8"))
        version, digest = card["format"], card["sha256"]
        history, trained_for = card["history"], float(card["time_step"])
    except OSError as error:
        raise ConfigurationError(
            f"{field}: {error.filename} cannot be read ({error.strerror}); a predictor is a "
            ".safetensors file and, beside it, a .json file of the same name"
        ) from None
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise ConfigurationError(
            f"{field}: {card_path} is not the card of a predictor ({error!r})"
        ) from None
    if version != FORMAT:
        raise ConfigurationError(
            f"{field}: {card_path} has format {version!r}; it must be {FORMAT}"
        )
    if hashlib.sha256(content).hexdigest() != digest:
        raise ConfigurationError(
            f"{field}: {path} is damaged: it is not the file that {card_path} describes"
        )
    if not (type(history) is int and 1 <= history <= MOST_HISTORY):
        raise ConfigurationError(
            f"{field}: {card_path} has history {history!r:.60}; it must be a whole number in "
            f"[1, {MOST_HISTORY}]"
        )
    if not abs(trained_for - time_step) <= 1e-6:
        raise ConfigurationError(
            f"{field}: {path.name} predicts in steps of {trained_for:g} s; scenario.time_step is "
            f"{time_step:g}"
        )
    return RecurrentPredictor(_checked(content, path, field), history, time_step)


def _checked(content: bytes, path: Path, field: str) -> dict[str, NDArray[Any]]:
    """The weights in a file, which must have the names and shapes of a network."""
    from safetensors import SafetensorError  # not on robots that predict at constant velocity
    from safetensors.numpy import load

    try:
        weights = load(content)
    except (SafetensorError, ValueError, TypeError, KeyError) as error:
        raise ConfigurationError(
            f"{field}: {path} is no file of weights ({str(error).splitlines()[0]})"
        ) from None
    found = {name: weight.shape for name, weight in weights.items()}
    expected = shapes(found["w_hidden"][0] if found.get("w_hidden") else 1)
    if found != expected:
        raise ConfigurationError(f"{field}: {path} has weights {found}; they must be {expected}")
    for name, weight in weights.items():
        if weight.dtype != np.float32:
            raise ConfigurationError(
                f"{field}: {path} has {name} of {weight.dtype}; it must be of float32"
            )
        if not np.isfinite(weight).all():
            raise ConfigurationError(
                f"{field}: {path} has {name} with NaN or infinity in it; weights must be finite"
            )
    return weights
