"""Predictors of people: one interface, constant velocity, and a small recurrent network.

Settings refer to a predictor by its registered name or by a weights file of the network.
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
from mrsan.kernels.recurrent import predict_offsets
from mrsan.plugin_values import as_numbers, check_finite, check_shape
from mrsan.se2 import rotate_vectors, unrotate_vectors
from mrsan.state import Bools, Floats, State

SHIPPED = Path(__file__).parent / "predictors"
FORMAT = 1  # of a weights file and its card
MOST_HISTORY = 200  # largest number of positions that a network reads
MIN_MOVING_SPEED = 0.05  # slower people have no direction of motion, m/s


class Predictor(ABC):
    """Predicts the positions of people from their past ones.

    There may be any leading axes; the last of them, M, is over people in the same place, which
    matters only to predictors of interaction. Positions are in any frame at rest.
    """

    history: int = 1  # number H of positions that it reads, including the present one

    def __init__(self, time_step: float) -> None:
        """Predict in steps of `time_step` seconds."""
        self.time_step = np.float32(time_step)

    @abstractmethod
    def predict(self, past: Floats, valid: Bools, velocity: Floats, steps: int) -> Floats:
        """Return positions after 1..K steps, [..., M, K, 2] in m.

        Args:
            past: [..., M, H, 2] positions, one step apart, m; the last is the present one.
            valid: [..., M, H] bool; other positions are arbitrary. If the last is invalid, the
                prediction is arbitrary.
            velocity: [..., M, 2] present velocities, m/s.
            steps: K.
        """


PREDICTORS: dict[str, type[Predictor]] = {}
P = TypeVar("P", bound=type[Predictor])


def register_predictor(name: str) -> Callable[[P], P]:
    """Register a class by a name; it is constructed with the time step only."""

    def register(cls: P) -> P:
        PREDICTORS[name] = cls
        return cls

    return register


@register_predictor("constant_velocity")
class ConstantVelocity(Predictor):
    """Predicts that all people keep their velocities."""

    def predict(self, past: Floats, valid: Bools, velocity: Floats, steps: int) -> Floats:
        """See `Predictor.predict`."""
        times = np.arange(1, steps + 1, dtype=np.float32)[:, None] * self.time_step
        return past[..., -1:, :] + velocity[..., None, :] * times


class RecurrentPredictor(ConstantVelocity):
    """Constant velocity plus offsets from a small network, for each person separately.

    Its inputs and outputs are in the person's own frame, so predictions rotate with the world. A
    person who has not moved recently has no such frame and stays. Zero weights give constant
    velocity.
    """

    def __init__(self, weights: dict[str, Floats], history: int, time_step: float) -> None:
        """Store the weights, named as in `mrsan.kernels.recurrent.predict_offsets`."""
        super().__init__(time_step)
        self.history = history
        self.weights = [np.ascontiguousarray(weights[name], np.float32) for name in shapes(1)]

    def predict(self, past: Floats, valid: Bools, velocity: Floats, steps: int) -> Floats:
        """See `Predictor.predict`."""
        velocities, readable, direction = own_frame(past, valid, velocity, self.time_step)
        people = velocities.reshape(-1, *velocities.shape[-2:])
        offsets = np.empty((len(people), steps, 2), np.float32)
        predict_offsets(
            len(people),
            people,
            readable.reshape(-1, readable.shape[-1]),
            *self.weights,
            self.time_step,
            offsets,
        )
        offsets = offsets.reshape(*velocity.shape[:-1], steps, 2)
        straight = super().predict(past, valid, velocity, steps)
        return straight + rotate_vectors(offsets, direction[..., None, :])


def shapes(size: int) -> dict[str, tuple[int, ...]]:
    """Return names and shapes of the weights of a network with `size` hidden units."""
    return {
        "w_input": (2, 3 * size),
        "w_hidden": (size, 3 * size),
        "bias": (3 * size,),
        "w_output": (size, 2),
    }


def own_frame(
    past: Floats, valid: Bools, velocity: Floats, time_step: np.float32
) -> tuple[Floats, Bools, Floats]:
    """Return people's last velocities in their own frames, which face their last direction.

    Args:
        past: [..., M, H, 2] positions, see `Predictor.predict`, m.
        valid: [..., M, H] bool, which of them are valid.
        velocity: [..., M, 2] present velocities, m/s.
        time_step: s.

    Returns:
        [..., L, 2] velocities in m/s, the last of them `velocity`, with L = max(H - 1, 1);
        [..., L] which are valid; [..., 2] the direction, zero for people who did not move.
    """
    earlier = (past[..., 1:-1, :] - past[..., :-2, :]) / time_step
    readable = valid[..., 1:-1] & valid[..., :-2]
    earlier = np.where(readable[..., None], earlier, np.float32(0.0))
    velocities = np.concatenate([earlier, velocity[..., None, :]], -2)
    readable = np.concatenate([readable, np.ones((*readable.shape[:-1], 1), np.bool_)], -1)
    speed = np.sqrt((velocities * velocities).sum(-1))
    moved = readable & (speed > MIN_MOVING_SPEED)
    last = moved.shape[-1] - 1 - moved[..., ::-1].argmax(-1)[..., None]
    direction = np.take_along_axis(velocities, last[..., None], -2)[..., 0, :]
    direction = direction / np.maximum(
        np.take_along_axis(speed, last, -1), np.float32(MIN_MOVING_SPEED)
    )
    direction = np.where(moved.any(-1, keepdims=True), direction, np.float32(0.0))
    return unrotate_vectors(velocities, direction[..., None, :]), readable, direction


def checked_prediction(
    predictor: Predictor,
    past: Floats,
    valid: Bools,
    velocity: Floats,
    steps: int,
    state: State | None = None,
) -> Floats:
    """Return what a predictor predicts for everybody whose present position is valid.

    Args:
        predictor: may be a plugin.
        past: as of `Predictor.predict`, as the next three.
        valid: likewise.
        velocity: likewise.
        steps: likewise.
        state: the worlds, if people [E, M] are those of a state; for the message.

    Raises:
        PluginError: the prediction has another shape, or one for such a person is not finite.
    """
    name = f"predictor {type(predictor).__name__}"
    predicted = as_numbers(name, predictor.predict(past, valid, velocity, steps))
    check_shape(name, predicted.shape, (*velocity.shape[:-1], steps, 2))
    check_finite(name, predicted, state, valid[..., -1])
    return predicted


def find_predictor(name: str, time_step: float, field: str = "predictor") -> Predictor:
    """Return a predictor by its name or weights file.

    Args:
        name: a registered name, an included file without its extension, or the path of a file.
        time_step: of the simulator, s.
        field: name of the setting, for errors.

    Raises:
        ConfigurationError: there is no such predictor, or its file is damaged or for another time
            step.
    """
    if name in PREDICTORS:
        return PREDICTORS[name](time_step)
    for path in (Path(name), SHIPPED / f"{name}.safetensors"):
        if path.is_file():
            return load_recurrent(path, time_step, field)
    names = ", ".join([*PREDICTORS, *sorted(path.stem for path in SHIPPED.glob("*.safetensors"))])
    raise ConfigurationError(
        f"{field} is {name!r}; it must be a .safetensors file or one of {names}"
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
            f"{field}: {card_path} is not the card of a predictor ({error!r:.300})"
        ) from None
    if version != FORMAT:
        raise ConfigurationError(
            f"{field}: {card_path} has format {version!r:.60}; it must be {FORMAT}"
        )
    if hashlib.sha256(content).hexdigest() != digest:
        raise ConfigurationError(
            f"{field}: {path} is damaged: its SHA-256 digest differs from the one in {card_path}"
        )
    if not (type(history) is int and 1 <= history <= MOST_HISTORY):
        raise ConfigurationError(
            f"{field}: {card_path} has history {history!r:.60}; it must be a whole number in "
            f"[1, {MOST_HISTORY}]"
        )
    if not abs(trained_for - time_step) <= 1e-6:
        raise ConfigurationError(
            f"{field}: {path.name} predicts in steps of {trained_for:g} s; scenario.time_step is "
            f"{time_step:g} and must be the same"
        )
    return RecurrentPredictor(_checked_weights(content, path, field), history, time_step)


def _checked_weights(content: bytes, path: Path, field: str) -> dict[str, NDArray[Any]]:
    """Return the weights in a file, which must have the names and shapes of a network."""
    from safetensors import SafetensorError  # imported here because robots may run without it
    from safetensors.numpy import load

    try:
        weights = load(content)
    except (SafetensorError, ValueError, TypeError, KeyError) as error:
        raise ConfigurationError(
            f"{field}: {path} is not a weights file ({str(error).splitlines()[0]})"
        ) from None
    actual = {name: weight.shape for name, weight in weights.items()}
    expected = shapes(actual["w_hidden"][0] if actual.get("w_hidden") else 1)
    if actual != expected:
        raise ConfigurationError(f"{field}: {path} has weights {actual}; they must be {expected}")
    for name, weight in weights.items():
        if weight.dtype != np.float32:
            raise ConfigurationError(
                f"{field}: {path} has {name} of type {weight.dtype}; it must be float32"
            )
        if not np.isfinite(weight).all():
            raise ConfigurationError(
                f"{field}: {path} has NaN or infinity in {name}; weights must be finite"
            )
    return weights
