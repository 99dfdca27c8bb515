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
from samarl.policies.policy import Policy
from samarl.runtime.description import KEY, Description, robot_fields

SAME = 1e-4  # a file may differ by so much from the policy, of the largest number
OPSET = 18  # the first with the smallest of scattered elements, which CADRL's minimum becomes


class Driving(nn.Module):
    """A policy with a memory: what is known and remembered to what to do and to remember."""

    def __init__(self, policy: Policy, scenario: Scenario, memory: dict[str, Tensor]) -> None:
        """For a robot that knows of so many others."""
        super().__init__()
        self.policy, self.scenario, self.names = policy, scenario, list(memory)

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """See `Description`: tracks, `begins`, `aim`, the memory."""
        tracks, begins, aim = Tracks(*given[:5]), given[5], given[6]  # type: ignore[arg-type]
        memory = {name: kept.clone() for name, kept in zip(self.names, given[7:], strict=True)}
        frames = frames_of(tracks, self.scenario, self.policy.config.known_origin)
        mean = self.policy.drive_alone(frames, given[0][:, 0], aim, begins, memory)
        return mean.clamp(-1.0, 1.0), *memory.values()


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
    if policy.config.actors != 1:
        raise ConfigurationError(
            f"policy.actors is {policy.config.actors}; it must be 1 to be exported: a robot alone "
            "does not know which of them it is"
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
        memory = policy.memory_alone(others, humans)
        network = Driving(policy, scenario, memory)
        inputs = _tracks(1, others, humans)
        inputs |= {"begins": torch.ones(1, dtype=torch.bool), "aim": torch.ones(1, 2)}
        inputs |= {f"state.{name}": kept for name, kept in memory.items()}
        outputs = ["action", *(f"next.{name}" for name in memory)]
    content = _traced(network.eval(), inputs, outputs)
    _check_same(content, network, inputs)
    description = Description(
        name, OPSET, asdict(agent.card), robot_fields(scenario),
        None if shield is None else asdict(shield), _slots(policy, others, humans, memory),
    )  # fmt: skip
    _write(path, content, description)


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
    if memory:
        one_robot = policy.memory_alone(robots + 1, humans)
        one_human = policy.memory_alone(robots, humans + 1)
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
                network, tuple(inputs.values()), into, input_names=list(inputs),  # type: ignore[arg-type]
                output_names=outputs, opset_version=OPSET, dynamo=False,
            )  # fmt: skip
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
        if "begins" in given:
            given["begins"] = torch.tensor([step == 0])
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
