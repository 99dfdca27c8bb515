"""All sensors of the robots of a scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mrsan.choices import TeamPerception
from mrsan.features import EGO_FEATURES, OTHER_FEATURES
from mrsan.kernels.sensing import observe
from mrsan.kernels.structs import by_reference
from mrsan.kernels.team import share_tracks
from mrsan.kernels.walled import observe_past_walls
from mrsan.observation import Entities, Observation
from mrsan.parameters import SensorParameters, kernel_parameters
from mrsan.plugin_values import PluginError, check_finite
from mrsan.scenario import Scenario
from mrsan.sensors.passages import NextPassages
from mrsan.sensors.sensor import EntitySensor, make_sensors
from mrsan.sensors.team import team_sensors
from mrsan.sensors.walls import wall_sensors
from mrsan.state import Bools, Floats, State


class SensorSuite:
    """Observe the people and robots in view, and whatever `Scenario.sensors` adds."""

    def __init__(self, scenario: Scenario, privileged: bool = False) -> None:
        """Create the sensors.

        Args:
            scenario: the task.
            privileged: observe without limits or noise, for central critics.
        """
        self.scenario = _without_limits(scenario) if privileged else scenario
        self._parameters = kernel_parameters(self.scenario)
        self._view = by_reference(SensorParameters.of(self._parameters))
        walls_occlude = self.scenario.has_walls and self.scenario.walls_occlude
        self._observe = observe_past_walls() if walls_occlude else observe
        self._sensors = (
            wall_sensors(self.scenario, privileged)
            | team_sensors(self.scenario)
            | make_sensors(self.scenario)
        )
        self._passages = NextPassages(self.scenario) if self.scenario.next_passages else None

    def empty(self, worlds: int) -> Observation:
        """Allocate the observation of E worlds."""
        s, others = self.scenario, len(OTHER_FEATURES)
        slots = {"humans": (s.humans, others), "robots": (s.robots - 1, others)}
        sensors = {}
        for name, sensor in self._sensors.items():
            if isinstance(sensor, EntitySensor):
                slots[name] = sensor.slots, sensor.features
            else:
                sensors[name] = self._room(name, worlds, *sensor.shape)
        if self._passages is not None:
            slots["passages"] = self._passages.slots, self._passages.features
        entities = {
            name: Entities(
                self._room(name, worlds, number, features),
                np.zeros((worlds, s.robots, number), np.bool_),
            )
            for name, (number, features) in slots.items()
        }
        reported = {}
        if s.team_tracks:
            for name in ("humans", "robots"):
                reported[name] = np.empty(entities[name].mask.shape, np.bool_)
        ego = np.empty((worlds, s.robots, len(EGO_FEATURES)), np.float32)
        return Observation(ego, entities, sensors, reported)

    def _room(self, name: str, worlds: int, *shape: int) -> Floats:
        """Return room for values of all robots; NaN for a registered sensor, which may forget some.

        `observe` then finds those that it did not write.
        """
        room = np.empty((worlds, self.scenario.robots, *shape), np.float32)
        if name in self.scenario.sensors:
            room.fill(np.nan)
        return room

    def observe(self, state: State, worlds: Bools, observation: Observation) -> None:
        """Write the observations of some worlds [E]."""
        chunks = len(worlds)  # of the loop over worlds
        self._observe(chunks, worlds, state, self._view, *observation.agents)
        if self.scenario.team_tracks:
            share_tracks(
                chunks,
                worlds,
                state,
                self._parameters,
                *observation.entities["humans"],
                *observation.entities["robots"],
                observation.reported["humans"],
                observation.reported["robots"],
            )
        for name, sensor in self._sensors.items():
            arrays: tuple[Any, ...] = observation.entities.get(name) or (observation.sensors[name],)
            if name not in self.scenario.sensors:
                sensor.observe(state, worlds, *arrays)
                continue
            try:
                sensor.observe(state, worlds, *arrays)
            except (IndexError, ValueError) as error:  # of NumPy, for other shapes
                raise PluginError(
                    f"sensor {name}, whose values have shape {arrays[0].shape}, raised "
                    f"{type(error).__name__}: {error}"
                ) from error
            check_finite(f"sensor {name}", arrays[0], state, worlds)
        if self._passages is not None:
            self._passages.observe(state, worlds, observation)


def _without_limits(scenario: Scenario) -> Scenario:
    """Return the same scenario with a perfect view."""
    return replace(
        scenario,
        fov_degrees=360.0,
        sensing_range=1000.0,
        occlusion=False,
        walls_occlude=False,
        position_noise=0.0,
        velocity_noise=0.0,
        radius_noise=0.0,
        missed_detection=0.0,
        team_perception=TeamPerception.none,
        team_range=10000.0,
        team_loss=0.0,
    )
