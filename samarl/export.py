"""From a trained policy to one ONNX file that `samarl.runtime` drives with."""

from __future__ import annotations

import io
import os
import warnings
from dataclasses import asdict, replace
from pathlib import Path

import onnx
import onnxruntime
import torch
from torch import Tensor, nn

from mrsan import EGO_FEATURES, ConfigurationError, Scenario
from samarl.agents import Agent
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.files import atomic_write
from samarl.observations.features import frames_of
from samarl.observations.tracker import TRACK_FEATURES, Tracks
from samarl.planning.one_step import command_set
from samarl.planning.shield import Shield
from samarl.planning.track_predictor import CONSTANT_VELOCITY
from samarl.policies.hierarchical import Waypoints
from samarl.policies.lookahead import LookaheadPolicy
from samarl.policies.policy import Policy, PolicyState
from samarl.policies.stochastic import StochasticPolicy
from samarl.runtime.description import KEY, Description, robot_fields

SAME = 1e-4  # a file may differ by so much from the policy, of the largest number
OPSET = 18  # the first with the smallest of scattered elements, which CADRL's minimum becomes


class Driving(nn.Module):
    """`StochasticPolicy.step` of one robot, from its tracks and memory."""

    def __init__(
        self, policy: StochasticPolicy, scenario: Scenario, memory: dict[str, Tensor]
    ) -> None:
        """Prepare a policy for a robot that knows as many others as `scenario` has."""
        super().__init__()
        self.policy, self.scenario, self.names = policy, scenario, list(memory)

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """See `Description`: tracks, `is_init`, `route`, the memory."""
        tracks, is_init, route = Tracks(*inputs[:5]), inputs[5], inputs[6]  # type: ignore[arg-type]
        features = frames_of(tracks, self.scenario, self.policy.config.known_origin)
        memory = dict(zip(self.names, (tensor.clone() for tensor in inputs[7:]), strict=True))
        pose = inputs[0][:, 0]
        step, state = self.policy.step(features, pose, route, is_init, _state_of(memory))
        following = _memory_of(state)
        return step.action, *(following[name] for name in self.names)


class Valuing(nn.Module):
    """What predicted outcomes are worth to a policy that looks ahead."""

    def __init__(self, policy: LookaheadPolicy, scenario: Scenario) -> None:
        """For a robot that knows of so many others."""
        super().__init__()
        self.policy, self.scenario = policy, scenario

    def forward(self, *given: Tensor) -> Tensor:
        """See `Description`: tracks."""
        frames = frames_of(Tracks(*given), self.scenario, self.policy.config.known_origin)  # type: ignore[arg-type]
        return self.policy.value(frames, torch.zeros(len(given[0]), dtype=torch.long))


def export_agent(path: Path, agent: Agent, name: str) -> None:
    """Write a trained agent and all that the runtime must know, whole or not at all.

    Args:
        path: of the file.
        agent: built for the robot, its clock and its view; `humans` and `robots` of its scenario
            say of how many people and robots it can know at once.
        name: in `conf/agent/`.

    Raises:
        ConfigurationError: it is not trained, or cannot be exported.
    """
    shield: Shield | None = None
    if isinstance(agent, Shielded):
        shield, agent = agent.shield, agent.agent
    if not isinstance(agent, Learned):
        raise ConfigurationError(
            f"agent is {name}; it must be a trained one, such as samarl_flat: only policies are "
            "exported"
        )
    if agent.waypoints is not Waypoints.learned:
        raise ConfigurationError(
            f"agent.waypoints is {agent.waypoints.name}; it must be learned to be exported"
        )
    if shield is not None and shield.predictor != CONSTANT_VELOCITY:
        raise ConfigurationError(
            f"agent.shield.predictor is {shield.predictor}; it must be {CONSTANT_VELOCITY} "
            "to be exported"
        )
    policy, scenario = agent.policy, agent.scenario
    if agent.kinematics_mismatch:
        raise ConfigurationError(
            f"scenario.kinematics is {scenario.kinematics.name}; it must be that of the robots "
            f"{name} was trained on to be exported"
        )
    if policy.config.num_parameter_sets != 1:
        raise ConfigurationError(
            f"policy.num_parameter_sets is {policy.config.num_parameter_sets}; it must be 1 to be "
            "exported: a robot alone does not know which of them is its own"
        )
    # One place of each kind at least: no network is made for none.
    scenario = replace(scenario, humans=max(scenario.humans, 1), robots=max(scenario.robots, 2))
    others, humans = scenario.robots - 1, scenario.humans
    memory: dict[str, Tensor] = {}
    if isinstance(policy, LookaheadPolicy):
        rows = len(command_set(policy.config, scenario.kinematics))
        network: nn.Module = Valuing(policy, scenario)
        inputs, outputs = _tracks(rows, others, humans), ["value"]
    else:
        assert isinstance(policy, StochasticPolicy)
        memory = _memory_of(policy.initial_policy_state(1, scenario.robots, humans))
        network = Driving(policy, scenario, memory)
        inputs = _tracks(1, others, humans)
        inputs |= {"is_init": torch.ones(1, dtype=torch.bool), "route": torch.ones(1, 2)}
        inputs |= {f"state.{name}": kept for name, kept in memory.items()}
        outputs = ["action", *(f"next.{name}" for name in memory)]
    content = _traced(network.eval(), inputs, outputs)
    _check_same(content, network, inputs)
    description = Description(
        name,
        OPSET,
        asdict(agent.card),
        robot_fields(scenario),
        None if shield is None else asdict(shield),
        _slots(policy, others, humans, memory),
    )
    _write(path, content, description)


