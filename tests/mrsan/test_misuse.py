"""What a user of the Python API gets wrong is said, not guessed at."""

import dataclasses
import inspect
from functools import partial
from typing import Any

import numpy as np
import pytest

from mrsan import ConfigurationError, Crowd, Place, Reward, Scenario, World
from mrsan.kernels.tally import CLOSE_STEPS


def test_a_world_that_was_never_reset_is_not_stepped() -> None:
    world = World(Scenario(robots=1), 3)
    world.reset([5, 6, 7], np.array([True, False, True]))
    with pytest.raises(RuntimeError, match="world 1 has not been reset"):
        world.step(np.zeros((3, 1, 3)))


def test_rewards_and_places_may_be_mappings_of_their_fields() -> None:
    scenario = Scenario(reward={"collision": -5}, place={"door_width_max": 3.0})  # type: ignore[arg-type]
    assert scenario.reward == Reward(collision=-5)
    assert scenario.place == Place(door_width_max=3.0)
    assert dataclasses.replace(scenario, robots=1).reward == scenario.reward
    wrong: Any
    for wrong, message in (
        ({"colision": -5}, r"scenario\.reward\.colision is not known; did you mean collision"),
        ({"collision": "x"}, r"scenario\.reward\.collision is 'x'; it must lie in"),
        (-5, r"scenario\.reward is -5; it must be a Reward or a mapping"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            Scenario(reward=wrong)


def test_a_scenario_suggests_the_field_that_is_meant() -> None:
    wrong: Any = {"dt": 0.1}
    for make in (Scenario, partial(dataclasses.replace, Scenario())):
        with pytest.raises(TypeError, match=r"argument 'dt' \(0\.1\); did you mean time_step\?"):
            make(**wrong)
    assert list(inspect.signature(Scenario).parameters)[:3] == ["name", "robots", "humans"]


def test_a_crowd_that_is_pushed_hard_stays_finite() -> None:
    scenario = Scenario(crowd=Crowd.social_force, human_safety_space=5.0, force_range=0.1)
    world = World(scenario, 2)
    world.reset([0, 1])
    for _ in range(20):
        world.step(np.zeros((2, 3, 3)))
    assert np.isfinite(world.state.human_position).all()


def test_a_reward_weight_does_not_change_the_metrics() -> None:
    shares = []
    for distance in (0.0, 2.0):
        scenario = Scenario()
        scenario.reward.discomfort_distance = distance
        world = World(scenario, 8)
        world.reset(np.arange(8))
        forward = np.tile(np.float32([0.5, 0, 0]), (8, 3, 1))
        for _ in range(20):
            world.step(forward)
        shares.append(world.state.tally[..., CLOSE_STEPS].tolist())
    assert shares[0] == shares[1]
    assert np.sum(shares) > 0
