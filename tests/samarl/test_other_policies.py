"""Policies of other simulators: files, features, values, memory, and evaluations."""

import math
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

import samarl
from mrsan import ConfigurationError, Entities, Kinematics, Observation, Scenario
from mrsan.se2 import unrotate_vectors

FOLDER = Path(__file__).parents[2] / "examples/other_policies"
with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(str(FOLDER))
    crowdnav = import_module("crowdnav")

ALONE = Scenario(robots=1, humans=3)
NETWORKS = {
    "crowdnav_sarl": crowdnav.SARLNetwork,
    "crowdnav_cadrl": crowdnav.CADRLNetwork,
}
# Weights [out, in] of the linear layers of the published files; each has a bias [out] as well.
LAYERS: dict[str, dict[str, tuple[int, int]]] = {
    "crowdnav_sarl": {
        "mlp1.0": (150, 13),
        "mlp1.2": (100, 150),
        "mlp2.0": (100, 100),
        "mlp2.2": (50, 100),
        "attention.0": (100, 200),
        "attention.2": (100, 100),
        "attention.4": (1, 100),
        "mlp3.0": (150, 56),
        "mlp3.2": (100, 150),
        "mlp3.4": (100, 100),
        "mlp3.6": (1, 100),
    },
    "crowdnav_cadrl": {
        "value_network.0": (150, 13),
        "value_network.2": (100, 150),
        "value_network.4": (100, 100),
        "value_network.6": (1, 100),
    },
}


def published_shapes(name: str) -> dict[str, tuple[int, ...]]:
    shapes: dict[str, tuple[int, ...]] = {}
    for layer, (outputs, inputs) in LAYERS[name].items():
        shapes |= {f"{layer}.weight": (outputs, inputs), f"{layer}.bias": (outputs,)}
    return shapes


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Files with random weights of the published names and shapes."""
    folder, generator = tmp_path_factory.mktemp("weights"), torch.Generator().manual_seed(0)
    paths = {name: str(folder / f"{name}.pt") for name in NETWORKS}
    for name, path in paths.items():
        shapes = published_shapes(name)
        weights = {k: 0.05 * torch.randn(s, generator=generator) for k, s in shapes.items()}
        torch.save(weights, path)
    return paths


def load(name: str, files: dict[str, str], scenario: Scenario = ALONE, **fields: Any) -> Any:
    return samarl.load_agent(FOLDER / f"agent/{name}.yaml", scenario, file=files[name], **fields)


def observe(
    heading: float,
    people: list[list[float]],
    position: tuple[float, float] = (1.0, 2.0),
    goal: tuple[float, float] = (1.0, 5.0),
    velocity: tuple[float, float] = (0.0, 0.5),
) -> Observation:
    """One robot among people [x, y, vx, vy], all in the axes of the map; the last is not seen."""
    axes = np.array([math.cos(heading), math.sin(heading)])
    here, moves = np.array(position), np.array(velocity)
    ego = np.zeros((1, 1, 11), np.float32)
    ego[0, 0, 0:2] = unrotate_vectors(np.array(goal) - here, axes)
    ego[0, 0, 2:4] = unrotate_vectors(moves, axes)
    ego[0, 0, 4:6] = unrotate_vectors(-here, axes)
    ego[0, 0, 6:8], ego[0, 0, 8], ego[0, 0, 9] = axes, 0.3, 1.0
    rows = np.array(people)
    features = np.full((1, 1, len(people), 5), 0.3, np.float32)
    features[0, 0, :, 0:2] = unrotate_vectors(rows[:, 0:2] - here, axes)
    features[0, 0, :, 2:4] = unrotate_vectors(rows[:, 2:4] - moves, axes)
    visible = np.ones((1, 1, len(people)), np.bool_)
    visible[..., -1] = False
    nobody = Entities(np.zeros((1, 1, 0, 5), np.float32), np.zeros((1, 1, 0), np.bool_))
    return Observation(ego, {"humans": Entities(features, visible), "robots": nobody}, {}, {})


UNSEEN = [1.0, 2.1, 0.0, 0.0]


def test_a_joint_state_is_relative_to_the_goal() -> None:
    """The goal is 3 m to the left; the person is 2 m towards it and 1 m to its left."""
    others = crowdnav.Others(
        torch.tensor([[-1.0, 2.0]]),
        torch.tensor([[0.0, -1.0]]),
        torch.tensor([0.4]),
        torch.tensor([True]),
    )
    goal, velocity = torch.tensor([0.0, 3.0]), torch.tensor([0.0, 0.5])
    heading, radius = torch.tensor(math.pi / 2 + 0.2), torch.tensor(0.3)
    state = crowdnav.joint_state(goal, velocity, heading, radius, 1.0, others)
    expected = [3, 1, 0.2, 0.3, 0.5, 0, 2, 1, -1, 0, 0.4, math.sqrt(5), 0.7]
    torch.testing.assert_close(state, torch.tensor([expected]))
    holonomic = crowdnav.joint_state(goal, velocity, None, radius, 1.0, others)
    assert holonomic[0, 2] == 0.0


def closeness(network: nn.Module) -> None:
    """Let CADRL's value be minus the distance to the goal."""
    for parameter in network.parameters():
        nn.init.zeros_(parameter)
    for layer in list(network.value_network)[::2]:
        layer.weight[0, 0] = 1.0
    network.value_network[-1].weight[0, 0] = -1.0


