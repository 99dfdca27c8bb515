"""Memory of those who left the view: coasted at constant velocity, flagged with the age."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mrsan import OTHER_FEATURES, Observation
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
_ONE = np.float32(1.0)


class Tracks(NamedTuple):
    """What every robot knows or remembers; rows without a track are zero."""

    ego: NDArray[np.float32]  # [E, N, 11]
    humans: NDArray[np.float32]  # [E, N, M, 6] TRACK_FEATURES
    humans_known: NDArray[np.bool_]  # [E, N, M]
    robots: NDArray[np.float32]  # [E, N, N - 1, 6]
    robots_known: NDArray[np.bool_]  # [E, N, N - 1]


class TrackMemory(NamedTuple):
    """The tracks of every robot, in the world frame; a robot knows its own pose, so it can."""

    humans: NDArray[np.float32]  # [E, N, M, 5] position, velocity, radius
    human_age: NDArray[np.float32]  # [E, N, M] steps since the last sighting, -1: no track
    robots: NDArray[np.float32]  # [E, N, N - 1, 5]
    robot_age: NDArray[np.float32]  # [E, N, N - 1]


class Tracker:
    """Follows everybody that was seen; it belongs to the robot's memory, not to its sensor."""

    def __init__(self, track_time: float, time_step: float) -> None:
        """Keep a track for `track_time` seconds after the last sighting; both arguments in s."""
        self.steps = round(track_time / time_step)
        self.time_step = np.float32(time_step)

    def initial(self, worlds: int, robots: int, humans: int) -> TrackMemory:
        """No tracks."""
        return TrackMemory(
            *_no_tracks((worlds, robots, humans)), *_no_tracks((worlds, robots, robots - 1))
        )

    def update(
        self,
        observation: Observation,
        memory: TrackMemory,
        is_init: NDArray[np.bool_],
        elapsed: float | None = None,
    ) -> Tracks:
        """Take in what is seen now and return what is known now.

        Args:
            observation: of all worlds.
            memory: of all worlds, updated in place.
            is_init: [E] the worlds in which an episode begins; their tracks are forgotten.
            elapsed: since the last update, s; None: one step.
        """
        dt = self.time_step if elapsed is None else np.float32(elapsed)
        memory.human_age[is_init], memory.robot_age[is_init] = -1, -1
        known = []
        for seen, visible, tracks, age in (
            (observation.humans, observation.humans_visible, memory.humans, memory.human_age),
            (observation.robots, observation.robots_visible, memory.robots, memory.robot_age),
        ):
            out = np.empty((*seen.shape[:3], len(TRACK_FEATURES)), np.float32)
            alive = np.empty(visible.shape, np.bool_)
            worlds = len(observation.ego)
            _track(
                worlds,
                observation.ego,
                seen,
                visible,
                self.steps,
                dt,
                dt / self.time_step,
                tracks,
                age,
                out,
                alive,
            )
            known += [out, alive]
        return Tracks(observation.ego, *known)


def _no_tracks(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.zeros((*shape, 5), np.float32), np.full(shape, -1.0, np.float32)


@kernel
def _track(chunks, ego, seen, visible, steps, dt, aged, tracks, age, out, alive):
    total = ego.shape[0]
    for chunk in prange(chunks):
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            for i in range(ego.shape[1]):
                _take_in(
                    ego[e, i], seen[e, i], visible[e, i], steps, dt, aged, tracks[e, i], age[e, i]
                )
                _recall(ego[e, i], steps, tracks[e, i], age[e, i], out[e, i], alive[e, i])


@function
def _pose(ego):
    """Return cosine and sine of the robot's heading, and its position in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    x, y = rotate(cos, sin, ego[ORIGIN_X], ego[ORIGIN_Y])  # from the robot to the origin
    return cos, sin, -x, -y


@function
def _take_in(ego, seen, visible, steps, dt, aged, tracks, age):
    """Coast every track [M, 5] (world frame) by `dt` and replace those that are seen.

    `aged` is the same time in steps.
    """
    cos, sin, x, y = _pose(ego)
    for j in range(seen.shape[0]):
        if visible[j]:
            tracks[j, OTHER_X], tracks[j, OTHER_Y] = transform(
                cos, sin, x, y, seen[j, OTHER_X], seen[j, OTHER_Y]
            )
            vx = seen[j, OTHER_VELOCITY_X] + ego[VELOCITY_X]
            vy = seen[j, OTHER_VELOCITY_Y] + ego[VELOCITY_Y]
            tracks[j, OTHER_VELOCITY_X], tracks[j, OTHER_VELOCITY_Y] = rotate(cos, sin, vx, vy)
            tracks[j, OTHER_RADIUS] = seen[j, OTHER_RADIUS]
            age[j] = _ZERO
        elif age[j] >= _ZERO:
            tracks[j, OTHER_X] += tracks[j, OTHER_VELOCITY_X] * dt
            tracks[j, OTHER_Y] += tracks[j, OTHER_VELOCITY_Y] * dt
            age[j] = age[j] + aged if age[j] + aged <= steps else -_ONE


@function
def _recall(ego, steps, tracks, age, out, alive):
    """The tracks seen from the robot."""
    cos, sin, x, y = _pose(ego)
    for j in range(age.shape[0]):
        alive[j] = age[j] >= _ZERO
        if not alive[j]:
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
