"""Tracks of people and robots: those out of view move on at constant velocity, with their age."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import OTHER_FEATURES, Entities, Observation, Scenario
from mrsan.features import (
    HEADING_COS,
    HEADING_SIN,
    ORIGIN_X,
    ORIGIN_Y,
    OTHER_RADIUS,
    OTHER_VELOCITY_X,
    OTHER_VELOCITY_Y,
    OTHER_X,
    OTHER_Y,
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.kernels import function, kernel
from mrsan.se2 import rotate, transform, unrotate, untransform

TRACK_FEATURES = (*OTHER_FEATURES, "age")  # age: share of the longest time a track is kept
AGE = 5

_ZERO = np.float32(0.0)


class TrackMemory(NamedTuple):
    """The tracks of every robot, in the world frame; a robot knows its own pose, so it can.

    Tracks are never forgotten here: each reader, such as a policy or its shield, has a time after
    the last sighting up to which it knows a track.
    """

    humans: NDArray[np.float32]  # [E, N, M, 5] position, velocity, radius
    human_age: NDArray[np.float32]  # [E, N, M] steps since the last sighting, -1: none yet
    robots: NDArray[np.float32]  # [E, N, N - 1, 5]
    robot_age: NDArray[np.float32]  # [E, N, N - 1]


class Tracker:
    """Track the people and robots that each robot has seen.

    Other groups of entities and sensors are passed on as observed.
    """

    def __init__(self, track_time: float, time_step: float) -> None:
        """Know a track for `track_time` seconds after the last sighting; both arguments in s."""
        self.steps = round(track_time / time_step)
        self.time_step = np.float32(time_step)

    def initial(self, worlds: int, robots: int, humans: int) -> TrackMemory:
        """Return a memory without tracks."""
        return TrackMemory(
            *_no_tracks((worlds, robots, humans)), *_no_tracks((worlds, robots, robots - 1))
        )

    def update(
        self,
        observation: Observation,
        memory: TrackMemory,
        is_init: NDArray[np.bool_],
        elapsed: float | None = None,
    ) -> Observation:
        """Update the tracks with an observation and return what is known now.

        Args:
            observation: of all worlds.
            memory: of all worlds, updated in place.
            is_init: [E] the worlds in which an episode begins; their tracks are cleared.
            elapsed: time since the last update, s; None: one step. It is 0 for a second tracker
                that reads the same memory, with a time of its own.
        """
        dt = self.time_step if elapsed is None else np.float32(elapsed)
        memory.human_age[is_init], memory.robot_age[is_init] = -1, -1
        known = {}
        for name in ("humans", "robots"):
            visible = observation.entities[name].mask
            features = np.empty((*visible.shape, len(TRACK_FEATURES)), np.float32)
            known[name] = Entities(features, np.empty(visible.shape, np.bool_))
        _track(
            len(observation.ego),
            *observation.agents,
            self.steps,
            dt,
            dt / self.time_step,
            *memory,
            *known["humans"],
            *known["robots"],
        )
        return Observation(observation.ego, {**observation.entities, **known}, observation.sensors)


class EpisodeTracks:
    """The tracks of all robots of E worlds, which are cleared where an episode begins."""

    def __init__(self, scenario: Scenario, track_time: float) -> None:
        """Start without tracks; for `track_time` see `Tracker`."""
        self._scenario, self._tracker = scenario, Tracker(track_time, scenario.time_step)
        self._begin(0)

    def _begin(self, worlds: int) -> None:
        self.memory = self._tracker.initial(worlds, self._scenario.robots, self._scenario.humans)
        self._is_init = np.ones(worlds, np.bool_)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the tracks of the worlds [E] in which an episode begins."""
        if len(worlds) != len(self._is_init):
            self._begin(len(worlds))
        self._is_init |= worlds

    def update(self, observation: Observation) -> Observation:
        """Return what is known after an observation."""
        if len(observation.ego) != len(self._is_init):
            self._begin(len(observation.ego))
        tracks = self._tracker.update(observation, self.memory, self._is_init)
        self._is_init = np.zeros(len(tracks.ego), np.bool_)
        return tracks


def _no_tracks(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.zeros((*shape, 5), np.float32), np.full(shape, -1.0, np.float32)


@kernel
def _track(
    first,
    last,
    ego,
    humans,
    humans_visible,
    robots,
    robots_visible,
    steps,
    dt,
    dt_steps,
    human_tracks,
    human_age,
    robot_tracks,
    robot_age,
    humans_out,
    humans_known,
    robots_out,
    robots_known,
):
    for e in range(first, last):
        for i in range(ego.shape[1]):
            own, people, mates = ego[e, i], human_tracks[e, i], robot_tracks[e, i]
            _update_tracks(
                own, humans[e, i], humans_visible[e, i], dt, dt_steps, people, human_age[e, i]
            )
            _write_tracks(own, steps, people, human_age[e, i], humans_out[e, i], humans_known[e, i])
            _update_tracks(
                own, robots[e, i], robots_visible[e, i], dt, dt_steps, mates, robot_age[e, i]
            )
            _write_tracks(own, steps, mates, robot_age[e, i], robots_out[e, i], robots_known[e, i])


@function
def _pose(ego):
    """Return cosine and sine of the robot's heading, and its position in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    x, y = rotate(cos, sin, ego[ORIGIN_X], ego[ORIGIN_Y])  # from the robot to the origin
    return cos, sin, -x, -y


@function
def _update_tracks(ego, observed, visible, dt, dt_steps, tracks, age):
    """Move every track [M, 5] (world frame) on by `dt` and replace those that are observed.

    `dt_steps` is the same time in steps.
    """
    cos, sin, x, y = _pose(ego)
    for j in range(observed.shape[0]):
        if visible[j]:
            tracks[j, OTHER_X], tracks[j, OTHER_Y] = transform(
                cos, sin, x, y, observed[j, OTHER_X], observed[j, OTHER_Y]
            )
            vx = observed[j, OTHER_VELOCITY_X] + ego[VELOCITY_X]
            vy = observed[j, OTHER_VELOCITY_Y] + ego[VELOCITY_Y]
            tracks[j, OTHER_VELOCITY_X], tracks[j, OTHER_VELOCITY_Y] = rotate(cos, sin, vx, vy)
            tracks[j, OTHER_RADIUS] = observed[j, OTHER_RADIUS]
            age[j] = _ZERO
        elif age[j] >= _ZERO:
            tracks[j, OTHER_X] += tracks[j, OTHER_VELOCITY_X] * dt
            tracks[j, OTHER_Y] += tracks[j, OTHER_VELOCITY_Y] * dt
            age[j] += dt_steps


@function
def _write_tracks(ego, steps, tracks, age, out, known):
    """Write the tracks in the body frame of the robot."""
    cos, sin, x, y = _pose(ego)
    for j in range(age.shape[0]):
        known[j] = _ZERO <= age[j] <= steps
        if not known[j]:
            out[j, :] = _ZERO
            continue
        out[j, OTHER_X], out[j, OTHER_Y] = untransform(
            cos, sin, x, y, tracks[j, OTHER_X], tracks[j, OTHER_Y]
        )
        vx, vy = unrotate(cos, sin, tracks[j, OTHER_VELOCITY_X], tracks[j, OTHER_VELOCITY_Y])
        out[j, OTHER_VELOCITY_X], out[j, OTHER_VELOCITY_Y] = (
            vx - ego[VELOCITY_X],
            vy - ego[VELOCITY_Y],
        )
        out[j, OTHER_RADIUS] = tracks[j, OTHER_RADIUS]
        out[j, AGE] = age[j] / np.float32(max(steps, 1))
