"""The macro level of `right_of_way`: features, decisions, advantages, training and files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mrsan import ConfigurationError, Layout, Observation, Split, World
from mrsan.features import GOAL
from mrsan.passages import find_passages
from samarl import load_agent, load_scenario
from samarl.agents.agent import Agent, act_and_tell
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.macro_level.decisions import Collector, Decisions
from samarl.macro_level.learner import Learner, advantages
from samarl.macro_level.network import NetworkConfig, PassageNetwork, save_macro_level
from samarl.macro_level.settings import MacroRewards, MacroTraining
from samarl.observations.features import to_world
from samarl.planning.passage_features import MATE, OWN, TRUTH
from samarl.planning.right_of_way import BY_RULE, ENTER, QUEUE
from samarl.policies.card import find_policy
from samarl.policies.checkpoint import load_policy
from samarl.training.collector import RolloutCollector
from samarl.training.curriculum import CurriculumStage
from samarl.training.setup import build_guide
from samarl.training.state import flatten_state, unflatten_state

NARROW = load_scenario("narrow_doorway", team_messages=True)
REWARDS = MacroRewards(success=2.0, arrival=0.1, collision=-1.0, progress=0.02, time=-0.005)
WORLDS = 8


def training(**changes: float) -> MacroTraining:
    """Return a small configuration."""
    settings = {
        "steps": 2 * WORLDS * 16,
        "worlds": WORLDS,
        "rollout": 16,
        "epochs": 1,
        "minibatch": 64,
        "learning_rate": 5e-4,
        "clip": 0.2,
        "discount": 0.998,
        "gae_lambda": 0.95,
        "entropy": 0.01,
        "entropy_end": 0.002,
        "value_weight": 0.5,
        "max_gradient_norm": 1.0,
        "seed": 0,
    }
    return MacroTraining(REWARDS, NetworkConfig(hidden=16), **(settings | changes))  # type: ignore[arg-type]


def planner(**changes: object) -> RightOfWay:
    agent = load_agent("right_of_way", NARROW, **changes)
    assert isinstance(agent, RightOfWay)
    return agent


def begin(agent: Agent, cases: np.ndarray | None = None) -> tuple[World, Observation]:
    """Return worlds in which episodes of validation cases begin, and what robots observe."""
    if cases is None:
        cases = Split.validation.case(0) + np.arange(WORLDS)
    world = World(agent.scenario, len(cases))
    agent.reset(np.ones(len(cases), np.bool_))
    return world, world.reset(cases)


def all_enter(own: np.ndarray, mates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.full(len(own), ENTER), np.zeros(len(own), np.float32)


def test_advantages_follow_each_robots_own_time_axis() -> None:
    """One robot: a decision of 3 steps, one of 5 until the episode ends, and one that goes on."""
    shape = 1, 1, 4
    d = Decisions(
        own=np.zeros((*shape, OWN), np.float32),
        mates=np.zeros((*shape, 0, MATE), np.float32),
        truth=np.zeros((*shape, 0, MATE + TRUTH), np.float32),
        choice=np.zeros(shape, np.int64),
        log_prob=np.zeros(shape, np.float32),
        reward=np.array([[[1.0, 2.0, 9.0, 9.0]]]),
        duration=np.array([[[3, 5, 2, 0]]]),
        ended=np.array([[[False, True, False, False]]]),
        number=np.array([[3]]),
    )
    value = np.array([[[0.5, 0.25, 0.125, 0.0]]])
    second = 2.0 - 0.25
    first = 1.0 + 0.9**3 * 0.25 - 0.5 + 0.9**3 * 0.8 * second
    expected = [first, second, 0.0, 0.0]
    np.testing.assert_allclose(advantages(d, value, 0.9, 0.8)[0, 0], expected)
    assert d.is_over[0, 0].tolist() == [True, True, False, False]


def test_decisions_earn_the_rewards_of_their_duration(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a reward of 1 per step, a decision of m steps earns a geometric sum, over rollouts."""
    collector = Collector(planner(), WORLDS, 16, 0, REWARDS, 0.9)
    monkeypatch.setattr(collector, "_reward", lambda *_: np.ones(WORLDS))
    longest = 0
    for _ in range(4):
        collector.collect(all_enter)
        d = collector.decisions
        filled = d.is_filled
        lengths = d.duration[filled]
        assert lengths.min() >= 1
        longest = max(longest, int(lengths.max()))
        np.testing.assert_allclose(d.reward[filled], (1.0 - 0.9**lengths) / 0.1)
        assert (d.own[filled][:, 14] <= 1.0).all()
    assert longest > 16  # some go on beyond a rollout


