"""People as they walk: windows of what was and what came of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Scenario, World
from mrsan.recording import COAST, RecordingError, load_recording
from samarl.prediction.training import Training

FAR = 1e4  # where the one robot stands aside, m


class Windows(NamedTuple):
    """B people, each at one moment: what was, and what came of it."""

    past: NDArray[np.float32]  # [B, H, 2] m
    known: NDArray[np.bool_]  # [B, H]
    velocity: NDArray[np.float32]  # [B, 2] m/s
    future: NDArray[np.float32]  # [B, K, 2] m


def watch(scenario: Scenario, cases: NDArray[np.int64], training: Training) -> Windows:
    """People of a crowd in some cases, with no robot near them."""
    world = World(replace(scenario, robots=1, robots_visible=False, time_limit=1e4), len(cases))
    world.reset(cases)
    world.state.robot_position[:] = FAR
    action = np.zeros((len(cases), 1, world.scenario.action_size), np.float32)
    state, seen = world.state, []
    for _ in range(training.duration):
        world.step(action)
        seen.append((state.human_position.copy(), state.human_velocity.copy(),
                     state.human_present.copy()))  # fmt: skip
    places, velocities, present = (np.stack(part) for part in zip(*seen, strict=True))
    people = training.duration, -1
    return _windows(
        places.reshape(*people, 2), velocities.reshape(*people, 2), present.reshape(people),
        training,
    )  # fmt: skip


def watch_recording(
    path: Path, frame_seconds: float | None, time_step: float, training: Training
) -> Windows:
    """People of a recording, without the first and the last 3 s of each, which are continued.

    Raises:
        ConfigurationError: it cannot be read, or nobody is there for long enough.
    """
    try:
        recording = load_recording(path, frame_seconds, time_step)
    except RecordingError as error:
        reason = str(error).replace("scenario.frame_seconds", f"frame_seconds.{path.stem}")
        raise ConfigurationError(f"recordings: {reason}") from None
    added = round(COAST / time_step)  # before and after, where nobody was seen
    found = []
    for first, last, row in zip(recording.first, recording.last, recording.row, strict=True):
        way = recording.position[row : row + last - first + 1, None][added:-added]
        velocity = np.diff(way, axis=0) / np.float32(time_step)
        if len(velocity) >= training.history + training.steps:
            there = np.ones(velocity.shape[:2], np.bool_)
            found.append(_windows(way[1:], velocity, there, training))
    if not found:
        raise ConfigurationError(
            f"recordings: nobody in {path} is there for {training.history + training.steps} steps"
        )
    return Windows(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _windows(
    places: NDArray[np.float32], velocities: NDArray[np.float32], present: NDArray[np.bool_],
    training: Training,
) -> Windows:  # fmt: skip
    """From [T, P, ...] to windows that begin half a history apart."""
    history, steps = training.history, training.steps
    found = []
    for now in range(history - 1, len(places) - steps, max(history // 2, 1)):
        before, after = slice(now - history + 1, now + 1), slice(now + 1, now + steps + 1)
        stay = present[now] & present[after].all(0)
        found.append((places[before, stay].swapaxes(0, 1), present[before, stay].swapaxes(0, 1),
                      velocities[now, stay], places[after, stay].swapaxes(0, 1)))  # fmt: skip
    return Windows(*(np.concatenate(part) for part in zip(*found, strict=True)))
