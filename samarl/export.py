"""Export a trained policy to one ONNX file, which `samarl.runtime` runs on a robot."""

from __future__ import annotations

import io
import json
import os
import warnings
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from mrsan import ConfigurationError, Observation, Scenario
from mrsan.scenario import DEFAULT_NEAREST_WALLS
from samarl.agents import Agent
from samarl.agents.learned import Learned
from samarl.agents.planners.right_of_way import ALL_ENTER, RANDOM, RightOfWay
from samarl.agents.shielded import Shielded
from samarl.files import atomic_write
from samarl.macro_level.network import load_macro_level
from samarl.observations.features import empty_tracks
from samarl.planning.one_step import command_set
from samarl.planning.passage_features import MATE, OWN
from samarl.planning.shield import Shield
from samarl.policies.card import find_policy, read_card
from samarl.policies.lookahead import LookaheadPolicy
from samarl.policies.macro_actions import Waypoints
from samarl.policies.policy import Policy, PolicyState
from samarl.policies.stochastic import StochasticPolicy
from samarl.runtime.description import (
    KEY,
    MACRO_LEVEL_KEY,
    MEMORY,
    NEXT_MEMORY,
    Description,
    robot_fields,
)

TOLERANCE = 1e-4  # largest difference between file and policy, relative to the largest output
OPSET = 18  # the first with a minimum over scattered elements, which CADRL needs


