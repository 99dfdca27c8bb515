"""Drive one robot with an exported policy, one decision at a time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import ConfigurationError, Entities, Observation, Scenario
from mrsan.features import GOAL
from mrsan.parameters import Parameters, kernel_parameters
from mrsan.se2 import unrotate
from samarl.observations.route import heading_for_route, next_point, route
from samarl.planning.one_step import Commands, command_set, predict_outcomes
from samarl.planning.velocity_control import action_to_motion, stop_fully
from samarl.runtime.agents import AgentTracks
from samarl.runtime.inputs import (
    Detection,
    InputError,
    OwnState,
    validated,
    validated_centre,
    validated_sensors,
    validated_walls,
)
from samarl.runtime.network import Network
from samarl.runtime.robot_shield import RobotShield, ShieldReason
from samarl.runtime.walls import KnownMap, seen_from


class Command(NamedTuple):
    """What the robot should do until the next step, in three equivalent forms."""

    action: NDArray[np.float32]  # [A] in [-1, 1], as in the simulator
    acceleration: float  # along the new heading, m/s^2
    lateral: float  # perpendicular to it, to the left, m/s^2
    heading: float  # after one step, in the frame of `OwnState`, rad in [-pi, pi]
    speed: float  # after one step, m/s
    turn_rate: float  # that reaches the heading in one step, rad/s
    shielded: bool  # the shield replaced the policy's action
    reason: ShieldReason | None = None  # what that would not have kept clear of


class Driver:
    """An exported policy that drives one robot."""

    def __init__(self, network: Network) -> None:
        """Drive with a network; most users call `load`."""
        self._network, self.description = network, network.description
        self.scenario = self.description.make_scenario()
        self._observes_walls = network.walls > 0 or network.looks_ahead
        self._parameters = kernel_parameters(self.scenario)
        shield = self.description.make_shield()
        self._shield = shield and RobotShield(shield, self.scenario)
        policy = self.description.policy
        if network.looks_ahead:
            sizes = Commands(**{f.name: policy[f.name] for f in fields(Commands)})
            self._commands = command_set(sizes, self.scenario.kinematics)
        self.reset()

    @classmethod
    def load(cls, path: str | Path) -> Driver:
        """Load a file that `samarl-export` wrote, ready for the first step.

        Raises:
            ConfigurationError: there is no such file, or it is damaged or another kind of file.
        """
        try:
            driver = cls(Network(path))
            # One step compiles the kernels, or reads them from disk, before the robot moves.
            zeros: dict[str, NDArray[Any]] = {
                name: np.zeros(shape, dtype)
                for name, (shape, dtype) in driver.sensor_inputs.items()
            }
            own = OwnState(0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0)
            driver.step(own, [Detection(2, 0, -1, 0)], 0.0, zeros)
            driver.reset()
        except Exception as error:  # a damaged file may lead to any
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ConfigurationError(f"{path} cannot be used: {reason:.300}") from error
        return driver

    @property
    def avoids_walls(self) -> bool:
        """Return whether the policy or its shield avoids walls; otherwise `step` refuses them."""
        return self._observes_walls or self._shield is not None

    @property
    def sensor_inputs(self) -> dict[str, tuple[tuple[int, ...], type]]:
        """Return shape and type of every array that `step` needs in `sensors`."""
        return self._network.sensor_inputs

    def reset(self, centre: tuple[float, float] | None = None) -> None:
        """Clear all memory: for a new goal, after a pause, or when the frame has moved.

        Args:
            centre: of the area that people cross, in the frame of `OwnState`, m. Some policies
                observe where they are from there (`samarl_waypoints`, `cadrl`). None: half way
                between the robot and its goal at the first step.

        Raises:
            InputError: the centre is not two finite numbers.
        """
        s = self.scenario
        self._centre = None if centre is None else validated_centre(centre)
        self._network.reset()
        track_time = self.description.policy["track_time"]
        self._agents = AgentTracks(s.humans, s.robots - 1, track_time, s.time_step)
        if self._shield:
            self._shield.reset()
        self._start_time: float | None = None
        self._last_time = 0.0

    def step(
        self,
        own: OwnState,
        detections: Iterable[Detection],
        time: float,
        sensors: Mapping[str, Any] | None = None,
        walls: Any = (),
        obstacles: Any = (),
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
            obstacles: segments [K, 4] that are not on the map, such as those of a scan. The shield
                keeps clear of them.

        Raises:
            InputError: names the input that cannot be used; the driver is unchanged.
        """
        own, agents, time = validated(own, detections, time)
        is_map = isinstance(walls, KnownMap)
        segments = walls.walls if is_map else validated_walls("walls", walls)
        observed = walls.facing(own) if is_map else segments
        all_walls = {"walls": segments, "obstacles": validated_walls("obstacles", obstacles)}
        for name, array in all_walls.items():
            is_avoided = self.avoids_walls if name == "walls" else self._shield is not None
            if len(array) and not is_avoided:
                raise InputError(
                    f"{name} has {len(array)} segments; it must be empty, because this policy was "
                    "exported without the shield and would not avoid them"
                )
        readings = validated_sensors(sensors or {}, self.sensor_inputs)
        if self._start_time is not None and time <= self._last_time:
            raise InputError(
                f"time is {time}; it must be later than that of the step before, {self._last_time} "
                "(call reset() to start again)"
            )
        if self._start_time is None:
            self._start_time = self._last_time = time
            self._centre = self._policy_centre(own)
        elapsed, self._last_time = time - self._last_time, time
        observation = self._observation(own, agents, time, readings, observed)
        action = chosen = self._decide(self._agents.update(observation, elapsed))
        reason = None
        if self._shield:
            action, reason = self._shield.check(
                chosen, observation, own, agents, list(all_walls.values()), time, elapsed
            )
        return command_for(action, observation.ego, own.heading, self._parameters, reason)

    def _policy_centre(self, own: OwnState) -> tuple[float, float]:
        """Return where the policy takes the origin to be, m in the frame of the first step."""
        if not self.description.uses_absolute_position:
            return own.x, own.y  # any place nearby: single precision is coarse far away from it
        if self._centre is not None:
            return self._centre
        return (own.x + own.goal_x) / 2.0, (own.y + own.goal_y) / 2.0

    def _observation(
        self,
        own: OwnState,
        detections: Sequence[Detection],
        time: float,
        sensors: Mapping[str, NDArray[Any]],
        walls: NDArray[np.float64],
    ) -> Observation:
        """Return the robot's observation as in the simulator, each agent in a slot of its own."""
        assert self._centre is not None
        assert self._start_time is not None
        time_share = min((time - self._start_time) / self.scenario.time_limit, 1.0)
        ego = ego_features(own, self._centre, self.scenario, time_share)[None, None]
        entities, reassigned = self._agents.observe(own, detections, time)
        for kind, slots in reassigned.items():
            self._network.clear_slots(kind, slots)
        further = Observation.from_arrays({"ego": ego, **sensors})
        entities, values = entities | further.entities, further.sensors
        if self._observes_walls:
            entities["walls"] = self._nearest_walls(own, walls)
        if self.description.observes_route or (own.next_x, own.next_y) != (own.goal_x, own.goal_y):
            assert own.next_x is not None
            assert own.next_y is not None
            cos, sin = math.cos(own.heading), math.sin(own.heading)
            next_point = unrotate(cos, sin, own.next_x - own.x, own.next_y - own.y)
            values["route"] = np.array([[next_point]], np.float32)
        return Observation(ego, entities, values)

    def _nearest_walls(self, own: OwnState, walls: NDArray[np.float64]) -> Entities:
        """Return the walls nearest to the robot in its body frame, as the simulator does."""
        near = seen_from(own, walls, self.scenario.sensing_range).segments
        slots = self._network.walls or len(near)
        features = np.zeros((1, 1, slots, 4), np.float32)
        features[0, 0, : len(near)] = near[:slots]
        return Entities(features, np.arange(slots)[None, None] < len(near))

    def _decide(self, tracks: Observation) -> NDArray[np.float32]:
        """Return the policy's action, [1, 1, A]."""
        policy = self.description.policy
        target = next_point(tracks)
        if self._network.needs_route:
            below, radius = policy["perimeter_below_fov"], policy["round_radius"]
            fov = self.scenario.fov_degrees
            target = route(tracks, fov, _is_among_walls(tracks), below, radius)
        if not self.description.observes_route:
            tracks = tracks._replace(ego=heading_for_route(tracks))
        if not self._network.looks_ahead:
            action = self._network.action(tracks, target)
            return stop_fully(action, tracks.ego, policy.get("stop_speed", 0.0), self.scenario)
        active = np.ones((1, 1), np.bool_)
        outcomes = predict_outcomes(tracks, active, target, self._commands, self.scenario)
        value = self._network.values(outcomes.tracks) * ~outcomes.ended[:, 0]
        best = (outcomes.reward[:, 0] + np.float32(policy["discount"]) * value).argmax()
        return self._commands[best][None, None].copy()


