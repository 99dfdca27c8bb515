"""What an exported policy says of itself: JSON in the metadata of the ONNX file."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

from mrsan import ConfigurationError, Reward, Scenario
from samarl.planning.shield import Shield

KEY = "samarl"  # of the metadata
FORMAT = 2

# What a robot must know of the scenario that it was trained for; of the others nothing is asked.
ROBOT_FIELDS = (
    "robots",
    "humans",
    "time_step",
    "time_limit",
    "kinematics",
    "robot_radius",
    "robot_speed",
    "max_acceleration",
    "max_turn_rate",
    "min_turning_radius",
    "turn_in_place",
    "fov_degrees",
    "sensing_range",
    "reward",
)


@dataclass
class Description:
    """Everything that the runtime needs besides the network.

    Inputs of the network are the fields of `Tracks`, [1, 1, ...], for a lookahead [C, 1, ...] of C
    predicted outcomes; for other policies also `is_init` [1], whether the memory is cleared,
    `route` [1, 2], where the route leads next in the body frame (m), and the memory.
    Outputs are `action` [1, A] in [-1, 1] and the memory, or `value` [C].
    """

    agent: str  # its name in conf/agent
    opset: int  # of ONNX
    card: dict[str, Any]  # of the policy, see `samarl.policies.checkpoint.PolicyCard`
    scenario: dict[str, Any]  # ROBOT_FIELDS; its robots are the slots for others and one
    shield: dict[str, Any] | None  # numbers of the safety shield; None: nothing checks its actions
    # Of the memory, input `state.NAME` and output `next.NAME`: which axis has a place for every
    # "humans", "robots", or "everybody" (robots first); those are cleared for somebody new.
    slots: dict[str, tuple[str, int]]

    def to_json(self) -> str:
        """The text that is kept in the file."""
        return json.dumps({"format": FORMAT, **dataclasses.asdict(self)})

    @classmethod
    def of_metadata(cls, metadata: dict[str, str], path: Any) -> Description:
        """The description in the metadata of a file.

        Raises:
            ConfigurationError: it has none, or one of another format.
        """
        if KEY not in metadata:
            raise ConfigurationError(f"{path} was not written by samarl-export")
        content = json.loads(metadata[KEY])
        version = content.pop("format")
        if version != FORMAT:
            raise ConfigurationError(f"{path} has format {version!r}; it must be {FORMAT}")
        return cls(**content)

    @property
    def policy(self) -> dict[str, Any]:
        """The numbers of the policy."""
        config: dict[str, Any] = self.card["config"]
        return config

    @property
    def uses_absolute_position(self) -> bool:
        """Whether the origin of the frame means something to it: the middle of the place."""
        round_the_crowd = self.scenario["fov_degrees"] < self.policy["round_below"]
        return bool(self.policy.get("known_origin", True) or round_the_crowd)

    def make_scenario(self) -> Scenario:
        """What the robot knows of its task."""
        return Scenario(**{**self.scenario, "reward": Reward(**self.scenario["reward"])})

    def make_shield(self) -> Shield | None:
        """The shield, if it drives with one."""
        return None if self.shield is None else Shield(**self.shield)


def robot_fields(scenario: Scenario) -> dict[str, Any]:
    """The part of a scenario that is told the robot."""
    values = {name: getattr(scenario, name) for name in ROBOT_FIELDS}
    values["kinematics"] = scenario.kinematics.name
    values["reward"] = dataclasses.asdict(scenario.reward)
    return values
