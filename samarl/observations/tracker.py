"""Tracks of people and robots: those out of view move on at constant velocity, with their age."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import OTHER_FEATURES, Entities, Observation
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
from mrsan.observation import named_arrays, parts_of_named
from mrsan.se2 import rotate, transform, unrotate, untransform

TRACK_FEATURES = (*OTHER_FEATURES, "age")  # age: share of the longest time a track is kept
AGE = 5

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


class Tracks(NamedTuple):
    """What every robot knows: agents it perceives or remembers, and everything else it perceives.

    Arrays of the groups `humans` and `robots` hold `TRACK_FEATURES`; rows without a track are zero.
    """

    ego: NDArray[np.float32]  # [E, N, 11]
    entities: dict[str, Entities]
    sensors: dict[str, NDArray[np.float32]]

    @property
    def humans(self) -> NDArray[np.float32]:
        """Return the tracks of people, [E, N, M, 6]."""
        return self.entities["humans"].features

    @property
    def humans_known(self) -> NDArray[np.bool_]:
        """Return which people are known, [E, N, M]."""
        return self.entities["humans"].mask

    @property
    def robots(self) -> NDArray[np.float32]:
        """Return the tracks of the other robots, [E, N, N - 1, 6]."""
        return self.entities["robots"].features

    @property
    def robots_known(self) -> NDArray[np.bool_]:
        """Return which other robots are known, [E, N, N - 1]."""
        return self.entities["robots"].mask

    @property
    def agents(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays that compiled planners take, see `mrsan.Observation.agents`."""
        return self.ego, *self.entities["humans"], *self.entities["robots"]

    def of(self, robots: NDArray[np.bool_]) -> Tracks:
        """Return what some robots [E, N] know, R of them, as [R, 1, ...]."""
        entities = {
            name: Entities(features[robots][:, None], mask[robots][:, None])
            for name, (features, mask) in self.entities.items()
        }
        sensors = {name: values[robots][:, None] for name, values in self.sensors.items()}
        return Tracks(self.ego[robots][:, None], entities, sensors)

    def named(self) -> dict[str, NDArray[Any]]:
        """Return all arrays by flat names: `ego`, `GROUP`, `GROUP_known`, and the sensors."""
        return {**named_arrays(self.ego, self.entities, "known"), **self.sensors}

    @staticmethod
    def from_named(arrays: Mapping[str, Any]) -> Tracks:
        """Return the tracks whose `named` arrays these are; they may be tensors."""
        ego, groups, sensors = parts_of_named(arrays, "known")
        return Tracks(ego, {name: Entities(*g) for name, g in groups.items()}, sensors)


class TrackMemory(NamedTuple):
    """The tracks of every robot, in the world frame; a robot knows its own pose, so it can."""

    humans: NDArray[np.float32]  # [E, N, M, 5] position, velocity, radius
    human_age: NDArray[np.float32]  # [E, N, M] steps since the last sighting, -1: no track
    robots: NDArray[np.float32]  # [E, N, N - 1, 5]
    robot_age: NDArray[np.float32]  # [E, N, N - 1]


class Tracker:
    """Track the people and robots that each robot has seen.

    Other groups of entities and sensors are passed on as observed.
    """

    def __init__(self, track_time: float, time_step: float) -> None:
        """Keep a track for `track_time` seconds after the last sighting; both arguments in s."""
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
    ) -> Tracks:
        """Update the tracks with an observation and return what is known now.

        Args:
            observation: of all worlds.
            memory: of all worlds, updated in place.
            is_init: [E] the worlds in which an episode begins; their tracks are cleared.
            elapsed: time since the last update, s; None: one step.
        """
        dt = self.time_step if elapsed is None else np.float32(elapsed)
        memory.human_age[is_init], memory.robot_age[is_init] = -1, -1
        entities = dict(observation.entities)
        for name, tracks, age in (
            ("humans", memory.humans, memory.human_age),
            ("robots", memory.robots, memory.robot_age),
        ):
            observed, visible = observation.entities[name]
            features = np.empty((*observed.shape[:3], len(TRACK_FEATURES)), np.float32)
            known = np.empty(visible.shape, np.bool_)
            _track(
                len(observation.ego),
                observation.ego,
                observed,
                visible,
                self.steps,
                dt,
                dt / self.time_step,
                tracks,
                age,
                features,
                known,
            )
            entities[name] = Entities(features, known)
        return Tracks(observation.ego, entities, observation.sensors)


def _no_tracks(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    return np.zeros((*shape, 5), np.float32), np.full(shape, -1.0, np.float32)


@kernel
def _track(first, last, ego, observed, visible, steps, dt, dt_steps, tracks, age, out, known):
    for e in range(first, last):
        for i in range(ego.shape[1]):
            _update_tracks(
                ego[e, i],
                observed[e, i],
                visible[e, i],
                steps,
                dt,
                dt_steps,
                tracks[e, i],
                age[e, i],
            )
            _write_tracks(ego[e, i], steps, tracks[e, i], age[e, i], out[e, i], known[e, i])


@function
def _pose(ego):
    """Return cosine and sine of the robot's heading, and its position in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    x, y = rotate(cos, sin, ego[ORIGIN_X], ego[ORIGIN_Y])  # from the robot to the origin
    return cos, sin, -x, -y


@function
def _update_tracks(ego, observed, visible, steps, dt, dt_steps, tracks, age):
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
            age[j] = age[j] + dt_steps if age[j] + dt_steps <= steps else -_ONE


@function
def _write_tracks(ego, steps, tracks, age, out, known):
    """Write the tracks in the body frame of the robot."""
    cos, sin, x, y = _pose(ego)
    for j in range(age.shape[0]):
        known[j] = age[j] >= _ZERO
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