class StepModule(nn.Module):
    """`StochasticPolicy.step` of one robot as a function of its tracks and its memory."""

    def __init__(self, policy: StochasticPolicy, scenario: Scenario, names: list[str]) -> None:
        """Create the module; `names` are those of all inputs, see `Description`."""
        super().__init__()
        self.policy, self.scenario, self.names = policy, scenario, names

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Return the action and the next memory."""
        named: dict[str, Any] = dict(zip(self.names, inputs, strict=True))
        is_init, route = named.pop("is_init"), named.pop("route")
        if self.policy.observes_route:
            named["route"] = route.unsqueeze(1)
        memory = {
            name.removeprefix(MEMORY): named.pop(name).clone()
            for name in self.names
            if name.startswith(MEMORY)
        }
        features = self.policy.extract_features(Observation.from_arrays(named), self.scenario)
        state = _state_of(memory)
        step, state = self.policy.step(features, named["ego"][:, 0], route, is_init, state)
        next_memory = _memory_of(state)
        return step.action, *(next_memory[name] for name in memory)


class ValueModule(nn.Module):
    """`LookaheadPolicy.value` as a function of the tracks of predicted outcomes."""

    def __init__(self, policy: LookaheadPolicy, scenario: Scenario, names: list[str]) -> None:
        """Create the module; `names` are those of all inputs, see `Description`."""
        super().__init__()
        self.policy, self.scenario, self.names = policy, scenario, names

    def forward(self, *inputs: Tensor) -> Tensor:
        """Return the values, [C]."""
        named: dict[str, Any] = dict(zip(self.names, inputs, strict=True))
        tracks = Observation.from_arrays(named)
        rows = torch.zeros(len(inputs[0]), dtype=torch.long)
        return self.policy.value(self.policy.extract_features(tracks, self.scenario), rows)


def export_agent(path: Path, agent: Agent, name: str) -> None:
    """Write a trained agent and everything that the runtime needs to know, atomically.

    Args:
        path: of the file.
        agent: built for the robot, its time step and its sensors; `humans` and `robots` of its
            scenario limit how many people and robots it can know at once.
        name: in `conf/agent/`.

    Raises:
        ConfigurationError: the agent is not a trained one, or cannot be exported.
    """
    shield: Shield | None = None
    if isinstance(agent, Shielded):
        shield, agent = agent.shield, agent.agent
    if isinstance(agent, RightOfWay):
        _export_macro_level(path, agent, shield, name)
        return
    if not isinstance(agent, Learned):
        raise ConfigurationError(
            f"agent is {name}; it must be a trained one, such as samarl_flat: only policies and "
            "macro levels are exported"
        )
    _check_exportable(agent, name)
    policy, scenario = agent.policy, agent.scenario
    if "walls" in policy.sizes.entities and not scenario.walls_observed:
        scenario = replace(scenario, nearest_walls=DEFAULT_NEAREST_WALLS)
    # At least one slot for each kind of agent: the exporter fails on empty tensors.
    scenario = replace(scenario, humans=max(scenario.humans, 1), robots=max(scenario.robots, 2))
    memory: dict[str, Tensor] = {}
    if isinstance(policy, LookaheadPolicy):
        rows = len(command_set(policy.config, scenario.kinematics))
        inputs, outputs = _example_tracks(policy, scenario, rows), ["value"]
        network: nn.Module = ValueModule(policy, scenario, list(inputs))
    else:
        assert isinstance(policy, StochasticPolicy)
        memory = _memory_of(policy.initial_policy_state(1, scenario))
        inputs = _example_tracks(policy, scenario, 1)
        inputs |= {"is_init": torch.ones(1, dtype=torch.bool), "route": torch.ones(1, 2)}
        inputs |= {f"{MEMORY}{name}": tensor for name, tensor in memory.items()}
        outputs = ["action", *(f"{NEXT_MEMORY}{name}" for name in memory)]
        network = StepModule(policy, scenario, list(inputs))
    content = _onnx_bytes(network.eval(), inputs, outputs)
    _check_equivalence(content, network, inputs)
    description = Description(
        name,
        OPSET,
        asdict(agent.card),
        robot_fields(scenario),
        None if shield is None else asdict(shield),
        _slots(policy, scenario, memory),
        policy.observes_route,
    )
    _write(path, content, KEY, description.to_json())


def _export_macro_level(path: Path, agent: RightOfWay, shield: Shield | None, name: str) -> None:
    """Write the macro level of the planner for `samarl.runtime.RightOfWayDriver`.

    Raises:
        ConfigurationError: the planner has none, or has parts that the runtime does not have.
    """
    if agent.macro_level in (None, RANDOM, ALL_ENTER):
        raise ConfigurationError(
            f"agent.macro_level is {agent.macro_level or 'null'}; it must be a trained "
            "macro level to be exported; samarl.runtime.RightOfWayDriver needs no file for the rule"
        )
    if shield is not None:
        raise ConfigurationError("agent.shield is set; it must be false to export a macro level")
    field = "agent.macro_level"
    network = load_macro_level(agent.macro_level, field).eval()
    inputs = {"own": torch.zeros(1, OWN), "mates": torch.zeros(1, 2, MATE)}
    content = _onnx_bytes(network, inputs, ["logits"], {"mates": {1: "team_mates"}})
    for mates in (1, 2, 5):
        _check_equivalence(content, network, inputs | {"mates": torch.zeros(1, mates, MATE)})
    card = asdict(read_card(find_policy(agent.macro_level, field)))
    text = json.dumps({"agent": name, "opset": OPSET, "card": card})
    _write(path, content, MACRO_LEVEL_KEY, text)


def _check_exportable(agent: Learned, name: str) -> None:
    """Refuse agents that need more than one robot knows.

    Raises:
        ConfigurationError: names the setting.
    """
    if agent.waypoints is not Waypoints.learned:
        raise ConfigurationError(
            f"agent.waypoints is {agent.waypoints.name}; it must be learned to be exported"
        )
    if agent.guide is not None:
        raise ConfigurationError(
            f"agent.right_of_way is {agent.right_of_way}; it must be null to be exported"
        )
    if agent.kinematics_mismatch:
        raise ConfigurationError(
            f"scenario.kinematics is {agent.scenario.kinematics.name}; it must be that of the "
            f"robots {name} was trained on to be exported"
        )
    if agent.policy.config.num_parameter_sets != 1:
        raise ConfigurationError(
            f"policy.num_parameter_sets is {agent.policy.config.num_parameter_sets}; it must be 1 "
            "to be exported: a robot alone does not know which of them is its own"
        )


def _memory_of(state: PolicyState) -> dict[str, Tensor]:
    """Return the tensors of a robot's memory by name: of the encoder and of the levels."""
    memory = {name: tensor for name, tensor in state.items() if name not in ("encoder", "noise")}
    return {**state["encoder"][0], **memory}


def _state_of(memory: dict[str, Tensor]) -> PolicyState:
    """Return the policy state of a robot's memory; the encoder and the levels see all of it."""
    return {**memory, "encoder": (memory,), "noise": torch.zeros(())}


