"""From who is seen to what to do: one robot, one decision at a time."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import EGO_FEATURES, OTHER_FEATURES, Observation
from mrsan.features import GOAL
from mrsan.parameters import kernel_parameters
from mrsan.se2 import unrotate
from samarl.observations.route import route
from samarl.observations.tracker import Tracker, TrackMemory, Tracks
from samarl.planning.one_step import Commands, command_set, predict_outcomes
from samarl.planning.shield import apply_shield
from samarl.planning.velocity_control import action_to_motion
from samarl.runtime.inputs import Detection, InputError, OwnState, validated
from samarl.runtime.network import Network
from samarl.runtime.slots import Slots


class Command(NamedTuple):
    """What the robot is to do until the next step, in three forms of the same."""

    action: NDArray[np.float32]  # [A] in [-1, 1], as in the simulator
    acceleration: float  # along the heading that it is to turn to, m/s^2
    lateral: float  # across it, to the left, m/s^2
    heading: float  # to be had after one step, in the frame of `OwnState`, rad in [-pi, pi]
    speed: float  # likewise, m/s
    turn_rate: float  # to turn to the heading in one step, rad/s
    shielded: bool  # the shield replaced what the policy wanted


class Driver:
    """An exported policy that drives one robot."""

    def __init__(self, network: Network) -> None:
        """Drive with a loaded network; `load` is what one usually wants."""
        self._network, told = network, network.description
        self.description, self.scenario = told, told.make_scenario()
        self._shield, self._parameters = told.make_shield(), kernel_parameters(self.scenario)
        policy, s = told.policy, self.scenario
        if network.looks_ahead:
            sizes = Commands(**{f.name: policy[f.name] for f in fields(Commands)})
            self._commands = command_set(sizes, s.kinematics)
        times = {policy["track_time"]} | ({self._shield.track_time} if self._shield else set())
        self._trackers = {seconds: Tracker(seconds, s.time_step) for seconds in sorted(times)}
        self._keep = max(times)
        self.reset()

    @classmethod
    def load(cls, path: str | Path) -> Driver:
        """Read a file that `samarl-export` wrote, and make everything ready for the first step.

        Raises:
            ConfigurationError: there is no such file, or it is another kind of file.
        """
        driver = cls(Network(path))
        # Kernels are compiled, or read from the disk, before the robot moves.
        driver.step(OwnState(0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0), [Detection(2, 0, -1, 0)], 0.0)
        driver.reset()
        return driver

    def reset(self) -> None:
        """Forget everything: for a new goal, after a pause, or where the frame has moved."""
        s = self.scenario
        self._network.forget()
        self._memories = {
            number: TrackMemory(
                *(kept[:, :1].copy() for kept in tracker.initial(1, s.robots, s.humans))
            )
            for number, tracker in self._trackers.items()
        }
        self._humans = Slots(s.humans, self._keep)
        self._robots = Slots(s.robots - 1, self._keep)
        self._began: float | None = None  # when
        self._before = 0.0  # when the last step was
        self._origin = 0.0, 0.0  # of what the policy is told

    def step(self, own: OwnState, detections: Iterable[Detection], time: float) -> Command:
        """Decide what to do now.

        Steps may come early or late and detections may be missing: tracks are extrapolated at
        constant velocity over the time that has really passed.

        Args:
            own: the robot and its goal.
            detections: everybody who is visible now, or reported by team-mates; any iterable.
            time: of these measurements, on any clock that does not jump, s.

        Raises:
            InputError: names the input that cannot be used; the driver is unchanged.
        """
        own, people, time = validated(own, detections, time)
        begins = self._began is None
        if not begins and time <= self._before:
            raise InputError(
                f"time is {time}; it must be later than that of the step before, {self._before} "
                "(call reset() to start again)"
            )
        if self._began is None:
            self._began = self._before = time
            if not self.description.uses_absolute_position:
                self._origin = own.x, own.y  # float32 is coarse far away from it
        elapsed, self._before = time - self._before, time
        seen = self._observed(own, people, time)
        known = {
            number: tracker.update(seen, self._memories[number], np.array([begins]), elapsed)
            for number, tracker in self._trackers.items()
        }
        wanted = self._decided(known[self.description.policy["track_time"]])
        action = wanted
        if self._shield:
            tracks = known[self._shield.track_time]
            action = apply_shield(tracks, wanted, self.scenario, self._shield)
        return self._command(seen.ego, action, own.heading, bool((action != wanted).any()))

    def _observed(self, own: OwnState, detections: Sequence[Detection], time: float) -> Observation:
        """What the simulator would have said: everybody in a place of their own, in body frame."""
        s, x, y = self.scenario, own.x - self._origin[0], own.y - self._origin[1]
        cos, sin = math.cos(own.heading), math.sin(own.heading)
        began = time if self._began is None else self._began

        def body(dx: float, dy: float) -> tuple[float, float]:
            return unrotate(cos, sin, dx, dy)

        ego = np.empty((1, 1, len(EGO_FEATURES)), np.float32)
        ego[0, 0] = (
            *body(own.goal_x - own.x, own.goal_y - own.y),
            *body(own.velocity_x, own.velocity_y),
            *body(-x, -y),
            cos,
            sin,
            s.robot_radius,
            s.robot_speed,
            min((time - began) / s.time_limit, 1.0),
        )
        parts: list[NDArray] = []
        for kind, slots in (("humans", self._humans), ("robots", self._robots)):
            rows = np.zeros((1, 1, slots.number, len(OTHER_FEATURES)), np.float32)
            visible = np.zeros((1, 1, slots.number), np.bool_)
            mine = [d for d in detections if d.robot == (kind == "robots")]
            found, new = slots.assign(mine, own.x, own.y, time)
            self._network.forget_those(kind, new)
            for slot, d in found:
                rows[0, 0, slot] = (
                    *body(d.x - own.x, d.y - own.y),
                    *body(d.velocity_x - own.velocity_x, d.velocity_y - own.velocity_y),
                    d.radius,
                )
                visible[0, 0, slot] = True
            parts += [rows, visible]
        nothing = np.zeros((1, 1, 0), np.bool_)  # it is not said who saw whom
        humans, humans_seen, robots, robots_seen = parts
        return Observation(ego, humans, humans_seen, robots, robots_seen, nothing, nothing)

    def _decided(self, tracks: Tracks) -> NDArray[np.float32]:
        """What the policy does, [1, 1, A]."""
        policy = self.description.policy
        aim = tracks.ego[..., GOAL]
        if self._network.needs_route:
            below, radius = policy["round_below"], policy["round_radius"]
            aim = route(tracks.ego, self.scenario.fov_degrees, below, radius)
        if not self._network.looks_ahead:
            return self._network.action(tracks, aim)
        here = np.ones((1, 1), np.bool_)
        outcomes = predict_outcomes(tracks, here, aim, self._commands, self.scenario)
        worth = self._network.values(outcomes.tracks) * ~outcomes.ended[:, 0]
        best = (outcomes.reward[:, 0] + np.float32(policy["discount"]) * worth).argmax()
        return self._commands[best][None, None].copy()

    def _command(
        self, ego: NDArray[np.float32], action: NDArray[np.float32], heading: float, replaced: bool
    ) -> Command:
        s = self.scenario
        speed, turn, acceleration, lateral = action_to_motion(ego, action, self._parameters)
        new = math.remainder(heading + turn, 2.0 * math.pi)
        return Command(
            action[0, 0], acceleration, lateral, new, speed, turn / s.time_step, replaced
        )
