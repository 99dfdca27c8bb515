"""What moves the robots of an evaluation: the equations of `mrsan`, or MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass, fields
from importlib.util import find_spec

from mrsan import ConfigurationError, Kinematics, Scenario
from mrsan.fields import check_numbers, number

_PACKAGES = ("mujoco", "onnx", "onnxruntime")  # policies are exported
_ROUNDING = 1e-9  # of the number of control periods in a duration


@dataclass
class MrsanEngine:
    """Robots move as `mrsan.kernels.kinematics` says; there is nothing to set."""

    def check(self, scenario: Scenario) -> None:
        """Accept every scenario."""

    def changes(self) -> list[str]:
        """Return the overrides that select this engine: none, it is the default."""
        return []


@dataclass
class MujocoEngine:
    """Robots are bodies with wheels in MuJoCo; docs/physics.md describes the model."""

    latency: float = number(
        0.0, 0.0, 0.2, unit="s", help="time from a measurement until its command takes effect"
    )
    odometry_drift: float = number(
        0.0,
        0.0,
        0.5,
        help="standard deviation of a robot's errors per metre driven: share of the distance, "
        "and rad of heading",
    )
    control_rate: float = number(
        100.0, 20.0, 1000.0, unit="Hz", help="rate at which wheels receive new set points"
    )
    physics_step: float = number(
        0.005, 1e-4, 0.01, unit="s", help="longest time step of the physics engine"
    )
    mass: float = number(20.0, 1.0, 1000.0, unit="kg", help="mass of a robot")
    motor_torque: float = number(
        6.0, 0.01, 1000.0, unit="N m", help="greatest torque of the motor of a wheel"
    )
    friction: float = number(
        0.8, 0.001, 5.0, help="friction coefficient of the wheels on the floor"
    )

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: a number is out of range.
        """
        check_numbers(self, "engine")

    def check(self, scenario: Scenario) -> None:
        """Check that this engine is installed and that it can play a scenario.

        Raises:
            ConfigurationError: names the missing packages or the setting.
        """
        missing = [name for name in _PACKAGES if find_spec(name) is None]
        if missing:
            raise ConfigurationError(
                f"engine is mujoco, which needs {', '.join(missing)}; it must be mrsan, or "
                "installed by pip install 'samarl[physics]'"
            )
        if scenario.arena_radius is not None:
            raise ConfigurationError(
                f"scenario.arena_radius is {scenario.arena_radius}; it must be null with "
                "engine=mujoco, which has no round walls"
            )
        holonomic = scenario.kinematics is Kinematics.holonomic
        if holonomic and scenario.fov_degrees < 360.0:
            raise ConfigurationError(
                f"scenario.fov_degrees is {scenario.fov_degrees}; it must be 360 with "
                "engine=mujoco and holonomic robots, which do not turn to look ahead"
            )
        periods = self.latency / self.control_period(scenario)
        if abs(periods - round(periods)) > _ROUNDING:
            raise ConfigurationError(
                f"engine.latency is {self.latency}; it must be a multiple of the control period, "
                f"{self.control_period(scenario):g} s"
            )

    def control_periods(self, scenario: Scenario) -> int:
        """Return the number of control periods between two decisions."""
        return max(1, round(scenario.time_step * self.control_rate))

    def control_period(self, scenario: Scenario) -> float:
        """Return the time between two set points, s: a decision has a whole number of them."""
        return scenario.time_step / self.control_periods(scenario)

    def changes(self) -> list[str]:
        """Return the overrides that select this engine and its settings."""
        default = MujocoEngine()
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        changed = [k for k, value in values.items() if value != getattr(default, k)]
        return ["engine=mujoco", *(f"engine.{k}={values[k]}" for k in changed)]


Engine = MrsanEngine | MujocoEngine
ENGINES: dict[str, type[Engine]] = {"mrsan": MrsanEngine, "mujoco": MujocoEngine}
