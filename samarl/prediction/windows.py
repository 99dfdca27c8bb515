"""Training data of the predictor: windows of the motion of people."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, CrowdReaction, Scenario, World
from mrsan.recording import COAST, RecordingError, load_recording
from samarl.prediction.training import Training

FAR = 1e4  # coordinates of the only robot, away from everybody, m


class Windows(NamedTuple):
    """Past and future of B people, each at one time."""

    past: NDArray[np.float32]  # [B, H, 2] m
    known: NDArray[np.bool_]  # [B, H]
    velocity: NDArray[np.float32]  # [B, 2] m/s
    future: NDArray[np.float32]  # [B, K, 2] m


def simulate_windows(scenario: Scenario, cases: NDArray[np.int64], training: Training) -> Windows:
    """Simulate a crowd in the given cases without a robot nearby."""
    alone = replace(scenario, robots=1, crowd_reaction=CrowdReaction.blind, time_limit=1e4)
    world = World(alone, len(cases))
    world.reset(cases)
    world.state.robot_position[:] = FAR
    action = np.zeros((len(cases), 1, world.scenario.action_size), np.float32)
    state, snapshots = world.state, []
    for _ in range(training.duration):
        world.step(action)
        snapshots.append(
            (state.human_position.copy(), state.human_velocity.copy(), state.human_present.copy())
        )
    positions, velocities, present = (np.stack(part) for part in zip(*snapshots, strict=True))
    people = training.duration, -1
    return _windows(
        positions.reshape(*people, 2),
        velocities.reshape(*people, 2),
        present.reshape(people),
        training,
    )


def recorded_windows(
    path: Path, frame_seconds: float | None, time_step: float, training: Training
) -> Windows:
    """Return windows of a recording, without the extrapolated seconds before and after each track.

    Raises:
        ConfigurationError: the recording cannot be read, or all tracks are too short.
    """
    try:
        recording = load_recording(path, frame_seconds, time_step)
    except RecordingError as error:
        reason = str(error).replace("scenario.frame_seconds", f"frame_seconds.{path.stem}")
        raise ConfigurationError(f"recordings: {reason}") from None
    extrapolated = round(COAST / time_step)  # steps before and after each track
    windows = []
    for first, last, row in zip(recording.first, recording.last, recording.row, strict=True):
        positions = recording.position[row : row + last - first + 1, None][
            extrapolated:-extrapolated
        ]
        velocity = np.diff(positions, axis=0) / np.float32(time_step)
        if len(velocity) >= training.history + training.steps:
            present = np.ones(velocity.shape[:2], np.bool_)
            windows.append(_windows(positions[1:], velocity, present, training))
    if not windows:
        raise ConfigurationError(
            f"recordings: {path} has no track of at least {training.history + training.steps} steps"
        )
    return Windows(*(np.concatenate(part) for part in zip(*windows, strict=True)))


def _windows(
    positions: NDArray[np.float32],
    velocities: NDArray[np.float32],
    present: NDArray[np.bool_],
    training: Training,
) -> Windows:
    """Cut series [T, P, ...] into windows half a history apart."""
    history, steps = training.history, training.steps
    windows = []
    for now in range(history - 1, len(positions) - steps, max(history // 2, 1)):
        past, future = slice(now - history + 1, now + 1), slice(now + 1, now + steps + 1)
        stay = present[now] & present[future].all(0)
        windows.append(
            (
                positions[past, stay].swapaxes(0, 1),
                present[past, stay].swapaxes(0, 1),
                velocities[now, stay],
                positions[future, stay].swapaxes(0, 1),
            )
        )
    return Windows(*(np.concatenate(part) for part in zip(*windows, strict=True)))
