"""Drive one robot with an exported policy, one decision at a time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import EGO_FEATURES, OTHER_FEATURES, Entities, Observation
from mrsan.observation import parts_of_named
from mrsan.parameters import kernel_parameters
from mrsan.se2 import unrotate
from samarl.observations.route import heading_for_route, next_point, route
from samarl.observations.tracker import Tracker, TrackMemory, Tracks
from samarl.planning.one_step import Commands, command_set, predict_outcomes
from samarl.planning.shield import apply_shield
from samarl.planning.velocity_control import action_to_motion
from samarl.runtime.inputs import (
    Detection,
    InputError,
    OwnState,
    validated,
    validated_sensors,
    validated_walls,
)
from samarl.runtime.network import Network
from samarl.runtime.slots import Slots
from samarl.runtime.walls import KnownMap, faces

_MOST_WALLS = 24  # that the shield takes into account, the nearest ones


class Command(NamedTuple):
    """What the robot should do until the next step, in three equivalent forms."""

    action: NDArray[np.float32]  # [A] in [-1, 1], as in the simulator
    acceleration: float  # along the new heading, m/s^2
    lateral: float  # perpendicular to it, to the left, m/s^2
    heading: float  # after one step, in the frame of `OwnState`, rad in [-pi, pi]
    speed: float  # after one step, m/s
    turn_rate: float  # that reaches the heading in one step, rad/s
    shielded: bool  # the shield replaced the policy's action


class Driver:
    """An exported policy that drives one robot."""

    def __init__(self, network: Network) -> None:
        """Drive with a network; most users call `load`."""
        self._network, self.description = network, network.description
        self.scenario = self.description.make_scenario()
        self._shield = self.description.make_shield()
        self._parameters = kernel_parameters(self.scenario)
        policy = self.description.policy
        if network.looks_ahead:
            sizes = Commands(**{f.name: policy[f.name] for f in fields(Commands)})
            self._commands = command_set(sizes, self.scenario.kinematics)
        track_times = {policy["track_time"]}
        if self._shield:
            track_times.add(self._shield.track_time)
        self._trackers = {
            track_time: Tracker(track_time, self.scenario.time_step)
            for track_time in sorted(track_times)
        }
        self._longest_track_time = max(track_times)
        self.reset()

    @classmethod
    def load(cls, path: str | Path) -> Driver:
        """Load a file that `samarl-export` wrote, ready for the first step.

        Raises:
            ConfigurationError: there is no such file, or it is another kind of file.
        """
        driver = cls(Network(path))
        # One step compiles the kernels, or reads them from disk, before the robot moves.
        zeros: dict[str, NDArray[Any]] = {
            name: np.zeros(shape, dtype) for name, (shape, dtype) in driver.sensor_inputs.items()
        }
        own = OwnState(0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0)
        driver.step(own, [Detection(2, 0, -1, 0)], 0.0, zeros)
        driver.reset()
        return driver

    @property
    def sensor_inputs(self) -> dict[str, tuple[tuple[int, ...], type]]:
        """Return shape and type of every array that `step` needs in `sensors`."""
        return self._network.sensor_inputs

    def reset(self) -> None:
        """Clear all memory: for a new goal, after a pause, or when the frame has moved."""
        s = self.scenario
        self._network.reset()
        self._memories = {
            track_time: TrackMemory(
                *(array[:, :1].copy() for array in tracker.initial(1, s.robots, s.humans))
            )
            for track_time, tracker in self._trackers.items()
        }
        self._slots = {
            "humans": Slots(s.humans, self._longest_track_time),
            "robots": Slots(s.robots - 1, self._longest_track_time),
        }
        self._start_time: float | None = None
        self._last_time = 0.0
        self._origin = 0.0, 0.0  # of the coordinates that the policy observes

    def step(
        self,
        own: OwnState,
        detections: Iterable[Detection],
        time: float,
        sensors: Mapping[str, Any] | None = None,
        walls: Any = (),
    ) -> Command:
        """Decide what to do now.

        Steps may come early or late and detections may be missing: tracks are extrapolated at
        constant velocity over the time that has really passed.

        Args:
            own: the robot and its goal.
            detections: everybody who is visible now, or reported by team-mates; any iterable.
            time: of these measurements, on any clock that does not jump, s.
            sensors: the arrays of a policy with further sensors, see `sensor_inputs`: a sensor's
                values, or the features of a group of entities and, as `GROUP_known`, its mask.
            walls: a `samarl.runtime.KnownMap`, or segments [K, 4] of walls in view (start_x,
                start_y, end_x, end_y), as `walls_of_scan` returns them, in any order and direction.
                The shield, and a policy that observes walls, keep clear of them. The frame is that
                of `OwnState`.

        Raises:
            InputError: names the input that cannot be used; the driver is unchanged.
        """
        own, agents, time = validated(own, detections, time)
        segments = walls.facing(own) if isinstance(walls, KnownMap) else validated_walls(walls)
        readings = validated_sensors(sensors or {}, self.sensor_inputs)
        is_first = self._start_time is None
        if not is_first and time <= self._last_time:
            raise InputError(
                f"time is {time}; it must be later than that of the step before, {self._last_time} "
                "(call reset() to start again)"
            )
        if self._start_time is None:
            self._start_time = self._last_time = time
            if not self.description.uses_absolute_position:
                self._origin = own.x, own.y  # float32 is coarse far away from it
        elapsed, self._last_time = time - self._last_time, time
        observation = self._observation(own, agents, time, readings, segments)
        tracks = {
            track_time: tracker.update(
                observation, self._memories[track_time], np.array([is_first]), elapsed
            )
            for track_time, tracker in self._trackers.items()
        }
        chosen = self._decide(tracks[self.description.policy["track_time"]])
        action = chosen
        if self._shield:
            shield_tracks = tracks[self._shield.track_time]
            action = apply_shield(
                shield_tracks, chosen, self.scenario, self._shield, parameters=self._parameters
            )
        shielded = bool((action != chosen).any())
        return self._command(observation.ego, action, own.heading, shielded)

    def _observation(
        self,
        own: OwnState,
        detections: Sequence[Detection],
        time: float,
        sensors: Mapping[str, NDArray[Any]],
        walls: NDArray[np.float64],
    ) -> Observation:
        """Return the robot's observation as in the simulator, each agent in a slot of its own."""
        s, x, y = self.scenario, own.x - self._origin[0], own.y - self._origin[1]
        cos, sin = math.cos(own.heading), math.sin(own.heading)
        start_time = time if self._start_time is None else self._start_time

        def to_body(dx: float, dy: float) -> tuple[float, float]:
            return unrotate(cos, sin, dx, dy)

        ego = np.empty((1, 1, len(EGO_FEATURES)), np.float32)
        ego[0, 0] = (
            *to_body(own.goal_x - own.x, own.goal_y - own.y),
            *to_body(own.velocity_x, own.velocity_y),
            *to_body(-x, -y),
            cos,
            sin,
            s.robot_radius,
            s.robot_speed,
            min((time - start_time) / s.time_limit, 1.0),
        )
        entities = {}
        for kind, slots in self._slots.items():
            features = np.zeros((1, 1, slots.number, len(OTHER_FEATURES)), np.float32)
            visible = np.zeros((1, 1, slots.number), np.bool_)
            of_kind = [d for d in detections if d.robot == (kind == "robots")]
            assigned, reassigned = slots.assign(of_kind, own.x, own.y, time)
            self._network.clear_slots(kind, reassigned)
            for slot, d in assigned:
                features[0, 0, slot] = (
                    *to_body(d.x - own.x, d.y - own.y),
                    *to_body(d.velocity_x - own.velocity_x, d.velocity_y - own.velocity_y),
                    d.radius,
                )
                visible[0, 0, slot] = True
            entities[kind] = Entities(features, visible)
        _, groups, values = parts_of_named({"ego": None, **sensors}, "known")
        entities |= {name: Entities(*group) for name, group in groups.items()}
        if self._network.walls or len(walls):
            entities["walls"] = self._nearest_walls(own, walls, cos, sin)
        if self.description.observes_route or (own.next_x, own.next_y) != (own.goal_x, own.goal_y):
            assert own.next_x is not None
            assert own.next_y is not None
            next_point = to_body(own.next_x - own.x, own.next_y - own.y)
            values["route"] = np.array([[next_point]], np.float32)
        return Observation(ego, entities, values, {})

    def _nearest_walls(
        self, own: OwnState, walls: NDArray[np.float64], cos: float, sin: float
    ) -> Entities:
        """Return the walls nearest to the robot in its body frame, as the simulator does.

        The robot sees the floor side of segments, which the simulator has on their right.
        """
        starts, ends = walls[:, :2] - (own.x, own.y), walls[:, 2:] - (own.x, own.y)
        along = ends - starts
        squared = np.maximum((along**2).sum(-1), 1e-12)
        share = np.clip(-(starts * along).sum(-1) / squared, 0.0, 1.0)
        distance = np.linalg.norm(starts + share[:, None] * along, axis=-1)
        in_front = faces(walls, own)[:, None]
        starts, ends = np.where(in_front, starts, ends), np.where(in_front, ends, starts)
        slots = self._network.walls or _MOST_WALLS
        nearest = np.argsort(distance, kind="stable")[:slots]
        nearest = nearest[distance[nearest] <= self.scenario.sensing_range]
        features = np.zeros((1, 1, slots, 4), np.float32)
        known = np.zeros((1, 1, slots), np.bool_)
        known[0, 0, : len(nearest)] = True
        for first, points in ((0, starts[nearest]), (2, ends[nearest])):
            x, y = unrotate(cos, sin, points[:, 0], points[:, 1])
            features[0, 0, : len(nearest), first : first + 2] = np.stack([x, y], -1)
        return Entities(features, known)

    def _decide(self, tracks: Tracks) -> NDArray[np.float32]:
        """Return the policy's action, [1, 1, A]."""
        policy = self.description.policy
        target = next_point(tracks)
        if self._network.needs_route:
            below, radius = policy["round_below"], policy["round_radius"]
            target = route(tracks, self.scenario.fov_degrees, below, radius)
        if not self.description.observes_route:
            tracks = tracks._replace(ego=heading_for_route(tracks))
        if not self._network.looks_ahead:
            return self._network.action(tracks, target)
        active = np.ones((1, 1), np.bool_)
        outcomes = predict_outcomes(tracks, active, target, self._commands, self.scenario)
        value = self._network.values(outcomes.tracks) * ~outcomes.ended[:, 0]
        best = (outcomes.reward[:, 0] + np.float32(policy["discount"]) * value).argmax()
        return self._commands[best][None, None].copy()

    def _command(
        self, ego: NDArray[np.float32], action: NDArray[np.float32], heading: float, shielded: bool
    ) -> Command:
        speed, turn, acceleration, lateral = action_to_motion(ego, action, self._parameters)
        new_heading = math.remainder(heading + turn, 2.0 * math.pi)
        turn_rate = turn / self.scenario.time_step
        return Command(action[0, 0], acceleration, lateral, new_heading, speed, turn_rate, shielded)