def test_features_are_those_of_the_door() -> None:
    """Distances to the mouth are the true ones, and beliefs are the truth where nothing is lost."""
    agent = planner()
    world, observation = begin(agent)
    seen = 0
    for _ in range(30):
        agent.perceive(observation)
        own, mates, truth = agent.features()
        for e, i in np.argwhere(agent.memory.due):
            passages = find_passages(world.state.walls[e], world.state.place[e], 1.6)
            here = world.state.robot_position[e, i]
            mouth = agent.memory.entry[e, i]
            ahead, aside = passages.relative(mouth, here.astype(float))
            assert own[e, i, 3] * 5.0 == pytest.approx(np.hypot(ahead, aside), abs=1e-3)
            assert own[e, i, 4] * 5.0 == pytest.approx(ahead, abs=1e-3)
            assert own[e, i, 2] / 5.0 + 1.15 == pytest.approx(passages.width[mouth], abs=1e-3)
            knows = mates[e, i, :, 0] == 1.0
            positions = [10, 11, 12, 16, 17]
            beliefs = mates[e, i][knows][:, positions]
            np.testing.assert_allclose(beliefs, truth[e, i][knows][:, positions], atol=2e-3)
            seen += int(knows.sum())
        agent.memory.choice[agent.memory.due] = QUEUE
        action = agent.drive()
        world.tell(agent.macro_actions())
        observation = world.step(action).observation
    assert seen > 50
    assert not agent.memory.inside.any()  # all queue


def test_training_is_resumed_and_belongs_to_one_configuration(tmp_path: Path) -> None:
    state = tmp_path / "training.safetensors"
    learner = Learner(training(), {"doorway": planner()}, state)
    before = [p.clone() for p in learner.actor.parameters()]
    learner.learn()
    pairs = zip(before, learner.actor.parameters(), strict=True)
    assert any((a != b).any() for a, b in pairs)
    again = Learner(training(), {"doorway": planner()}, state)
    assert again.steps == learner.steps == training().steps
    for a, b in zip(learner.actor.parameters(), again.actor.parameters(), strict=True):
        torch.testing.assert_close(a, b)
    with pytest.raises(ConfigurationError, match="another training run"):
        Learner(training(seed=1), {"doorway": planner()}, state)


def test_teams_of_different_sizes_train_one_network(tmp_path: Path) -> None:
    pair = load_agent("right_of_way", replace(NARROW, robots=2))
    assert isinstance(pair, RightOfWay)
    learner = Learner(training(), {"two": pair, "four": planner()}, tmp_path / "t.safetensors")
    learner.learn()
    assert learner.steps == training().steps
    own, mates = torch.rand(5, OWN), torch.rand(5, 3, MATE)
    absent = torch.cat([mates, torch.zeros(5, 2, MATE)], 1)
    torch.testing.assert_close(learner.actor(own, mates), learner.actor(own, absent))


def test_a_macro_level_is_trained_over_a_policy_too() -> None:
    with pytest.raises(ConfigurationError, match="no right of way"):
        Collector(load_agent("samarl_places", NARROW), WORLDS, 16, 0, REWARDS, 0.9)
    driven = load_agent("samarl_places", NARROW, right_of_way="rule")
    collector = Collector(driven, WORLDS, 60, 0, REWARDS, 0.9)
    collector.collect(all_enter)
    d = collector.decisions
    assert d.is_over.sum() > WORLDS
    assert set(d.choice[d.is_filled]) == {ENTER}
    assert (d.reward[d.is_over] > 0.0).any()  # they come nearer to their goals


