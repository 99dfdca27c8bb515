"""The modes of the macro level: what they mean, how they are drawn, and who knows of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
import torch

from mrsan import ConfigurationError, Layout, Scenario, TeamPerception, World
from mrsan.features import VELOCITY
from samarl.agents.learned import DeployedPolicy
from samarl.algorithms import ALGORITHMS
from samarl.observations.features import (
    NETWORK_OTHER_FEATURES,
    empty_tracks,
    frames_of,
    to_body,
)
from samarl.observations.frames import Frames
from samarl.observations.tracker import Tracks
from samarl.policies import hierarchical
from samarl.policies.heads import ModeAndOffset
from samarl.policies.hierarchical import HierarchicalPolicy
from samarl.policies.macro_actions import (
    PLACES_TO_YIELD,
    ROOM,
    Mode,
    decode_waypoint,
    is_blocked,
    place_to_yield,
)
from samarl.policies.policy import MACRO, WAYPOINT_FEATURES
from tests.learning import REPPO_NUMBERS, SCENARIO, algorithm, collector, policy

OPEN = replace(SCENARIO, humans=0, fov_degrees=360.0, time_limit=50.0)
LOGITS = torch.tensor([[2.0, 0.0, 1.0, -1.0, 0.5]])
LOC, SCALE = torch.tensor([[0.5, -0.5]]), torch.tensor([[0.1, 0.2]])


def with_mode(mode: Mode, scenario: Scenario | None = None, **numbers: int) -> HierarchicalPolicy:
    """A policy that always chooses `mode` and moves no waypoint."""
    model = policy(scenario=scenario, modes=True, **numbers)
    assert isinstance(model, HierarchicalPolicy)
    head = model.networks[0].heads[MACRO]
    with torch.no_grad():
        for parameter in (*head.body[-1].parameters(), *head.logits.parameters()):
            parameter.zero_()
        head.logits.bias[mode] = 100.0
    return model


def test_the_probability_of_an_offset_counts_only_if_the_robot_goes() -> None:
    distribution = ModeAndOffset(LOGITS, LOC, SCALE)
    weights = [math.exp(logit) for logit in LOGITS[0].tolist()]
    offset = [0.6, -0.1]
    density = sum(
        -0.5 * ((x - m) / s) ** 2 - math.log(s * math.sqrt(2 * math.pi))
        for x, m, s in zip(offset, LOC[0].tolist(), SCALE[0].tolist(), strict=True)
    )
    for mode in Mode:
        expected = math.log(weights[mode] / sum(weights)) + (density if mode is Mode.go else 0.0)
        value = torch.tensor([[float(mode), *offset]])
        assert distribution.log_prob(value).item() == pytest.approx(expected, abs=1e-5)


def test_the_entropy_is_the_mean_of_minus_the_log_probability() -> None:
    torch.manual_seed(0)
    distribution = ModeAndOffset(*(x.expand(100000, -1) for x in (LOGITS, LOC, SCALE)))
    sample = distribution.sample()
    estimate = -distribution.log_prob(sample).mean().item()
    assert distribution.entropy()[0].item() == pytest.approx(estimate, abs=0.02)
    best = distribution.deterministic_sample[0].tolist()
    assert best == pytest.approx([0.0, 0.5, -0.5])


def test_modes_are_drawn_as_often_as_their_probabilities_say() -> None:
    model, rows = policy(modes=True), 20000
    assert isinstance(model, HierarchicalPolicy)
    head = model.networks[0].heads[MACRO]
    with torch.no_grad():
        head.logits.weight.zero_()
        head.logits.bias.copy_(LOGITS[0])
    torch.manual_seed(0)
    embedding = torch.zeros(rows, head.body[0].in_features)
    action, log_prob = model._sample_macro(embedding, torch.arange(rows), torch.randn(rows, 3))
    share = torch.bincount(action[:, 0].long(), minlength=len(Mode)) / rows
    expected = LOGITS[0].softmax(-1)
    assert share.tolist() == pytest.approx(expected.tolist(), abs=0.015)
    waits = action[:, 0] == Mode.wait
    assert log_prob[waits].tolist() == pytest.approx([expected[1].log().item()] * int(waits.sum()))


@pytest.mark.parametrize(
    ("mode", "ahead", "left"),
    [
        (Mode.go, 2.0, 0.0),
        (Mode.wait, 0.0, 0.0),
        (Mode.yield_left, -1.0, 1.2),
        (Mode.yield_right, -1.0, -1.2),
        (Mode.other_route, 2.0, 0.0),  # there is none
    ],
)
def test_the_waypoint_of_a_mode(mode: Mode, ahead: float, left: float) -> None:
    model, world = with_mode(mode), World(OPEN)
    observation = world.reset([0])  # the robots look at their goals
    state = model.initial_state(1, OPEN)
    decision = model.act(observation, state, np.ones(1, np.bool_), OPEN)
    waypoint = to_body(state["waypoint"].view(1, 2, 2).numpy(), observation.ego)
    np.testing.assert_allclose(waypoint, [[[ahead, left]] * 2], atol=1e-3)
    features = decision.step.waypoint_features
    assert features is not None
    one_hot = [float(other is mode) for other in Mode]
    assert features[0, 0, WAYPOINT_FEATURES:].tolist() == one_hot


def test_a_robot_takes_another_route_where_there_is_one() -> None:
    scenario = replace(OPEN, layout=Layout.rooms, sensors={"other_route": {}}, nearest_walls=8)
    model, world = with_mode(Mode.other_route, scenario), World(scenario, 40)
    observation = world.reset(np.arange(40))
    state = model.initial_state(40, scenario)
    model.act(observation, state, np.ones(40, np.bool_), scenario)
    waypoint = to_body(state["waypoint"].view(40, 2, 2).numpy(), observation.ego)
    other = observation.sensors["other_route"][..., :2]
    exists = other.any(-1)
    assert 5 < exists.sum() < 75
    towards = np.where(exists[..., None], other, observation.sensors["route"])
    distance = np.linalg.norm(towards, axis=-1, keepdims=True)
    np.testing.assert_allclose(waypoint, towards * np.minimum(2.0 / distance, 1.0), atol=1e-3)


def test_a_robot_yields_at_the_first_place_that_it_can_reach() -> None:
    """Compared with shapely, in doorways and rooms."""
    seen = set()
    for layout in (Layout.doorway, Layout.rooms):
        scenario = replace(OPEN, layout=layout, nearest_walls=12)
        world = World(scenario, 60)
        observation = world.reset(np.arange(60))
        frames = frames_of(Tracks(*observation[:3]), scenario)
        route = torch.from_numpy(observation.sensors["route"]).flatten(0, 1)
        ahead = route / route.norm(dim=-1, keepdim=True)
        segments, known = (x.reshape(120, 12, -1) for x in observation.entities["walls"])
        for side in (1.0, -1.0):
            places = place_to_yield(ahead, side, frames).numpy()
            for place, (x, y), ends, seen_walls in zip(places, ahead, segments, known, strict=True):
                walls = shapely.multilinestrings(ends[seen_walls[:, 0]].reshape(-1, 2, 2))
                expected, first = np.zeros(2), None
                for number, (back, aside) in enumerate(PLACES_TO_YIELD):
                    at = np.array([-back * x - side * aside * y, -back * y + side * aside * x])
                    near = walls.distance(shapely.Point(at)) < ROOM
                    if not near and not walls.crosses(shapely.LineString([(0, 0), at])):
                        expected, first = at, number
                        break
                seen.add(first)
                np.testing.assert_allclose(place, expected, atol=1e-4)
    assert {None, 0, 1, 4} <= seen  # also no place, not back, and not as far aside


def test_a_robot_that_waits_decides_again_after_all_steps_of_its_macro_action() -> None:
    model, world = with_mode(Mode.wait, making_way_steps=6), World(OPEN)
    observation, begins = world.reset([0]), np.ones(1, np.bool_)
    state, decided = model.initial_state(1, OPEN), []
    for _ in range(8):
        decision = model.act(observation, state, begins, OPEN)
        decided.append(bool(decision.levels[MACRO].decided.all()))
        begins = np.zeros(1, np.bool_)
    assert decided == [True, *[False] * 5, True, False]


def frames_with(speed: float, ahead: float, left: float, known: bool = True) -> Frames:
    """What a robot knows that drives at `speed`, with one person at (ahead, left), m."""
    tracks = empty_tracks(replace(OPEN, robots=1, humans=1))
    tracks.ego[..., VELOCITY] = speed, 0.0
    features, mask = tracks.entities["humans"]
    features[..., :2], features[..., 4], mask[:] = (ahead, left), 0.3, known
    return frames_of(tracks, OPEN)


@pytest.mark.parametrize(
    ("frames", "blocked"),
    [
        (frames_with(0.0, 1.0, 0.0), True),
        (frames_with(0.0, 1.0, 0.0, known=False), False),
        (frames_with(0.5, 1.0, 0.0), False),  # it drives
        (frames_with(0.0, 1.2, 0.0), False),  # 0.6 m between the surfaces
        (frames_with(0.0, 0.6, 0.8), True),  # 53 degrees to the side
        (frames_with(0.0, 0.4, 0.9), False),  # 66 degrees
        (frames_with(0.0, -1.0, 0.0), False),  # behind it
    ],
)
def test_a_standing_robot_is_blocked_by_whoever_is_near_and_ahead(
    frames: Frames, blocked: bool
) -> None:
    assert OPEN.robot_radius == pytest.approx(0.3)
    assert is_blocked(frames, torch.tensor([[2.0, 0.0]])).tolist() == [blocked]


@pytest.mark.parametrize(("mode", "expected"), [(Mode.go, [0, 4, 8]), (Mode.wait, [0])])
def test_a_blocked_robot_decides_again_after_some_patience_unless_it_waits(
    mode: Mode, expected: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def everybody(frames: Frames, waypoint: torch.Tensor) -> torch.Tensor:
        return torch.ones(len(waypoint), dtype=torch.bool)

    monkeypatch.setattr(hierarchical, "is_blocked", everybody)
    model, world = with_mode(mode, macro_steps=20, ends_when_blocked=True), World(OPEN)
    observation, begins = world.reset([0]), np.ones(1, np.bool_)
    state, decided = model.initial_state(1, OPEN), []
    for step in range(10):
        decision = model.act(observation, state, begins, OPEN)
        if decision.levels[MACRO].decided.all():
            decided.append(step)
        begins = np.zeros(1, np.bool_)
    assert decided == expected


def test_the_macro_level_learns_to_wait_if_only_that_is_rewarded() -> None:
    model = policy(modes=True)
    learner = algorithm(model, learning_rate=0.02, epochs=4)
    rollouts = collector(model, 32, 16, OPEN)
    for _ in range(12):
        rollout = rollouts.collect()
        waits = rollout.steps["agents", "waypoint_features"][..., WAYPOINT_FEATURES + Mode.wait]
        rollout.steps["next", "agents", "macro", "reward"] = waits.float()
        statistics = learner.update([rollout])
        assert all(np.isfinite(value) for value in statistics.values())
    assert waits.mean() > 0.5  # 0.13 at first


def test_critics_observe_the_macro_actions_of_team_mates() -> None:
    scenario = replace(OPEN, robots=3)
    model = policy(modes=True)
    going = collector(model, 2, 5, scenario)
    rollout = going.collect()
    assert rollout.state is not None
    others = rollout.state.robots.view(2, 3, 6, 2, -1)  # [S, N, T + 1, N - 1, F]
    own = rollout.steps["agents", "waypoint_features"].transpose(1, 2)  # [S, N, T + 1, W]
    modes = others[..., -len(Mode) :]
    for robot, slots in ((0, (1, 2)), (1, (0, 2)), (2, (0, 1))):
        for slot, other in enumerate(slots):
            assert torch.equal(modes[:, robot, :, slot], own[:, other, :, WAYPOINT_FEATURES:])
    # The third feature is exp(-distance): the waypoint is in the frame of the observer.
    ego = going.observation.ego
    waypoint = going.state["waypoint"].view(2, 3, 2).numpy()
    distance = np.linalg.norm(to_body(waypoint[:, [1, 2]], ego[:, :1]), axis=-1)
    nearness = others[:, 0, -1, :, -len(Mode) - 1]
    np.testing.assert_allclose(nearness, np.exp(-distance), atol=1e-5)


def test_robots_observe_the_intent_of_team_mates_only_with_team_perception() -> None:
    silent = replace(OPEN, robots=3)
    talking = replace(silent, team_perception=TeamPerception.tracks)
    for scenario in (silent, talking):
        model, world = policy(modes=True, observes_intent=True), World(scenario, 2)
        state, observation = model.initial_state(2, scenario), world.reset([0, 1])
        begins = np.ones(2, np.bool_)
        for step in range(3):
            before = {
                name: value.clone()
                for name, value in state.items()
                if name != "tracks" and isinstance(value, torch.Tensor)
            }
            decision = model.act(observation, state, begins, scenario)
            intent = decision.features.robots[:, 0, :, NETWORK_OTHER_FEATURES:].view(2, 3, 2, -1)
            if step == 0 or scenario is silent:
                assert not intent.any()
            else:
                mode = torch.nn.functional.one_hot(before["mode"], len(Mode)).view(2, 3, -1)
                assert torch.equal(intent[:, 1, :, WAYPOINT_FEATURES:], mode[:, [0, 2]].float())
                ahead = before["waypoint"].view(2, 3, 2).numpy()[:, [0, 2]]
                ahead = to_body(ahead, observation.ego[:, 1:2])
                seen = decode_waypoint(intent[:, 1])
                np.testing.assert_allclose(seen, ahead, atol=1e-5)
            observation, begins = world.step(decision.action).observation, np.zeros(2, np.bool_)


@pytest.mark.parametrize(
    ("name", "value"), [("team_range", 4.0), ("team_delay", 0.5), ("team_loss", 0.25)]
)
def test_limits_of_reports_are_refused_where_intent_would_ignore_them(
    name: str, value: float
) -> None:
    talking = replace(OPEN, team_perception=TeamPerception.tracks)
    limited = replace(talking, **{name: value})
    model = policy(modes=True, observes_intent=True)
    for scenario in (talking, replace(OPEN, **{name: value})):
        DeployedPolicy(model, scenario)
    DeployedPolicy(policy(modes=True), limited)
    message = rf"scenario\.{name} is {value}; .*observes_intent"
    with pytest.raises(ConfigurationError, match=message):
        DeployedPolicy(model, limited)
    with pytest.raises(ConfigurationError, match=message):
        collector(model, 1, 4, limited)


def test_reppo_refuses_policies_with_modes() -> None:
    numbers = ALGORITHMS.config({"name": "reppo", **REPPO_NUMBERS})
    with pytest.raises(ConfigurationError, match=r"policy\.modes is true"):
        ALGORITHMS["reppo"].cls(policy(modes=True), numbers)