def _memory_of(state: PolicyState) -> dict[str, Tensor]:
    """Return what a robot remembers, by name: of the encoder and of the levels."""
    memory = {name: tensor for name, tensor in state.items() if name not in ("encoder", "noise")}
    return {**state["encoder"][0], **memory}


def _state_of(memory: dict[str, Tensor]) -> PolicyState:
    """Return the policy state of a robot; every tensor is at hand for all parts of the policy."""
    return {**memory, "encoder": (memory,), "noise": torch.zeros(())}


def _tracks(rows: int, robots: int, humans: int) -> dict[str, Tensor]:
    """Tracks, as inputs."""
    own = torch.zeros(rows, 1, len(EGO_FEATURES))

    def of(number: int) -> tuple[Tensor, Tensor]:
        known = torch.ones(rows, 1, number, dtype=torch.bool)
        return torch.zeros(rows, 1, number, len(TRACK_FEATURES)), known

    tracks = Tracks(own, *of(humans), *of(robots))  # type: ignore[arg-type]
    return tracks._asdict()


def _slots(
    policy: Policy, robots: int, humans: int, memory: dict[str, Tensor]
) -> dict[str, tuple[str, int]]:
    """Which axis of the memory has a place for every human or robot: that which grows by one."""
    found = {}
    if isinstance(policy, StochasticPolicy):
        one_robot = _memory_of(policy.initial_policy_state(1, robots + 2, humans))
        one_human = _memory_of(policy.initial_policy_state(1, robots + 1, humans + 1))
        for name, kept in memory.items():
            for axis, size in enumerate(kept.shape):
                grows = one_robot[name].shape[axis] > size, one_human[name].shape[axis] > size
                if any(grows):
                    kinds = {(True, False): "robots", (False, True): "humans"}
                    found[name] = kinds.get(grows, "everybody"), axis
    return found


def _traced(network: nn.Module, inputs: dict[str, Tensor], outputs: list[str]) -> bytes:
    """The ONNX file."""
    into = io.BytesIO()
    # The exporter of torch.jit: ten times as fast as that of torch.export for the same graph, and
    # it knows nonzero elements. It warns of every size that it takes for constant; they are.
    fast = torch.backends.mha.get_fastpath_enabled()
    torch.backends.mha.set_fastpath_enabled(False)  # kernels that ONNX does not have
    try:
        with warnings.catch_warnings(), torch.no_grad():
            warnings.simplefilter("ignore")
            torch.onnx.export(
                network,
                tuple(inputs.values()),
                into,
                input_names=list(inputs),  # type: ignore[arg-type]
                output_names=outputs,
                opset_version=OPSET,
                dynamo=False,
            )
    finally:
        torch.backends.mha.set_fastpath_enabled(fast)
    return into.getvalue()


def _check_same(content: bytes, network: nn.Module, inputs: dict[str, Tensor]) -> None:
    """Compare the file with the policy among random people: the exporter knows not everything."""
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    given, random = dict(inputs), torch.Generator().manual_seed(0)
    for step in range(3):
        for name in Tracks._fields:
            drawn = torch.randn(given[name].shape, generator=random)
            given[name] = drawn > 0.0 if given[name].dtype == torch.bool else drawn
        if "is_init" in given:
            given["is_init"] = torch.tensor([step == 0])
        fed = {put.name: given[put.name].numpy() for put in session.get_inputs()}
        with torch.no_grad():
            right = network(*given.values())
        right = right if isinstance(right, tuple) else (right,)
        for put, mine, found in zip(
            session.get_outputs(), right, session.run(None, fed), strict=True
        ):
            wrong = (mine.float() - torch.from_numpy(found).float()).abs().max().item()
            if not wrong <= SAME * max(1.0, mine.float().abs().max().item()):
                raise ConfigurationError(
                    f"the policy cannot be exported: {put.name} differs by {wrong:.2g} in ONNX, "
                    "so it has an operation that torch.onnx.export translates wrongly"
                )
            if put.name.startswith("next."):
                given[f"state.{put.name.removeprefix('next.')}"] = mine


def _write(path: Path, content: bytes, description: Description) -> None:
    model = onnx.load_model_from_string(content)
    onnx.helper.set_model_props(model, {KEY: description.to_json()})
    onnx.checker.check_model(model)
    with atomic_write(path) as part, part.open("wb") as file:
        file.write(model.SerializeToString())
        file.flush()
        os.fsync(file.fileno())
