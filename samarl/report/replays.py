"""Recordings as the viewer of the report plays them: few characters, no loss that one can see."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Outcome
from samarl.evaluation.recording import Recording


def as_replay(recording: Recording) -> dict[str, Any]:
    """What the viewer needs of an episode, ready for JSON.

    Positions are in cm and headings in degrees, the first and then the changes from step to step.
    What is seen is the steps at which it comes into view, goes out of view, and so on; who is
    there, the steps at which each human comes, goes, and so on.
    """
    scenario, episodes = recording.scenario, recording.episodes
    return {
        "step": scenario.time_step,
        "fov": scenario.fov_degrees,
        "range": scenario.sensing_range,
        "zone": scenario.reward.discomfort_distance,
        "radius": scenario.robot_radius,
        "radii": [round(float(radius), 3) for radius in recording.human_radius],
        "goals": recording.robot_goal.round(2).tolist(),
        "robots": _points(recording.robot_position),
        "headings": _changes(np.degrees(np.unwrap(recording.robot_heading, axis=0))),
        "humans": _points(recording.human_position),
        "humansPresent": _switches(recording.human_present[:, None])[0],
        "humansSeen": _switches(recording.humans_seen),
        "robotsSeen": _switches(recording.robots_seen),
        "humansReported": _told(recording.humans_reported),
        "robotsReported": _told(recording.robots_reported),
        "waypoints": None if recording.waypoint is None else _points(recording.waypoint),
        "humanAttention": _percent(recording.human_attention),
        "robotAttention": _percent(recording.robot_attention),
        "shielded": _steps_of(recording.shielded),
        "drivingSteps": recording.driving.sum(0).tolist(),
        "outcomes": [Outcome(value).name for value in episodes.outcome[0]],
    }


def _points(position: NDArray[np.float32]) -> list[list[list[int]]]:
    """[T, K, 2] m as K pairs of lists."""
    return [[*map(_differences, agent)] for agent in _whole(100 * position.transpose(1, 2, 0))]


def _changes(values: NDArray[np.float32]) -> list[list[int]]:
    """[T, K] as K lists."""
    return [_differences(series) for series in _whole(values.T)]


def _differences(series: NDArray[np.int64]) -> list[int]:
    return np.diff(series, prepend=0).tolist()


def _whole(values: NDArray[np.float32]) -> NDArray[np.int64]:
    return np.rint(values).astype(np.int64)


def _switches(seen: NDArray[np.bool_]) -> list[list[list[int]]]:
    """[T, N, K] as the steps at which each changes, of each robot and each it may see."""
    changed = np.diff(seen, axis=0, prepend=np.zeros((1, *seen.shape[1:]), np.bool_))
    return [
        [np.flatnonzero(changed[:, i, k]).tolist() for k in range(seen.shape[2])]
        for i in range(seen.shape[1])
    ]


def _told(told: NDArray[np.bool_]) -> list[list[list[int]]] | None:
    """The same of whom only team-mates see; most robots are told of nobody."""
    return _switches(told) if told.any() else None


def _steps_of(happened: NDArray[np.bool_] | None) -> list[list[int]] | None:
    """[T, N] as the steps at which it happened to each."""
    return None if happened is None else [np.flatnonzero(one).tolist() for one in happened.T]


def _percent(shares: NDArray[np.float32] | None) -> list[list[list[int]]] | None:
    """[T, N, K] shares as T lists of each robot's percentages."""
    return None if shares is None else _whole(100 * shares).tolist()
