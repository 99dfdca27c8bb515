"""Sensors besides the view of people and robots, by the names that scenarios use.

A user's module registers a sensor with `register_sensor`, and commands import that module with
`plugins=[module]`. `Scenario.sensors` turns it on and holds its settings.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from mrsan.plugin_values import PluginError
from mrsan.scenario import Scenario
from mrsan.sensors.registry import SENSORS, RegisteredSensor, sensor_settings
from mrsan.state import Bools, Floats, State

S = TypeVar("S", bound="type[EntitySensor] | type[ValueSensor]")

_RESERVED = (
    "ego",
    "humans",
    "robots",
    "walls",
    "route",
    "lidar",
    "passages",
    "messages",
    "priority",
    "is_init",
)  # other inputs of policies
_RESERVED_ENDINGS = ("_visible", "_known", "_reported")


class EntitySensor(ABC):
    """A sensor of a group of entities, such as wall segments, each with features and a mask."""

    slots: int  # largest number of entities of one robot
    features: int  # numbers per entity, F

    def __init__(self, scenario: Scenario, settings: Any) -> None:
        """Set `slots` and `features`.

        Args:
            scenario: the task. Central critics use a second instance, whose scenario has neither
                noise nor limits of view.
            settings: an instance of the dataclass that the sensor is registered with, or None.
        """
        self.scenario, self.settings = scenario, settings

    @abstractmethod
    def observe(self, state: State, worlds: Bools, features: Floats, mask: Bools) -> None:
        """Write the observations of all robots of some worlds.

        Random numbers must depend only on `state.key` and `state.clock`.

        Args:
            state: of all worlds.
            worlds: [E] the worlds to observe.
            features: [E, N, slots, F], written where `worlds`; zero where the mask is False.
            mask: [E, N, slots], written likewise: what the robot perceives.
        """


class ValueSensor(ABC):
    """A sensor with a fixed number of values, such as the ranges of a lidar."""

    shape: tuple[int, ...]  # of the values of one robot

    def __init__(self, scenario: Scenario, settings: Any) -> None:
        """Set `shape`; the arguments are those of `EntitySensor`."""
        self.scenario, self.settings = scenario, settings

    @abstractmethod
    def observe(self, state: State, worlds: Bools, values: Floats) -> None:
        """Write the observations of all robots of some worlds; see `EntitySensor.observe`.

        Args:
            state: of all worlds.
            worlds: [E] the worlds to observe.
            values: [E, N, *shape], written where `worlds`.
        """


def register_sensor(name: str, settings: type | None = None) -> Callable[[S], S]:
    """Return a decorator that registers an `EntitySensor` or a `ValueSensor`.

    Args:
        name: key in `Scenario.sensors` and in observations, an identifier. A later sensor of the
            same name replaces an earlier one.
        settings: a dataclass of the sensor's settings, each with a default. None: it has none.

    Raises:
        ValueError: the name is not an identifier, or is that of another part of an observation.
        TypeError: the class is not a sensor, or a setting has no default.
    """
    if not name.isidentifier() or name in _RESERVED or name.endswith(_RESERVED_ENDINGS):
        raise ValueError(
            f"the name of a sensor is {name!r}; it must be an identifier other than "
            f"{', '.join(_RESERVED)} that does not end in {', '.join(_RESERVED_ENDINGS)}"
        )
    if settings is not None:
        settings()  # raises TypeError if a setting has no default

    def register(cls: S) -> S:
        if not issubclass(cls, EntitySensor | ValueSensor):
            raise TypeError(f"{cls.__name__} must inherit from EntitySensor or ValueSensor")
        SENSORS[name] = RegisteredSensor(cls, settings)
        return cls

    return register


def make_sensors(scenario: Scenario) -> dict[str, EntitySensor | ValueSensor]:
    """Return the sensors that a scenario adds, by name.

    Raises:
        PluginError: a sensor does not say how many values it has.
    """
    sensors = {}
    for name, values in scenario.sensors.items():
        sensor = SENSORS[name].cls(scenario, sensor_settings(name, values))
        is_group = isinstance(sensor, EntitySensor)
        for field in ("slots", "features") if is_group else ("shape",):
            size = getattr(sensor, field, None)
            numbers = (size,) if is_group else size
            if not isinstance(numbers, tuple) or not all(
                isinstance(number, int | np.integer) and number >= 0 for number in numbers
            ):
                form = "a whole number" if is_group else "a tuple of whole numbers"
                raise PluginError(f"sensor {name} has {field} {size!r}; it must be {form}")
        sensors[name] = sensor
    return sensors
