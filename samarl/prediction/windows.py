"""People as they walk: windows of what was and what came of it, and how far predictions are off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Scenario, World
from mrsan.prediction import ConstantVelocity, Predictor
from mrsan.recording import COAST, RecordingError, load_recording
from mrsan.scenario import check_numbers, required

FAR = 1e4  # where the one robot stands aside, m


class Windows(NamedTuple):
    """B people, each at one moment: what was, and what came of it."""

    past: NDArray[np.float32]  # [B, H, 2] m
    known: NDArray[np.bool_]  # [B, H]
    velocity: NDArray[np.float32]  # [B, 2] m/s
    future: NDArray[np.float32]  # [B, K, 2] m


@dataclass
class Watching:
    """What a window is, and for how long crowds are watched."""

    history: int = required(2, 200)  # positions that are read, H
    steps: int = required(1, 200)  # to foresee, K
    duration: int = required(1, 10**5)  # steps for which a crowd is watched

    def __post_init__(self) -> None:
        """Check every number, and that a crowd is watched for long enough."""
        check_numbers(self, "training")
        if self.duration < self.history + self.steps:
            raise ConfigurationError(
                f"training.duration is {self.duration}; it must be at least training.history + "
                f"training.steps ({self.history + self.steps})"
            )


def watch(scenario: Scenario, cases: NDArray[np.int64], watching: Watching) -> Windows:
    """People of a crowd in some cases, with no robot near them."""
    world = World(replace(scenario, robots=1, robots_visible=False, time_limit=1e4), len(cases))
    world.reset(cases)
    world.state.robot_position[:] = FAR
    action = np.zeros((len(cases), 1, world.scenario.action_size), np.float32)
    state, seen = world.state, []
    for _ in range(watching.duration):
        world.step(action)
        seen.append((state.human_position.copy(), state.human_velocity.copy(),
                     state.human_present.copy()))  # fmt: skip
    places, velocities, present = (np.stack(part) for part in zip(*seen, strict=True))
    people = watching.duration, -1
    return _windows(
        places.reshape(*people, 2), velocities.reshape(*people, 2), present.reshape(people),
        watching,
    )  # fmt: skip


def watch_recording(
    path: Path, frame_seconds: float, time_step: float, watching: Watching
) -> Windows:
    """People of a recording, between their first and their last annotation.

    Raises:
        ConfigurationError: it cannot be read, or nobody is there for long enough.
    """
    try:
        recording = load_recording(path, frame_seconds, time_step)
    except RecordingError as error:
        raise ConfigurationError(f"recordings: {error}") from None
    added = round(COAST / time_step)  # before and after, where nobody was seen
    found = []
    for first, last, row in zip(recording.first, recording.last, recording.row, strict=True):
        way = recording.position[row + added : row + last - first + 1 - added, None]
        velocity = np.diff(way, axis=0) / np.float32(time_step)
        if len(velocity) >= watching.history + watching.steps:
            there = np.ones(velocity.shape[:2], np.bool_)
            found.append(_windows(way[1:], velocity, there, watching))
    if not found:
        raise ConfigurationError(
            f"recordings: nobody in {path} is there for {watching.history + watching.steps} steps"
        )
    return Windows(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _windows(
    places: NDArray[np.float32], velocities: NDArray[np.float32], present: NDArray[np.bool_],
    watching: Watching,
) -> Windows:  # fmt: skip
    """From [T, P, ...] to windows that begin half a history apart."""
    history, steps = watching.history, watching.steps
    found = []
    for now in range(history - 1, len(places) - steps, max(history // 2, 1)):
        before, after = slice(now - history + 1, now + 1), slice(now + 1, now + steps + 1)
        stay = present[now] & present[after].all(0)
        found.append((places[before, stay].swapaxes(0, 1), present[before, stay].swapaxes(0, 1),
                      velocities[now, stay], places[after, stay].swapaxes(0, 1)))  # fmt: skip
    return Windows(*(np.concatenate(part) for part in zip(*found, strict=True)))


def displacement(predictor: Predictor, windows: Windows, steps: int) -> list[float]:
    """Mean distance of people from where they were predicted after 1..K steps, m."""
    known = windows.known[:, None, -predictor.history :]
    past = windows.past[:, None, -predictor.history :]
    found = predictor.predict(past, known, windows.velocity[:, None], steps)[:, 0]
    error = np.linalg.norm(found - windows.future[:, :steps], axis=-1).mean(0)
    return [round(float(value), 4) for value in error]


def errors(predictor: Predictor, crowds: Mapping[str, Windows], steps: int) -> dict[str, Any]:
    """`displacement` of a predictor and of constant velocity, crowd by crowd."""
    plain = ConstantVelocity(float(predictor.time_step))
    return {
        name: {
            "windows": len(windows.past),
            "constant_velocity": displacement(plain, windows, steps),
            "predictor": displacement(predictor, windows, steps),
        }
        for name, windows in crowds.items()
    }
