"""One case of `mrsan` whose robots are bodies in MuJoCo.

The people walk as in `mrsan`, which also keeps the record: contacts, arrivals and all statistics
are those of `World.step_along`, so the metrics of both engines are the same functions of the paths.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Kinematics, Observation, Scenario, World
from mrsan.metrics import episodes_of
from samarl.physics.bodies import Bodies
from samarl.physics.drives import drive_of
from samarl.physics.engine import MujocoEngine
from samarl.physics.odometry import Odometry

_STREAM = 0x11DA  # distinguishes the noise of the lidar from other random numbers of the case


class Motion(NamedTuple):
    """What N robots should do until the next decision."""

    speed: NDArray[np.float64]  # [N] at the next decision, m/s
    turn: NDArray[np.float64]  # [N] until then, rad


class _Command(NamedTuple):
    """A motion that is executed from a control period on."""

    period: int  # since the episode began
    speed: NDArray[np.float64]  # [N] one decision later, m/s
    turn_rate: NDArray[np.float64]  # [N] rad/s
    course: NDArray[np.float64]  # [N] direction of the velocity of holonomic robots, rad


class _Walk(NamedTuple):
    """How M people walk during one decision."""

    begin: NDArray[np.float32]  # [M, 2] m
    end: NDArray[np.float32]  # [M, 2] m
    present: NDArray[np.bool_]  # [M]
    radius: NDArray[np.float32]  # [M] m


class PhysicsWorld:
    """A world of `mrsan` with N robots in MuJoCo."""

    def __init__(self, scenario: Scenario, engine: MujocoEngine) -> None:
        """Create the world; `reset` begins an episode.

        Raises:
            ConfigurationError: the engine cannot play the scenario.
        """
        engine.check(scenario)
        self.scenario, self.engine = scenario, engine
        self.world = World(scenario)
        self._drive = drive_of(scenario)
        self._holonomic = scenario.kinematics is Kinematics.holonomic
        self._accelerates = scenario.kinematics is Kinematics.acceleration_heading
        self._periods = engine.control_periods(scenario)
        self._latency = round(engine.latency / engine.control_period(scenario))

    def reset(self, case: int) -> Observation:
        """Begin a case and return the first observation, [1, N, ...]."""
        self.world.reset([case])
        state = self.world.state
        self.bodies = Bodies(self.scenario, self.engine, self._drive, state)
        self._course = state.robot_heading[0].astype(np.float64)
        self._odometry = Odometry(self.engine.odometry_drift, case, self.bodies.position)
        still = np.zeros(self.scenario.robots)
        self._command = _Command(0, still, still, self._course)
        self._set_speed = still  # set points of the speeds, m/s
        self._from_speed = still  # those when the current command began
        self._pending: deque[_Command] = deque()
        self._clock = 0  # control periods since the episode began
        self.tracking_errors: list[float] = []  # m, one for each driving robot and decision
        self.bodies.place_people(
            state.human_position[0], state.human_present[0], state.human_radius[0]
        )
        return self.observe()

    @property
    def heading(self) -> NDArray[np.float64]:
        """Return the headings of the robots, [N] rad; holonomic ones head along their course."""
        return self._course if self._holonomic else self.bodies.yaw

    @property
    def done(self) -> bool:
        """Return whether the episode has ended."""
        return bool(self.world.state.done[0])

    def record(self) -> Episodes:
        """Return the record of the episode, which has ended."""
        return episodes_of(self.world.state, self.scenario, np.ones(1, np.bool_))

    def observe(self) -> Observation:
        """Return what the robots perceive, with the errors of their odometry, [1, N, ...]."""
        self.bodies.update_geometry()
        observation = self.world.observe()
        if "lidar" in observation.sensors:
            self._scan(observation.sensors["lidar"][0])
        if self.engine.odometry_drift:
            self._odometry.disturb(observation)
        return observation

    def _scan(self, ranges: NDArray[np.float32]) -> None:
        """Write the ranges of all lidars [N, L], with the noise of the scenario."""
        s, state = self.scenario, self.world.state
        random = np.random.default_rng([_STREAM, int(state.case[0]), int(state.clock[0])])
        for i, heading in enumerate(self.heading):
            exact = self.bodies.scan(i, float(heading))
            sigma = s.lidar_noise + s.lidar_noise_share * exact
            noisy = np.clip(exact + sigma * random.standard_normal(len(exact)), 0.0, s.lidar_range)
            lost = (random.random(len(exact)) < s.lidar_dropout) | (exact >= s.lidar_range)
            ranges[i] = np.where(lost, s.lidar_range, noisy)

    def step(self, motion: Motion) -> Observation:
        """Give the robots a new motion, move everything until the next decision, and observe.

        The motion takes effect after the latency; until then the robots execute the last one.
        """
        driving = ~self.world.state.arrived[0]
        course = np.remainder(self.heading + motion.turn + np.pi, 2.0 * np.pi) - np.pi
        if self._holonomic:
            self._course = np.where(motion.speed > 0.0, course, self._course)
        target = self._predicted_position(motion, course)
        turn_rate = motion.turn / self.scenario.time_step
        due = self._clock + self._latency
        self._pending.append(_Command(due, motion.speed, turn_rate, course))
        walk = self._people_ahead()
        path = np.empty((1, self.scenario.robots, self._periods, 5))
        for k in range(self._periods):
            share = np.float32((k + 1) / self._periods)
            people = walk.begin + share * (walk.end - walk.begin)
            self.bodies.place_people(people, walk.present, walk.radius)
            self.bodies.drive(self._base_velocities(driving))
            self._clock += 1
            path[0, :, k, :2], path[0, :, k, 2:4] = self.bodies.position, self.bodies.velocity
            path[0, :, k, 4] = self.heading
        self.world.step_along(path)
        errors = np.linalg.norm(self.bodies.position - target, axis=1)[driving]
        self.tracking_errors += errors.tolist()
        self._odometry.update(self.bodies.position)
        return self.observe()

    def _predicted_position(
        self, motion: Motion, course: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where the motion leads in `mrsan` from the current state, [N, 2] m."""
        after = motion.speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=-1)
        before = self.bodies.velocity if self._accelerates else after
        return self.bodies.position + 0.5 * (before + after) * self.scenario.time_step

    def _base_velocities(self, driving: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the set points of the bases for the next control period, [N, 3]."""
        if self._pending and self._pending[0].period <= self._clock:
            self._command, self._from_speed = self._pending.popleft(), self._set_speed
        command, velocities = self._command, np.zeros((len(driving), 3))
        self._set_speed = command.speed
        if self._accelerates:
            share = min((self._clock + 1 - command.period) / self._periods, 1.0)
            self._set_speed = self._from_speed + share * (command.speed - self._from_speed)
        if self._holonomic:
            angle = command.course - self.bodies.yaw
            velocities[:, 0] = self._set_speed * np.cos(angle)
            velocities[:, 1] = self._set_speed * np.sin(angle)
        else:
            velocities[:, 0], velocities[:, 2] = self._set_speed, command.turn_rate
        velocities[~driving] = 0.0
        return velocities

    def _people_ahead(self) -> _Walk:
        """Return how people walk until the next decision.

        In `mrsan` that does not depend on what robots do in the meantime.
        """
        world, state = self.world, self.world.state
        before = world.snapshot()
        still = np.zeros((1, self.scenario.robots, 1, 5))
        still[0, :, 0, :2] = state.robot_position[0]
        world.step_along(still)
        end, radius, present = (
            array[0].copy()
            for array in (state.human_position, state.human_radius, state.human_present)
        )
        step = state.human_velocity[0] * np.float32(self.scenario.time_step)
        world.restore(before)
        return _Walk(end - step, end, present, radius)
