"""The description of an exported policy: JSON in the metadata of the ONNX file."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from typing import Any

from mrsan import ConfigurationError, Reward, Scenario
from samarl.planning.shield import Shield

KEY = "samarl"  # of the metadata
MACRO_LEVEL_KEY = "samarl.macro_level"  # of those of a macro level: JSON, `agent`, `opset`, `card`
FORMAT = 4
MEMORY, NEXT_MEMORY = "state.", "next."  # prefixes of inputs and outputs

# The fields of the scenario that a robot needs.
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
    "nearest_walls",
    "lidar_rays",
    "lidar_range",
    "lidar_fov_degrees",
    "reward",
)


@dataclass
class Description:
    """Everything that the runtime needs besides the network.

    Inputs of the network are `Observation.arrays("known")`, [1, 1, ...], but for `route`. With
    lookahead they are those of C predicted outcomes, [C, 1, ...], and the output is `value` [C].
    Other policies also have the inputs `is_init` [1], whether the memory is cleared, `route`
    [1, 2], where the route leads next in the body frame (m), and `state.NAME`, the memory. Their
    outputs are `action` [1, A] in [-1, 1] and `next.NAME`, the memory after the step.
    """

    agent: str  # its name in conf/agent
    opset: int  # of ONNX
    card: dict[str, Any]  # of the policy, see `samarl.policies.checkpoint.PolicyCard`
    scenario: dict[str, Any]  # ROBOT_FIELDS; `robots` includes the robot itself
    shield: dict[str, Any] | None  # settings of the safety shield; None: without one
    # Of each tensor of the memory: which axis has a slot for every one of "humans", "robots" or
    # "everybody" (robots first). A slot is cleared when it is assigned to somebody else.
    slots: dict[str, tuple[str, int]]
    observes_route: bool = False  # the policy was trained with routes round walls

    def to_json(self) -> str:
        """Return the text that the file stores."""
        return json.dumps({"format": FORMAT, **dataclasses.asdict(self)})

    @classmethod
    def of_metadata(cls, metadata: dict[str, str]) -> Description:
        """Return the description in the metadata of a file.

        Raises:
            ConfigurationError: it has none, or one of another format.
        """
        if MACRO_LEVEL_KEY in metadata:
            raise ConfigurationError("it is a macro level, for RightOfWayDriver")
        if KEY not in metadata:
            raise ConfigurationError("it was not written by samarl-export")
        content = json.loads(metadata[KEY])
        version = content.pop("format")
        if version != FORMAT:
            raise ConfigurationError(f"its format is {version!r}; it must be {FORMAT}")
        return cls(**content)

    @property
    def policy(self) -> dict[str, Any]:
        """Return the configuration of the policy."""
        config: dict[str, Any] = self.card["config"]
        return config

    @property
    def uses_absolute_position(self) -> bool:
        """Return whether the policy takes the origin of the frame for the centre of the area."""
        drives_round = self.scenario["fov_degrees"] < self.policy["perimeter_below_fov"]
        return bool(self.policy.get("observe_map_position", True) or drives_round)

    def make_scenario(self) -> Scenario:
        """Return the scenario as far as the robot knows it."""
        return Scenario(**{**self.scenario, "reward": Reward(**self.scenario["reward"])})

    def make_shield(self) -> Shield | None:
        """Return the shield, if there is one."""
        return None if self.shield is None else Shield(**self.shield)


def robot_fields(scenario: Scenario) -> dict[str, Any]:
    """Return the fields of a scenario that a robot needs."""
    values = {name: getattr(scenario, name) for name in ROBOT_FIELDS}
    values["nearest_walls"] = scenario.walls_observed
    values["kinematics"] = scenario.kinematics.name
    values["reward"] = dataclasses.asdict(scenario.reward)
    return values
