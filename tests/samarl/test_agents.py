"""All agents of `conf/agent/`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrsan import ConfigurationError, Crowd, Kinematics, Observation, Scenario, Split, World
from mrsan.fields import required
from samarl.agents import Agent, build_agent
from samarl.configuration import available_agents, load_agent_config, scenario_of
from samarl.evaluation.methods import label_of
from samarl.evaluation.runner import run_cases
from samarl.files import find_folder
from samarl.policies.card import find_policy
from samarl.policies.checkpoint import load_policy, save_policy

CONFIGS = {name: load_agent_config(name) for name in available_agents()}
LEARNED = {name for name, config in CONFIGS.items() if "checkpoint" in config}
PLANNERS = {"orca", "social_force", "straight", "perimeter", "model_predictive"}
CASES = Split.test.case(0) + np.arange(40)


def drives(name: str) -> list[Kinematics]:
    """A policy drives the robots that it was trained on, a planner all of them.

    So does a policy whose velocities are tracked.
    """
    if name not in LEARNED or CONFIGS[name].get("track_velocity"):
        return list(Kinematics)
    card = find_policy(CONFIGS[name]["checkpoint"]).with_suffix(".json").read_text("utf-8")
    return [kinematics for kinematics in Kinematics if kinematics.name in card]


def test_labels_say_which_agents_have_a_shield() -> None:
    for name, config in CONFIGS.items():
        shielded = [label_of(f"{name}{ending}") for ending in ("", " shield=false", " shield=true")]
        has_shield = [label.endswith(", shielded") for label in shielded]
        assert has_shield == [bool(config.get("shield")), False, True], name


def agent_in(name: str, scenario: Scenario) -> Agent:
    return build_agent(CONFIGS[name], scenario)


@pytest.mark.parametrize(
    ("name", "kinematics"), [(name, kinematics) for name in CONFIGS for kinematics in drives(name)]
)
def test_an_action_is_valid_and_depends_on_the_observations_of_its_own_world_only(
    name: str, kinematics: Kinematics
) -> None:
    """Neither other worlds of the batch nor the truth behind an observation change an action."""
    scenario = Scenario(
        robots=3, humans=6, kinematics=kinematics, fov_degrees=120.0, position_noise=0.05
    )
    world, alone_world = World(scenario, 12), World(scenario)
    agent, alone = agent_in(name, scenario), agent_in(name, scenario)
    observation, own = world.reset(CASES[:12]), alone_world.reset(CASES[7:8])
    agent.reset(np.ones(12, bool))
    alone.reset(np.ones(1, bool))
    for _ in range(4):  # from rest, then moving
        action, own_action = agent.act(observation), alone.act(own)
        assert action.shape == (12, 3, scenario.action_size)
        assert (np.abs(action) <= 1).all()
        if CONFIGS[name].get("waypoints") != "random":  # which are drawn for a whole batch
            # Sums in a network are rounded otherwise in another batch.
            tolerance = 1e-4 if name in LEARNED else 0.0
            np.testing.assert_allclose(own_action[0], action[7], atol=tolerance, rtol=0)
        own_action[0] = action[7]  # both go on from the same state
        observation, own = world.step(action).observation, alone_world.step(own_action).observation
    unseen = ~observation.humans_visible.any(1)  # by no robot
    assert unseen.any()
    actions = []
    for scrambled in (False, True):
        if scrambled:
            world.state.human_position[unseen] = 500.0 + 9.0 * np.arange(unseen.sum())[:, None]
            world.state.human_velocity[unseen] = 3.0
            world.state.human_goal[:] = 0.0
            observation = world.observe()
        agent = agent_in(name, scenario)
        agent.reset(np.ones(12, bool))
        actions.append(agent.act(observation))
    np.testing.assert_array_equal(*actions)


def test_every_planner_arrives_alone_and_ends_among_people() -> None:
    """Policies play in `test_an_action_is_valid_...`, and with the committed results."""
    for name in sorted(PLANNERS):
        alone = Scenario(robots=1, humans=0, time_limit=30.0)
        crowded = Scenario(fov_degrees=90.0, humans=5, time_limit=5.0)
        for scenario in (alone, crowded):
            episodes = run_cases(agent_in(name, scenario), scenario, CASES[:2], batch=2)
            assert (episodes.path_length > 0).any(), name
            assert (episodes.duration <= scenario.time_limit).all(), name
            if scenario is alone:
                assert np.isinf(episodes.closest_human).all(), name
                assert episodes.success.all() or name == "perimeter"


def test_a_policy_trained_on_other_robots_is_refused() -> None:
    for name, kinematics in (
        ("samarl", Kinematics.holonomic),
        ("samarl_flat", Kinematics.unicycle),
        ("msa3cpred", Kinematics.acceleration_heading),
    ):
        with pytest.raises(ConfigurationError, match=rf"kinematics is {kinematics.name}"):
            agent_in(name, Scenario(kinematics=kinematics))


@pytest.mark.parametrize("kinematics", Kinematics)
def test_straight_alone_always_arrives_on_the_straight_line(kinematics: Kinematics) -> None:
    scenario = Scenario(robots=1, humans=0, kinematics=kinematics)
    episodes = run_cases(agent_in("straight", scenario), scenario, CASES, batch=40)
    assert episodes.success.all()
    # It arrives within a radius of its goal, and may have driven a step beyond that circle.
    short = episodes.straight_line - episodes.path_length
    assert (short > 0).all()
    assert (short <= 0.3 + 1e-4).all()
    assert (episodes.time <= episodes.straight_line / 1.0 + 0.25).all()


def test_driving_around_the_crowd_beats_driving_through_it() -> None:
    scenario = Scenario()
    perimeter, straight = (
        run_cases(agent_in(name, scenario), scenario, CASES, batch=40)
        for name in ("perimeter", "straight")
    )
    assert perimeter.success.mean() > straight.success.mean() + 0.3
    assert perimeter.path_length[perimeter.success].mean() > 20  # a half circle of 7.5 m is 23.6 m


def test_perceiving_people_beats_ignoring_them() -> None:
    """With everybody in view, predicting people is better than driving straight on."""
    scenario = Scenario(robots=1)
    looking, blind = (
        run_cases(agent_in(name, scenario), scenario, CASES, batch=40)
        for name in ("model_predictive", "straight")
    )
    assert looking.success.mean() > blind.success.mean() + 0.2


@dataclass
class Waiting(Agent):
    patience: int = required(1, 10)

    def act(self, observation: Observation) -> np.ndarray:
        return np.zeros((*observation.ego.shape[:2], self.scenario.action_size), np.float32)


HERE = f"{__name__}.Waiting"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"_target_": "no.where.Nobody"}, r"agent._target_ is 'no.where.Nobody'; it must be"),
        ({"_target_": "mrsan.World"}, r"agent._target_ is 'mrsan.World'; it must be a subclass"),
        ({}, r"agent has no _target_"),
        ({"_target_": HERE}, r"patience"),
        ({"_target_": HERE, "patience": 11}, r"agent.patience is 11; .* in \[1, 10\]"),
        ({"_target_": HERE, "patience": 0}, r"agent.patience is 0"),
        ({"_target_": HERE, "patience": "long"}, r"agent\.patience: .*'long'"),
        ({"_target_": HERE, "patience": 3, "x": 1}, r"agent\.x is not known; .*patience, shield"),
        ({"_target_": HERE, "patience": 3, "shild": True}, r"shild .* mean agent\.shield\?"),
    ],
)
def test_invalid_agents_are_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        build_agent(fields, Scenario())


def test_the_scenarios_of_included_policies_have_the_fields_of_this_version() -> None:
    cards = sorted((find_folder("results") / "checkpoints").glob("*.json"))
    assert len(cards) > 30
    scenarios = {}  # many policies were trained in the same ones
    for card in cards:
        configuration = json.loads(card.read_text("utf-8"))["provenance"]["configuration"]
        for stage in configuration["curriculum"]["stages"]:
            scenarios[json.dumps(stage["scenario"])] = stage["scenario"], card.name
    for scenario, name in scenarios.values():
        scenario_of(scenario, name)


def test_a_policy_warns_about_recordings_it_was_trained_on(tmp_path: Path) -> None:
    policy, card = load_policy(find_policy("samarl_flat"))
    provenance = {"configuration": {"stages": [{"scenario": {"recording": "mine/walk.txt"}}]}}
    save_policy(tmp_path / "known.safetensors", policy, card.policy, provenance)
    fields = {**CONFIGS["samarl_flat"], "checkpoint": str(tmp_path / "known.safetensors")}
    for recording, known in (("theirs/walk.txt", True), ("mine/run.txt", False), (None, False)):
        scenario = Scenario(crowd=Crowd.recorded, recording=recording)
        warning = build_agent(fields, scenario).scope_warning()
        assert (warning or "").endswith("was trained among the people of walk.txt") == known


@pytest.mark.parametrize(
    ("guide", "right_of_way"),
    [
        (None, None),
        ("right_of_way", "rule"),
        ("right_of_way macro_level=right_of_way_macro", "right_of_way_macro"),
    ],
)
def test_a_policy_drives_with_the_right_of_way_of_its_training(
    tmp_path: Path, guide: str | None, right_of_way: str | None
) -> None:
    policy, card = load_policy(find_policy("samarl_flat"))
    stages = [{"guide": None}, {"guide": guide}]
    provenance = {"configuration": {"curriculum": {"stages": stages}}}
    save_policy(tmp_path / "mine.safetensors", policy, card.policy, provenance)
    assert load_agent_config(str(tmp_path / "mine.safetensors"))["right_of_way"] == right_of_way
