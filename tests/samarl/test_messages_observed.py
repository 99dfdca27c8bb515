"""What a policy observes of messages, against the numbers that the simulator sends."""

from dataclasses import replace
from pathlib import Path

import learning
import numpy as np
import pytest
from numpy.testing import assert_allclose

from mrsan import Scenario, World
from mrsan.sensors.team import MESSAGE_FEATURES
from samarl import load_agent
from samarl.export import export_agent
from samarl.observations.features import LENGTH_SCALE
from samarl.policies.checkpoint import save_policy
from samarl.runtime.network import Network
from samarl.training.curriculum import CurriculumStage

TELLING = Scenario(layout="doorway", robots=4, humans=4, team_messages=True)
SILENT = replace(TELLING, team_messages=False)


@pytest.fixture(scope="module")
def policy():  # type: ignore[no-untyped-def]
    return learning.policy("flat", "set_pool", scenario=TELLING)


def decide(policy, scenario: Scenario, case: int = 3):  # type: ignore[no-untyped-def]
    world = World(scenario, 1)
    observation = world.reset(np.array([case]))
    state = policy.initial_state(1, scenario)
    return observation, policy.act(observation, state, np.ones(1, np.bool_), scenario)


def test_it_observes_who_tells_what_and_its_own_priority(policy) -> None:  # type: ignore[no-untyped-def]
    observation, decision = decide(policy, TELLING)
    told, received = observation.entities["messages"]
    own = decision.features.ego[:, 0, -1]
    assert_allclose(own, observation.sensors["priority"][0, :, 0])
    messages = decision.features.entities["messages"]
    assert received.any()
    for robot, slot in np.argwhere(received[0]):
        number = dict(zip(MESSAGE_FEATURES, told[0, robot, slot].tolist(), strict=True))
        place = [number["x"] / LENGTH_SCALE, number["y"] / LENGTH_SCALE]
        rest = ("velocity_x", "velocity_y", "priority", "through")
        expected = [*place, *(number[name] for name in rest)]
        assert_allclose(messages.features[robot, 0, slot], expected, rtol=1e-6)
    assert (messages.mask[:, 0].numpy() == received[0]).all()


def test_where_robots_are_silent_it_is_told_nothing(policy) -> None:  # type: ignore[no-untyped-def]
    for scenario in (SILENT, Scenario(robots=3), Scenario(robots=1)):
        _, decision = decide(policy, scenario)
        assert not decision.features.entities["messages"].mask.any()
        assert not decision.features.ego[:, 0, -1].any()


def test_what_is_told_changes_what_it_does(policy) -> None:  # type: ignore[no-untyped-def]
    actions = [decide(policy, scenario)[1].action for scenario in (TELLING, SILENT)]
    assert not np.array_equal(*actions)


def test_messages_are_for_the_guide_where_there_is_one() -> None:
    for guide, is_told in ((None, True), ("right_of_way", False)):
        stage = CurriculumStage(8, scenario=TELLING, guide=guide)
        assert stage.driver_scenario.team_messages == is_told


def test_a_policy_of_an_open_floor_observes_its_priority_among_walls() -> None:
    policy = learning.policy("flat", "set_pool", scenario=Scenario(robots=4, team_messages=True))
    assert not policy.observes_route
    for scenario in (TELLING, SILENT):
        observation, decision = decide(policy, scenario)
        priority = observation.sensors.get("priority", np.zeros((1, 4, 1)))
        assert_allclose(decision.features.ego[:, 0, -1], priority[0, :, 0])


@pytest.mark.parametrize("scenario", [TELLING, SILENT])
def test_an_exported_policy_is_told_as_much(
    policy,  # type: ignore[no-untyped-def]
    scenario: Scenario,
    tmp_path: Path,
) -> None:
    """`export_agent` compares the file with the policy; its inputs are those of the sensors."""
    checkpoint, path = tmp_path / "policy.safetensors", tmp_path / "policy.onnx"
    save_policy(checkpoint, policy, "flat", {})
    agent = load_agent("samarl_flat", scenario, checkpoint=str(checkpoint))
    export_agent(path, agent, "samarl_flat")
    expected = {"messages", "messages_known", "priority"} if scenario.team_messages else set()
    assert set(Network(path).sensor_inputs) == expected
