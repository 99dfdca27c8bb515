"""What algorithms ask to be paid, on hand-made steps."""

from typing import Any

import numpy as np
import pytest

from mrsan import Scenario, World
from samarl.policies.policy import LOCAL
from samarl.reward_shaping import RewardShaping, level_rewards
from tests import learning


def paid(shaping: RewardShaping) -> np.ndarray:
    """Return the rewards of two robots that are 1 and 2 by their task, with a team bonus of 5."""
    scenario = Scenario(humans=0, robots=2)
    world = World(scenario, 1)
    before = world.reset([0])
    step: Any = world.step(np.zeros((1, 2, 3)))
    team = np.full((1, 2), 5.0, np.float32)
    parts = step.reward_parts._replace(team=team)
    step = step._replace(reward=np.array([[6.0, 7.0]], np.float32), reward_parts=parts)
    active = np.ones((1, 2), np.bool_)
    arguments = learning.policy("flat"), shaping, scenario, before, step, {}, active
    return level_rewards(*arguments)[LOCAL]


@pytest.mark.parametrize(
    ("shaping", "expected"),
    [
        (RewardShaping(), [6.0, 7.0]),
        (RewardShaping(team_bonus=False), [1.0, 2.0]),
        (RewardShaping(shared=True), [13.0, 13.0]),
        (RewardShaping(team_bonus=False, shared=True), [3.0, 3.0]),
    ],
)
def test_the_team_bonus_and_the_sum_over_the_team(
    shaping: RewardShaping, expected: list[float]
) -> None:
    assert paid(shaping)[0].tolist() == expected


def test_the_path_penalty_falls_linearly() -> None:
    learner = learning.algorithm(learning.policy("flat"), path_penalty=0.5)
    learner.set_progress(0.5)
    assert learner.reward_shaping == RewardShaping(path_penalty=0.25)