@torch.no_grad()
def test_the_lookahead_chooses_the_best_velocity(files: dict[str, str]) -> None:
    agent = load("crowdnav_cadrl", files)
    closeness(agent.network)
    far = observe(0.0, [[-5.0, 2.0, 0.0, 0.0], UNSEEN])
    torch.testing.assert_close(agent.velocity(far), torch.tensor([[0.0, 1.0]]))  # to the goal
    # A person stands 0.8 m ahead, so surfaces are 0.2 m apart. At full speed they touch.
    scene = observe(0.0, [[1.0, 2.8, 0.0, 0.0], UNSEEN])
    goal, radius = torch.tensor([[0.0, 3.0]]), torch.tensor([0.3])
    others = crowdnav.others_of(scene)
    velocity, value = agent.candidates(goal, radius, others)
    assert value.shape == (1, 81)
    speed = (math.exp(0.8) - 1) / (math.e - 1)  # the fourth of five
    discount = 0.9**0.25
    expected = {
        0: -discount * 3.0,
        4: -0.5 * 0.25 * speed * 0.25 - discount * (3.0 - 0.25 * speed),
        5: -0.25 - discount * 2.75,
    }
    for command, number in expected.items():
        assert value[0, command].item() == pytest.approx(number, abs=1e-5)
    assert value.argmax() == 4
    torch.testing.assert_close(velocity[0, 4], torch.tensor([0.0, speed]), atol=1e-6, rtol=0)
    torch.testing.assert_close(agent.velocity(scene), velocity[:, 4])


@torch.no_grad()
def test_sarl_pools_whom_it_sees() -> None:
    torch.manual_seed(0)
    network = crowdnav.SARLNetwork()
    state, visible = torch.randn(3, 13), torch.tensor([True, True, False])
    state[:, :6] = state[0, :6]
    embedded = network.mlp1(state[:2])
    score = network.attention(torch.cat([embedded, embedded.mean(0).expand(2, -1)], -1))
    share = score.exp() / score.exp().sum()
    crowd = (share * network.mlp2(embedded)).sum(0)
    expected = network.mlp3(torch.cat([state[0, :6], crowd])).squeeze()
    torch.testing.assert_close(network(state, visible), expected)


class Exploit:
    """Its pickle would create a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.path),)


def test_wrong_files_are_refused_in_one_line(files: dict[str, str], tmp_path: Path) -> None:
    weights = torch.load(files["crowdnav_sarl"], weights_only=True)
    occupancy_map = weights | {"mlp1.0.weight": torch.zeros(150, 61)}
    incomplete = {k: v for k, v in weights.items() if k != "attention.4.bias"}
    cases = {
        "om.pth": (occupancy_map, r"mlp1\.0\.weight has the shape \(150, 61\); .* \(150, 13\)"),
        "cut.pth": (incomplete, r"attention\.4\.bias is missing"),
        "more.pth": (weights | {"extra": torch.zeros(1)}, "extra is not an entry of SARLNetwork"),
        "code.pth": (Exploit(tmp_path / "executed"), "state_dict"),
        "list.pth": ([1, 2], "state_dict"),
    }
    for name, (content, message) in cases.items():
        torch.save(content, tmp_path / name)
        with pytest.raises(ConfigurationError, match=rf"^agent\.file is .*{name}.*{message}") as e:
            load("crowdnav_sarl", {"crowdnav_sarl": str(tmp_path / name)})
        assert "\n" not in str(e.value)
    assert not (tmp_path / "executed").exists()
    (tmp_path / "text.pth").write_text("not weights")
    for name, message in (("text.pth", "state_dict"), ("none.pth", "No such file")):
        with pytest.raises(ConfigurationError, match=message):
            load("crowdnav_sarl", {"crowdnav_sarl": str(tmp_path / name)})


@pytest.mark.parametrize("name", NETWORKS)
def test_an_evaluation_runs(name: str, files: dict[str, str]) -> None:
    scenario = Scenario(robots=2, humans=3, time_limit=2.0)
    agent = load(name, files, scenario)
    assert agent.scope_warning() is None
    assert samarl.evaluate(agent, cases=2).row["method"] == name
    larger = Scenario(robots=1, humans=0, robot_radius=0.4, time_step=0.2, time_limit=1.0)
    message = r"time_step is 0\.2 instead of 0\.25 and scenario\.robot_radius is 0\.4"
    with pytest.warns(UserWarning, match=message):
        samarl.evaluate(load(name, files, larger), cases=2)


@pytest.mark.parametrize("kinematics", Kinematics)
def test_with_nobody_in_view_it_drives_to_the_goal(
    kinematics: Kinematics, files: dict[str, str]
) -> None:
    alone = Scenario(robots=1, humans=0, kinematics=kinematics)
    assert samarl.evaluate(load("crowdnav_sarl", files, alone), cases=4).success.all()