def test_a_network_drives_and_what_it_must_not_know_has_no_effect(tmp_path: Path) -> None:
    network = PassageNetwork(NetworkConfig(hidden=16, priorities=False, intents=False))
    own, mates = torch.rand(5, OWN), torch.rand(5, 3, MATE)
    hidden = mates.clone()
    hidden[..., 1:7] = 0.5
    other = own.clone()
    other[:, 0] = 0.5
    torch.testing.assert_close(network(own, mates), network(other, hidden))
    path = tmp_path / "best.safetensors"
    save_macro_level(path, network, {})
    agent = planner(macro_level=str(tmp_path))
    world, observation = begin(agent)
    for _ in range(12):
        observation = world.step(agent.act(observation)).observation
    assert set(np.unique(agent.memory.choice)) <= {-1, QUEUE, ENTER}
    assert (agent.memory.choice >= 0).any()
    with pytest.raises(ConfigurationError, match=r"agent\.macro_level"):
        planner(macro_level="samarl")


@pytest.mark.parametrize(("level", "expected"), [("enter", 1.0), ("random", 0.5)])
def test_ablations_choose_without_a_network(level: str, expected: float) -> None:
    agent = planner(macro_level=level)
    world, observation = begin(agent)
    entered = []
    for _ in range(60):
        observation = world.step(act_and_tell(agent, observation, world)).observation
        entered.append((agent.memory.choice == ENTER)[agent.memory.due])
    share = np.concatenate(entered).mean()
    assert abs(share - expected) < 0.2
    assert (share == 1.0) == (level == "enter")


def test_a_choice_ends_with_its_episode() -> None:
    """What a robot chose before is among its features, but not what it chose in another episode."""
    agent = planner()
    world, observation = begin(agent)
    agent.perceive(observation)
    agent.memory.choice[:] = ENTER
    ended = np.arange(WORLDS) < 3
    agent.reset(ended)
    agent.perceive(world.reset(worlds=ended))
    assert (agent.memory.choice[ended] == BY_RULE).all()
    assert (agent.memory.choice[~ended] == ENTER).all()


def test_a_driver_is_sent_to_its_goal_or_its_place() -> None:
    agent = load_agent("samarl_places", NARROW, shield=False, right_of_way="rule")
    guide = planner()
    world, observation = begin(agent)
    waited = 0
    for _ in range(30):
        guide.decide(observation)
        directed = guide.direct()
        assert "messages" not in directed.entities
        memory, waits = guide.memory, guide.waits
        target = np.where(waits[..., None], memory.place, memory.goal)
        shown = to_world(directed.ego[..., GOAL], observation.ego)
        np.testing.assert_allclose(shown, target, atol=1e-4)
        waited += int(waits.sum())
        observation = world.step(act_and_tell(agent, observation, world)).observation
        np.testing.assert_array_equal(agent.macro_actions(), guide.macro_actions())
    assert waited > 0


def test_guided_rollouts_resume_bit_for_bit() -> None:
    """What a guide believes is part of the state of a collector, also after restarts."""
    scenario = replace(NARROW, nearest_walls=12)
    stage = CurriculumStage(
        6, scenario=scenario, guide="right_of_way", failure_restart_probability=0.8
    )
    policy, _ = load_policy(find_policy("samarl_places"))
    first, second = (
        RolloutCollector(stage, policy, 16, 0, guide=build_guide(stage.guide, scenario))
        for _ in range(2)
    )
    for _ in range(3):
        first.collect()
    saved = flatten_state(first.state_dict())
    second.load_state_dict(unflatten_state(first.state_dict(), saved, {}))
    steps = []
    for collector in (first, second):
        torch.manual_seed(0)
        steps.append(collector.collect().steps)
    for key in steps[0].keys(True, True):
        assert torch.equal(steps[0][key], steps[1][key]), key


def test_robots_face_to_face_give_way() -> None:
    """In these corners robots stood face to face until the time limit."""
    scenario = replace(NARROW, layout=Layout.corner, robots=3)
    agent = load_agent("right_of_way", scenario)
    cases = Split.validation.case(0) + np.array([9, 36, 39])
    world, observation = begin(agent, cases)
    while not world.state.done.all():
        observation = world.step(act_and_tell(agent, observation, world)).observation
    assert world.state.arrived.all(1).sum() >= 2
