"""The registered sensors, and the checks of their settings."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from mrsan.fields import ConfigurationError, check_numbers


@dataclass(frozen=True)
class RegisteredSensor:
    """A sensor class and the dataclass of its settings."""

    cls: type
    settings: type | None


SENSORS: dict[str, RegisteredSensor] = {}


def check_sensors(sensors: Any) -> None:
    """Check the names and the settings of the sensors of a scenario.

    Raises:
        ConfigurationError: there is no such sensor, or a setting is unknown or out of range.
    """
    if not isinstance(sensors, dict):
        raise ConfigurationError(
            f"scenario.sensors is {sensors!r}; it must map names of sensors to their settings"
        )
    for name, values in sensors.items():
        sensor_settings(name, values)


def sensor_settings(name: Any, values: Any) -> Any:
    """Return the checked settings of a sensor; None if it has none."""
    if name not in SENSORS:
        known = f"one of {', '.join(SENSORS)} or " if SENSORS else ""
        raise ConfigurationError(
            f"scenario.sensors has {name!r}; it must be {known}registered in this process: import "
            "its module, in commands by plugins=[module]"
        )
    schema, values = SENSORS[name].settings, {} if values is None else values
    if not isinstance(values, dict):
        raise ConfigurationError(
            f"scenario.sensors.{name} is {values!r}; it must be a mapping from names to values"
        )
    names = [] if schema is None else [f.name for f in fields(schema)]
    for key in values:
        if key not in names:
            permitted = f"have only {', '.join(names)}" if names else "be empty"
            raise ConfigurationError(f"scenario.sensors.{name} has {key!r}; it must {permitted}")
    if schema is None:
        return None
    settings = schema(**values)
    check_numbers(settings, f"scenario.sensors.{name}")
    return settings
