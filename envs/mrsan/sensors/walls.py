"""Sensors of places with walls: nearest walls, the route, and a lidar."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mrsan.choices import LidarTargets
from mrsan.kernels.lidar import observe_route, observe_walls, scan
from mrsan.kernels.structs import by_reference
from mrsan.scenario import Scenario
from mrsan.se2 import unit_vectors
from mrsan.sensors.sensor import EntitySensor, ValueSensor
from mrsan.state import Bools, Floats, State

WALL_FEATURES = ("start_x", "start_y", "end_x", "end_y")  # in the body frame, m


class NearestWalls(EntitySensor):
    """The walls nearest to a robot, nearest first, as segments with the floor to their right."""

    def __init__(self, scenario: Scenario) -> None:
        """Create the sensor of a scenario."""
        super().__init__(scenario, None)
        self.slots, self.features = scenario.walls_observed, len(WALL_FEATURES)
        self._limit = np.float32(scenario.sensing_range)

    def observe(self, state: State, worlds: Bools, features: Floats, mask: Bools) -> None:
        """Write the segments of all robots; see `EntitySensor.observe`."""
        observe_walls(len(worlds), worlds, state, self._limit, features, mask)


class Route(ValueSensor):
    """Where the route of a robot leads next, in its body frame: a corner or the goal, m."""

    shape = (2,)

    def __init__(self, scenario: Scenario) -> None:
        """Create the sensor of a scenario."""
        super().__init__(scenario, None)

    def observe(self, state: State, worlds: Bools, values: Floats) -> None:
        """Write the next points of all robots; see `ValueSensor.observe`."""
        observe_route(len(worlds), worlds, state, self.scenario.map_known, values)


class LidarParameters(NamedTuple):
    """A lidar in the units of the kernels."""

    range: np.float32
    noise: np.float32
    noise_share: np.float32
    dropout: np.float32
    sees_agents: bool
    robot_radius: np.float32


class Lidar(ValueSensor):
    """The ranges of a lidar, m: rays from right to left, the greatest range where none is hit."""

    def __init__(self, scenario: Scenario, ideal: bool) -> None:
        """Create the sensor of a scenario; an ideal one has neither noise nor dropout."""
        super().__init__(scenario, None)
        s = scenario
        self.shape = (s.lidar_rays,)
        disturbed = 0.0 if ideal else 1.0
        parameters = LidarParameters(
            range=np.float32(s.lidar_range),
            noise=np.float32(disturbed * s.lidar_noise),
            noise_share=np.float32(disturbed * s.lidar_noise_share),
            dropout=np.float32(disturbed * s.lidar_dropout),
            sees_agents=s.lidar_targets is LidarTargets.all,
            robot_radius=np.float32(s.robot_radius),
        )
        self._parameters = by_reference(parameters)
        angles = ray_angles(s.lidar_rays, s.lidar_fov_degrees)
        self._cosines, self._sines = unit_vectors(angles).astype(np.float32).T.copy()

    def observe(self, state: State, worlds: Bools, values: Floats) -> None:
        """Write the ranges of all robots; see `ValueSensor.observe`."""
        scan(len(worlds), worlds, state, self._parameters, self._cosines, self._sines, values)


def ray_angles(rays: int, fov_degrees: float) -> Floats:
    """Return the angles of the rays of a lidar to the heading, [L] rad, from right to left.

    With a full circle the first ray points backwards; otherwise the outer rays are the borders of
    the field of view.
    """
    half = np.radians(fov_degrees) / 2
    full = fov_degrees >= 360.0
    return np.linspace(-half, half, rays, endpoint=not full and rays > 1, dtype=np.float32)


def wall_sensors(scenario: Scenario, privileged: bool) -> dict[str, EntitySensor | ValueSensor]:
    """Return the sensors that a scenario has by its own fields, by name."""
    sensors: dict[str, EntitySensor | ValueSensor] = {}
    if scenario.walls_observed:
        sensors["walls"] = NearestWalls(scenario)
    if scenario.walls_observed or scenario.has_walls:
        sensors["route"] = Route(scenario)
    if scenario.lidar_rays:
        sensors["lidar"] = Lidar(scenario, ideal=privileged)
    return sensors
