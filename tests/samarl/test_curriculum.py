"""Which stages of a curriculum take part in a round, and what a policy for all of them observes."""

import json
import math
from collections import deque

import numpy as np

from mrsan import Scenario, World
from samarl.observations.features import EGO_DIRECTION
from samarl.observations.route import perimeter_route
from samarl.training.progress import STAGE_EPISODES, Progress
from tests import learning


def _rounds(progress: Progress, least: float, rounds: int = 400) -> list[float]:
    """Return in which share of the rounds each of three stages takes part."""
    chosen = [progress.next_stages([0, 1, 2], least) for _ in range(rounds)]
    assert all(chosen)
    return [sum(stage in stages for stages in chosen) / rounds for stage in range(3)]


def _progress(*successes: float) -> Progress:
    progress = Progress()
    for stage, success in enumerate(successes):
        outcomes = np.arange(STAGE_EPISODES) < success * STAGE_EPISODES
        progress.stage_successes[stage] = deque(outcomes.astype(float).tolist())
    return progress


def test_stages_take_part_as_often_as_there_is_something_to_learn() -> None:
    shares = _rounds(_progress(0.5, 0.9, 1.0), 0.25)
    np.testing.assert_allclose(shares, [1.0, 0.36, 0.25], atol=0.01)


def test_every_stage_takes_part_in_every_round_by_default_and_before_anything_is_known() -> None:
    assert _rounds(_progress(0.5, 0.9, 1.0), 1.0) == [1.0, 1.0, 1.0]
    assert _rounds(Progress(), 0.25) == [1.0, 1.0, 1.0]


def test_some_stage_always_takes_part() -> None:
    shares = _rounds(_progress(1.0, 1.0, 0.0), 0.01)
    assert sum(shares) >= 1.0


def test_participation_continues_after_a_run_was_resumed() -> None:
    progress = _progress(0.5, 0.9, 1.0)
    _rounds(progress, 0.25, 7)
    resumed = Progress()
    resumed.load_state_dict(json.loads(json.dumps(progress.state_dict())))
    for _ in range(20):
        assert progress.next_stages([0, 1, 2], 0.25) == resumed.next_stages([0, 1, 2], 0.25)


def test_a_policy_that_observes_routes_sees_the_way_round_the_crowd_as_its_route() -> None:
    """Among walls the next corner of the route, in the open with a narrow view the way round."""
    walled = Scenario(layout="doorway", robots=2, humans=2)
    policy = learning.policy("flat", scenario=walled)
    assert policy.observes_route
    target = slice(-3, -1)  # direction of the route, the last of the robots' own features
    for fov, is_round in ((90.0, True), (360.0, False)):
        scenario = Scenario(fov_degrees=fov, robots=2, humans=2)
        observation = World(scenario, 1).reset(np.array([3]))
        state = policy.initial_state(1, scenario)
        decision = policy.act(observation, state, np.ones(1, np.bool_), scenario)
        own = decision.features.ego[:, 0].numpy()
        way = perimeter_route(observation.ego, policy.config.round_radius, 0.3, 0.15)[0]
        angle = np.arctan2(own[:, target][:, 1], own[:, target][:, 0])
        goal = np.arctan2(*own[:, EGO_DIRECTION].T[::-1])
        expected = np.arctan2(way[:, 1], way[:, 0]) if is_round else goal
        turned = (angle - expected + math.pi) % (2 * math.pi) - math.pi
        np.testing.assert_allclose(turned, 0.0, atol=1e-4)
        assert is_round == bool((np.abs(angle - goal) > 0.1).any())