def ego_features(
    own: OwnState, centre: tuple[float, float], scenario: Scenario, time_share: float
) -> NDArray[np.float32]:
    """Return what a robot observes of itself [11], see `mrsan.EGO_FEATURES`.

    Args:
        own: the robot.
        centre: of the area that it takes for the origin, m.
        scenario: its radius and speed.
        time_share: the share of the time limit that has passed.
    """
    cos, sin = math.cos(own.heading), math.sin(own.heading)
    features = (
        *unrotate(cos, sin, own.goal_x - own.x, own.goal_y - own.y),
        *unrotate(cos, sin, own.velocity_x, own.velocity_y),
        *unrotate(cos, sin, centre[0] - own.x, centre[1] - own.y),
        cos,
        sin,
        scenario.robot_radius,
        scenario.robot_speed,
        time_share,
    )
    return np.array(features, np.float32)


def command_for(
    action: NDArray[np.float32],
    ego: NDArray[np.float32],
    heading: float,
    parameters: Parameters,
    reason: ShieldReason | None = None,
) -> Command:
    """Return the command of an action [1, 1, A] of a robot [1, 1, 11] with this heading, rad."""
    speed, turn, acceleration, lateral = action_to_motion(ego, action, parameters)
    return Command(
        action[0, 0],
        acceleration,
        lateral,
        math.remainder(heading + turn, 2.0 * math.pi),
        speed,
        turn / float(parameters.time_step),
        reason is not None,
        reason,
    )


def _is_among_walls(tracks: Observation) -> bool:
    """Return whether the robot sees a wall, or its route has a corner before the goal."""
    walls = tracks.entities.get("walls")
    if walls is not None and walls.mask.any():
        return True
    return bool((next_point(tracks) != tracks.ego[..., GOAL]).any())
