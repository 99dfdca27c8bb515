"""Trajectories of people and robots in the format of TrajNet++, for predictors of people."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

import numpy as np

from samarl.evaluation.trajectory import Trajectory, in_file_frame

_DECIMALS = 6  # of positions, m


def trajnet_lines(trajectories: Iterable[Trajectory]) -> Iterator[str]:
    """Yield the lines of a TrajNet++ file, for each case its scenes and then its tracks.

    A scene is the presence of one person, its primary pedestrian, in one case; `fps` is the rate of
    frames and `case` the case number. Tracks of robots are marked by `"robot": true`. Numbers of
    frames and agents are unique in the file, so agents of different cases never meet.

    Source: Kothari et al., Human Trajectory Forecasting in Crowds, 2021.
    """
    first_frame = first_agent = scene = 0
    for trajectory in trajectories:
        for person, start, end in _presences(trajectory):
            content = {
                "id": scene,
                "p": first_agent + person,
                "s": first_frame + start,
                "e": first_frame + end,
                "fps": 1.0 / trajectory.scenario.time_step,
                "case": trajectory.case,
            }
            yield json.dumps({"scene": content}) + "\n"
            scene += 1
        yield from _tracks(trajectory, first_frame, first_agent)
        first_frame += len(trajectory.driving)
        first_agent += trajectory.human_present.shape[1] + trajectory.driving.shape[1]


def _presences(trajectory: Trajectory) -> Iterator[tuple[int, int, int]]:
    """Yield each person with the first and last step of each uninterrupted presence."""
    for person, present in enumerate(trajectory.human_present.T):
        changes = np.diff(np.concatenate([[False], present, [False]]).astype(np.int8))
        starts, ends = np.flatnonzero(changes == 1), np.flatnonzero(changes == -1) - 1
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
            yield person, start, end


def _tracks(trajectory: Trajectory, first_frame: int, first_agent: int) -> Iterator[str]:
    """Yield where the people who are present and then the robots are in every frame."""
    people = trajectory.human_present.shape[1]
    positions = np.concatenate([trajectory.human_position, trajectory.robot_position], axis=1)
    positions = in_file_frame(positions, trajectory.scenario)
    present = np.pad(
        trajectory.human_present, ((0, 0), (0, trajectory.driving.shape[1])), constant_values=True
    )
    for step, agent in np.argwhere(present).tolist():
        x, y = positions[step, agent].round(_DECIMALS).tolist()
        track = {"f": first_frame + step, "p": first_agent + agent, "x": x, "y": y}
        if agent >= people:
            track["robot"] = True
        yield json.dumps({"track": track}) + "\n"
