"""What robots perceive: people and robots in view, and the sensors that `Scenario.sensors` adds."""

from mrsan.sensors.sensor import EntitySensor, ValueSensor, register_sensor

__all__ = ["EntitySensor", "ValueSensor", "register_sensor"]