def _example_tracks(policy: Policy, scenario: Scenario, rows: int) -> dict[str, Tensor]:
    """Return the tracks of one robot in `rows` worlds by name, everything known and zero."""
    tracks = {
        name: torch.from_numpy(array[:, :1].copy())
        for name, array in empty_tracks(scenario, rows).arrays("known").items()
    }
    observed = policy.sizes.entities.keys() | policy.sizes.sensors.keys() | {"ego"}
    if policy.observes_route:
        observed |= {"route"}
    if policy.observes_messages:
        observed |= {"priority"}
    return {
        name: torch.ones_like(tensor) if tensor.dtype == torch.bool else tensor
        for name, tensor in tracks.items()
        if name.removesuffix("_known") in observed
    }


def _slots(
    policy: Policy, scenario: Scenario, memory: dict[str, Tensor]
) -> dict[str, tuple[str, int]]:
    """Return which axis of each tensor of the memory has a slot for every human or robot.

    It is the axis that grows with their number.
    """
    slots = {}
    if isinstance(policy, StochasticPolicy):
        few, more_robots, more_humans = (
            _memory_of(
                policy.initial_policy_state(
                    1, replace(scenario, robots=robots, humans=humans, humans_min=None)
                )
            )
            for robots, humans in ((2, 1), (3, 1), (2, 2))
        )
        for name in memory:
            for axis, size in enumerate(few[name].shape):
                grows = more_robots[name].shape[axis] > size, more_humans[name].shape[axis] > size
                if any(grows):
                    kinds = {(True, False): "robots", (False, True): "humans"}
                    slots[name] = kinds.get(grows, "everybody"), axis
    return slots


def _onnx_bytes(
    network: nn.Module,
    inputs: dict[str, Tensor],
    outputs: list[str],
    dynamic_axes: dict[str, dict[int, str]] | None = None,
) -> bytes:
    """Return the content of the ONNX file; the dynamic axes of inputs may have any size."""
    file = io.BytesIO()
    # The TorchScript exporter is ten times as fast as that of torch.export for the same graph, and
    # it supports nonzero. It warns about every size that it takes for constant; they are.
    fast_path = torch.backends.mha.get_fastpath_enabled()
    torch.backends.mha.set_fastpath_enabled(False)  # ONNX does not have its kernels
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                network,
                tuple(inputs.values()),
                file,  # type: ignore[arg-type]
                input_names=list(inputs),
                output_names=outputs,
                opset_version=OPSET,
                dynamic_axes=dynamic_axes,
                dynamo=False,
            )
    finally:
        torch.backends.mha.set_fastpath_enabled(fast_path)
    return file.getvalue()


def _check_equivalence(content: bytes, network: nn.Module, inputs: dict[str, Tensor]) -> None:
    """Compare the file with the policy on random tracks: the exporter may translate wrongly.

    Raises:
        ConfigurationError: an output differs.
    """
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    values, random = dict(inputs), torch.Generator().manual_seed(0)
    tracks = [name for name in inputs if name != "is_init" and not name.startswith(MEMORY)]
    for step in range(3):
        for name in tracks:
            drawn = torch.randn(values[name].shape, generator=random)
            values[name] = drawn > 0.0 if values[name].dtype == torch.bool else drawn
        if "is_init" in values:
            values["is_init"] = torch.tensor([step == 0])
        with torch.no_grad():
            expected = network(*values.values())
        expected = expected if isinstance(expected, tuple) else (expected,)
        actual = session.run(None, {i.name: values[i.name].numpy() for i in session.get_inputs()})
        for output, right, array in zip(session.get_outputs(), expected, actual, strict=True):
            error = (right.float() - torch.from_numpy(array).float()).abs().max().item()
            if not error <= TOLERANCE * max(1.0, right.float().abs().max().item()):
                raise ConfigurationError(
                    f"the policy cannot be exported: {output.name} differs by {error:.2g} in "
                    "ONNX, so it has an operation that torch.onnx.export translates wrongly"
                )
            if output.name.startswith(NEXT_MEMORY):
                values[f"{MEMORY}{output.name.removeprefix(NEXT_MEMORY)}"] = right


def _write(path: Path, content: bytes, key: str, description: str) -> None:
    model = onnx.load_model_from_string(content)
    onnx.helper.set_model_props(model, {key: description})
    onnx.checker.check_model(model)
    with atomic_write(path) as part, part.open("wb") as file:
        file.write(model.SerializeToString())
        file.flush()
        os.fsync(file.fileno())
