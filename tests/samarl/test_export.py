"""An exported policy drives as the policy does."""

import copy
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from mrsan import ConfigurationError, Observation, Scenario, World
from mrsan.parameters import kernel_parameters
from mrsan.place_shapes import polygons_of
from samarl.agents import Agent, build_agent
from samarl.agents.learned import Learned
from samarl.agents.shielded import Shielded
from samarl.configuration import load_agent_config
from samarl.encoders import ENCODERS
from samarl.export import export_agent
from samarl.planning.shield import Shield
from samarl.planning.velocity_control import action_to_motion
from samarl.policies.checkpoint import save_policy
from samarl.policies.flat import FlatPolicy
from samarl.policies.policy import Policy
from samarl.runtime import Command, Driver, KnownMap
from samarl.runtime.network import Network
from samarl.runtime.simulation import as_seen, sensor_readings, walls_in_view
from tests import learning

SAME = 1e-4


def agent_of(policy: Policy, name: str, folder: Path, scenario: Scenario) -> Agent:
    save_policy(folder / "policy.safetensors", policy, name, {})
    return Learned(scenario, str(folder / "policy.safetensors"))


def team_of(network: Network, robots: int) -> list[Driver]:
    """A driver for each robot, in the frame of the world; the network is read once."""
    team = [Driver(copy.copy(network)) for _ in range(robots)]
    for driver in team:
        driver.reset(centre=(0.0, 0.0))
    return team


def decide(drivers: list[Driver], observation: Observation, time: float) -> list[Command]:
    return [driver.step(*as_seen(observation, robot), time) for robot, driver in enumerate(drivers)]


def different(
    commands: list[Command], action: np.ndarray, observation: Observation, scenario: Scenario
) -> list[int]:
    """The robots that would move otherwise; at full speed all ways to push on are the same."""
    robots = []
    for robot, command in enumerate(commands):
        motion, right = (
            action_to_motion(
                observation.ego[:, robot : robot + 1], one[None, None], kernel_parameters(scenario)
            )
            for one in (command.action, action[0, robot])
        )
        if np.abs(command.action - action[0, robot]).max() > SAME and not np.allclose(
            motion[:2], right[:2], atol=SAME
        ):
            robots.append(robot)
    return robots


def remembered(agent: Agent) -> list[np.ndarray]:
    """What an agent does from now on, added to as it acts."""
    done: list[np.ndarray] = []
    act = agent.act

    def remember(observation: Observation) -> np.ndarray:
        done.append(act(observation))
        return done[-1]

    agent.act = remember  # type: ignore[method-assign]
    return done


@pytest.mark.parametrize("name", ["samarl_waypoints", "cadrl"])
def test_a_thousand_decisions_are_those_of_the_policy(name: str, tmp_path: Path) -> None:
    """With the shield and without, in the same scenes, from what a robot itself could say."""
    scenario = Scenario()
    agent = build_agent({**load_agent_config(name), "shield": True}, scenario)
    assert isinstance(agent, Shielded)
    export_agent(tmp_path / "policy.onnx", agent, name)
    networks = [Network(tmp_path / "policy.onnx"), Network(tmp_path / "policy.onnx")]
    networks[1].description = dataclasses.replace(networks[1].description, shield=None)
    teams = [team_of(network, scenario.robots) for network in networks]
    unchecked = remembered(agent.agent)
    world = World(scenario, 1)
    observation, begins, step, case, replaced, decisions = world.reset([0]), True, 0, 0, 0, 0
    while decisions < 1000:
        if begins:
            agent.reset(np.ones(1, np.bool_))
            for driver in (*teams[0], *teams[1]):
                driver.reset(centre=(0.0, 0.0))
        actions = [agent.act(observation), unchecked[-1]]
        time = 7.0 + step * scenario.time_step
        driven, free = (decide(team, observation, time) for team in teams)
        for commands, action in ((driven, actions[0]), (free, actions[1])):
            assert different(commands, action, observation, scenario) == []
            if name != "cadrl":
                command_actions = np.stack([command.action for command in commands])
                np.testing.assert_allclose(command_actions, action[0], atol=SAME)
        replaced += sum(command.shielded for command in driven)
        driving = ~world.state.arrived[0] & ~world.state.terminated[0]
        after = world.step(actions[0])
        decisions, step, observation = decisions + scenario.robots, step + 1, after.observation
        state = world.state
        for robot in np.flatnonzero(driving & ~state.arrived[0]):
            speed = np.hypot(*state.robot_velocity[0, robot])
            turned = driven[robot].heading - state.robot_heading[0, robot]
            if not (after.terminated | after.truncated)[0]:
                assert driven[robot].speed == pytest.approx(speed, abs=SAME)
                # Braked to a stop it may turn on the spot or not: rounding decides, here and there.
                assert abs(np.sin(turned)) < SAME or speed < SAME
        begins = bool((after.terminated | after.truncated)[0])
        if begins:
            case, step = case + 1, 0
            observation = world.reset([case])
    assert 0 < replaced < decisions / 5


