"""Predicting people: by hand, by symmetry, against plain Python, and files that are wrong."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from mrsan.prediction import (
    FORMAT,
    PREDICTORS,
    SHIPPED,
    ConstantVelocity,
    RecurrentPredictor,
    find_predictor,
    shapes,
)

H, K, DT, HIDDEN = 6, 7, 0.25, 5
People = tuple[np.ndarray, np.ndarray, np.ndarray]


def weights(scale: float = 0.5) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {
        name: rng.normal(0, scale, shape).astype(np.float32)
        for name, shape in shapes(HIDDEN).items()
    }


NETWORK = RecurrentPredictor(weights(), H, DT)


def walks(worlds: int = 5, people: int = 4) -> People:
    """People who walk at random, some of whom came into view lately."""
    rng = np.random.default_rng(0)
    velocity = np.cumsum(rng.normal(0, 0.4, (worlds, people, H, 2)), 2)
    past = (rng.normal(0, 5, (worlds, people, 1, 2)) + np.cumsum(DT * velocity, 2)).astype("f4")
    known = np.arange(H) >= rng.integers(0, H, (worlds, people, 1))
    return past, known, velocity[..., -1, :].astype(np.float32)


def test_weights_of_zero_are_constant_velocity_to_the_bit() -> None:
    zero = RecurrentPredictor(weights(0.0), H, DT)
    people = walks()
    np.testing.assert_array_equal(
        zero.predict(*people, K), ConstantVelocity(DT).predict(*people, K)
    )
    assert np.abs(NETWORK.predict(*people, K) - zero.predict(*people, K)).max() > 0.1


@pytest.mark.parametrize("angle", [0.3, 2.0, -1.2])
def test_it_turns_and_moves_with_the_world(angle: float) -> None:
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin], [-sin, cos]], np.float32)
    past, known, velocity = walks()
    moved = past @ turn + np.float32(3), known, velocity @ turn
    positions = NETWORK.predict(past, known, velocity, K) @ turn + np.float32(3)
    np.testing.assert_allclose(NETWORK.predict(*moved, K), positions, atol=1e-4)


def test_what_is_not_known_does_not_matter_by_one_bit() -> None:
    past, known, velocity = walks()
    known[..., -1] = True
    other = np.where(known[..., None], past, np.float32(77))
    assert (other != past).any()
    positions = NETWORK.predict(past, known, velocity, K)
    np.testing.assert_array_equal(NETWORK.predict(other, known, velocity, K), positions)


def read(w: dict[str, np.ndarray], hidden: list[float], x: float, y: float) -> list[float]:
    """A gated recurrent unit in plain Python."""

    def squash(a: float) -> float:
        return a / (1 + abs(a))

    def inputs(o: int) -> float:
        return float(w["bias"][o] + w["w_input"][0, o] * x + w["w_input"][1, o] * y)

    def before(o: int) -> float:
        return sum(float(w["w_hidden"][i, o]) * hidden[i] for i in range(HIDDEN))

    new = []
    for i in range(HIDDEN):
        update = 0.5 + 0.5 * squash(inputs(i) + before(i))
        reset = 0.5 + 0.5 * squash(inputs(HIDDEN + i) + before(HIDDEN + i))
        candidate = squash(inputs(2 * HIDDEN + i) + reset * before(2 * HIDDEN + i))
        new.append((1 - update) * candidate + update * hidden[i])
    return new


def test_the_network_agrees_with_plain_python() -> None:
    w, (past, known, velocity) = weights(), walks(worlds=1)
    positions = NETWORK.predict(past, known, velocity, K)[0]
    for j in range(len(positions)):
        angle = np.arctan2(velocity[0, j, 1], velocity[0, j, 0])
        cos, sin = np.cos(angle), np.sin(angle)
        hidden = [0.0] * HIDDEN
        for t in range(1, H):
            v = velocity[0, j] if t == H - 1 else (past[0, j, t] - past[0, j, t - 1]) / DT
            if t == H - 1 or (known[0, j, t] and known[0, j, t - 1]):
                hidden = read(w, hidden, cos * v[0] + sin * v[1], cos * v[1] - sin * v[0])
        speed, added = float(np.hypot(*velocity[0, j])), np.zeros(2)
        place = np.zeros(2)
        for k in range(K):
            if k > 0:
                hidden = read(w, hidden, speed + added[0], added[1])
            added = added + np.array(hidden) @ w["w_output"]
            place = place + DT * (added + np.array([speed, 0.0]))
            expected = past[0, j, -1] + [
                cos * place[0] - sin * place[1],
                sin * place[0] + cos * place[1],
            ]
            np.testing.assert_allclose(positions[j, k], expected, atol=2e-5)


@pytest.mark.parametrize(
    "name", [*PREDICTORS, *(path.stem for path in SHIPPED.glob("*.safetensors"))]
)
def test_every_predictor_does_what_the_interface_says(name: str) -> None:
    predictor = find_predictor(name, DT)
    past, known, velocity = walks()
    past = np.repeat(past, predictor.history, 2)[:, :, -predictor.history :]
    known = np.repeat(known, predictor.history, 2)[:, :, -predictor.history :]
    positions = predictor.predict(past, known, velocity, K)
    assert positions.shape == (5, 4, K, 2)
    assert positions.dtype == np.float32
    assert np.isfinite(positions).all()
    np.testing.assert_array_equal(predictor.predict(past, known, velocity, K), positions)
    assert predictor.predict(past[:, :0], known[:, :0], velocity[:, :0], K).shape == (5, 0, K, 2)


def written(folder: Path, content: bytes, **card: object) -> str:
    path = folder / "mine.safetensors"
    path.write_bytes(content)
    known = {"format": FORMAT, "history": H, "time_step": DT, "provenance": {}}
    digest = hashlib.sha256(content).hexdigest()
    path.with_suffix(".json").write_text(json.dumps(known | {"sha256": digest} | card))
    return str(path)


def test_a_file_is_what_was_written(tmp_path: Path) -> None:
    predictor = find_predictor(written(tmp_path, save(weights())), DT)
    assert predictor.history == H
    np.testing.assert_array_equal(predictor.predict(*walks(), K), NETWORK.predict(*walks(), K))


def test_the_simulator_does_not_load_torch() -> None:
    code = "import sys, mrsan; mrsan.World(mrsan.Scenario()); print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
