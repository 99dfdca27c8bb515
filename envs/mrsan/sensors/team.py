"""What robots tell each other (`Scenario.team_messages`), over the channel of their reports."""

from __future__ import annotations

from mrsan.kernels.team import share_messages, write_priorities
from mrsan.parameters import kernel_parameters
from mrsan.scenario import Scenario
from mrsan.sensors.sensor import EntitySensor, ValueSensor
from mrsan.state import Bools, Floats, State

MESSAGE_FEATURES = (
    "x",  # of the team-mate in the body frame, m
    "y",
    "velocity_x",  # relative to the robot, m/s
    "velocity_y",
    "priority",  # in [0, 1), drawn per episode
    "through",  # 1: its way to the goal is clear, or it has arrived
    "macro_action",  # the number that it told last
)


class Messages(EntitySensor):
    """The messages of team-mates in range: one slot for each, in the order of their numbers."""

    def __init__(self, scenario: Scenario) -> None:
        """Create the sensor of a scenario."""
        super().__init__(scenario, None)
        self.slots, self.features = scenario.robots - 1, len(MESSAGE_FEATURES)
        self._parameters = kernel_parameters(scenario)

    def observe(self, state: State, worlds: Bools, features: Floats, mask: Bools) -> None:
        """Send this step's messages and write those received; see `EntitySensor.observe`."""
        share_messages(len(worlds), worlds, state, self._parameters, features, mask)


class Priority(ValueSensor):
    """The priority that a robot tells its team-mates."""

    shape = (1,)

    def __init__(self, scenario: Scenario) -> None:
        """Create the sensor of a scenario."""
        super().__init__(scenario, None)

    def observe(self, state: State, worlds: Bools, values: Floats) -> None:
        """Write the priorities of all robots; see `ValueSensor.observe`."""
        write_priorities(len(worlds), worlds, state, values)


def team_sensors(scenario: Scenario) -> dict[str, EntitySensor | ValueSensor]:
    """Return the sensors of messages, by name."""
    if not scenario.team_messages:
        return {}
    return {"messages": Messages(scenario), "priority": Priority(scenario)}