PAIRS = [("flat", name) for name in ENCODERS] + [
    ("hierarchical", "gru"),
    ("hierarchical", "spatio_temporal"),
    ("lookahead", "pairwise"),
    ("lookahead", "social_attention"),
    ("squashed", "temporal_spatial_graph"),
]


@pytest.mark.parametrize(("policy", "encoder"), PAIRS)
def test_every_policy_and_every_encoder_is_exported(
    policy: str, encoder: str, tmp_path: Path
) -> None:
    """At a narrow view: people are remembered, and the route leads round the crowd."""
    scenario = Scenario(humans=4, robots=2, fov_degrees=120.0)
    if policy == "lookahead":
        model = learning.make_policy(policy, policy_config(policy, encoder), 3)
    else:
        model = learning.policy(policy, encoder, gain=100.0, stop_speed=0.3)
    agent = agent_of(model, policy, tmp_path, scenario)
    export_agent(tmp_path / "policy.onnx", agent, "mine")
    team = team_of(Network(tmp_path / "policy.onnx"), 2)
    world = World(scenario, 1)
    observation, seen = world.reset([3]), set()
    for step in range(25):
        if world.state.done.all():
            break
        action = agent.act(observation)
        commands = decide(team, observation, step * scenario.time_step)
        assert different(commands, action, observation, scenario) == []
        seen |= {tuple(command.action.round(4)) for command in commands}
        observation = world.step(action).observation
    assert len(seen) > 1  # it does not do the same whatever it sees


PLACE = Scenario(layout="doorway", humans=4, robots=2, lidar_rays=24, time_limit=20.0)


@pytest.mark.parametrize(
    ("policy", "encoder", "observes_walls"),
    [
        ("flat", "set_pool", True),
        ("hierarchical", "set_pool", True),
        ("hierarchical", "spatio_temporal", True),
        ("flat", "set_pool", False),  # heads for the next corner instead of the goal
    ],
)
def test_walls_are_observed_on_a_robot_as_in_the_simulator(
    policy: str, encoder: str, observes_walls: bool, tmp_path: Path
) -> None:
    """With the shield, which keeps clear of walls. One robot has a map, the other sees walls."""
    place = PLACE if observes_walls else None
    trained = learning.policy(policy, encoder, 100.0, place)
    agent = Shielded(PLACE, agent_of(trained, policy, tmp_path, PLACE), Shield(track_time=2.0))
    export_agent(tmp_path / "policy.onnx", agent, "mine")
    team = team_of(Network(tmp_path / "policy.onnx"), 2)
    assert set(team[0].sensor_inputs) == ({"lidar"} if observes_walls else set())
    world = World(PLACE, 1)
    shielded = decisions = 0
    for case in range(6):
        observation = world.reset([case])
        agent.reset(np.ones(1, np.bool_))
        for driver in team:
            driver.reset(centre=(0.0, 0.0))
        known = KnownMap(polygons_of(world.state, 0))
        for step in range(20):
            action = agent.act(observation)
            commands = []
            for robot, driver in enumerate(team):
                own, people = as_seen(observation, robot)
                walls = known if robot == 0 else walls_in_view(observation, own, robot)
                lidar = sensor_readings(observation, robot) if observes_walls else None
                commands.append(driver.step(own, people, 0.25 * step, lidar, walls))
            assert different(commands, action, observation, PLACE) == []
            shielded += sum(command.shielded for command in commands)
            decisions += 2
            observation = world.step(action).observation
            if world.state.done.all():
                break
    assert 0 < shielded < decisions


def policy_config(name: str, encoder: str) -> dict[str, object]:
    numbers = learning.policy_numbers(name, encoder)
    return {key: value for key, value in numbers.items() if key != "name"}


def test_a_wrong_translation_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the exporter takes for constant differs among other people."""
    right = FlatPolicy.step

    def frozen(self, features, *rest):
        step, state = right(self, features, *rest)
        return step._replace(action=step.action + float(features.ego[0, 0, 0])), state

    monkeypatch.setattr(FlatPolicy, "step", frozen)
    agent = agent_of(learning.policy("flat"), "flat", tmp_path, Scenario())
    with pytest.raises(ConfigurationError, match=r"action .*\d"):
        export_agent(tmp_path / "p.onnx", agent, "mine")
    assert not (tmp_path / "p.onnx").exists()
