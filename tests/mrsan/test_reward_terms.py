"""Custom terms of the reward."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from mrsan import Kinematics, Reward, Scenario, State, World
from mrsan.reward import REWARD_TERMS
from mrsan.reward_terms import register_reward_term

SCENARIO = Scenario(robots=2, humans=3, kinematics=Kinematics.holonomic, time_limit=2.0)


@pytest.fixture(autouse=True)
def _own_registry() -> Iterator[None]:
    """Register two terms for the duration of a test."""
    before = dict(REWARD_TERMS)

    @register_reward_term("speed")
    def speed(state: State, scenario: Scenario) -> np.ndarray:
        return np.linalg.norm(state.robot_velocity, axis=-1)

    @register_reward_term("height")
    def height(state: State, scenario: Scenario) -> np.ndarray:
        return state.robot_position[..., 1] / scenario.circle_radius

    yield
    REWARD_TERMS.clear()
    REWARD_TERMS.update(before)


def worlds_of(terms: dict[str, float]) -> World:
    world = World(replace(SCENARIO, reward=Reward(terms=terms)), 2)
    world.reset([0, 1])
    return world


def test_weighted_terms_are_added_to_the_reward_of_driving_robots() -> None:
    world, plain = worlds_of({"speed": 2.0, "height": -0.5}), worlds_of({})
    for w in (world, plain):  # robot 1 of world 0 arrives in the first step
        w.state.robot_goal[0, 1] = w.state.robot_position[0, 1]
    action = np.zeros((2, 2, 2), np.float32)
    action[1] = [[0.5, 0.0], [0.0, -1.0]]
    for _ in range(10):  # the time limit ends both worlds after the eighth step
        driving = ~world.state.arrived & ~world.state.done[:, None]
        step, expected = world.step(action), plain.step(action)
        speed = np.linalg.norm(world.state.robot_velocity, axis=-1)
        custom = np.where(driving, 2.0 * speed - world.state.robot_position[..., 1] / 10.0, 0.0)
        np.testing.assert_allclose(step.reward_parts.custom, custom, atol=1e-6)
        np.testing.assert_array_equal(step.reward, expected.reward + step.reward_parts.custom)
        np.testing.assert_array_equal(sum(step.reward_parts), step.reward)
        for name, part in expected.reward_parts._asdict().items():
            if name != "custom":
                np.testing.assert_array_equal(getattr(step.reward_parts, name), part)
        assert not expected.reward_parts.custom.any()
    assert not step.reward_parts.custom.any()
    assert world.state.done.all()


def test_invalid_terms_are_named() -> None:
    register_reward_term("flat")(lambda state, scenario: state.robot_heading[:, 0])
    register_reward_term("broken")(lambda state, scenario: state.robot_heading * np.nan)
    action = np.zeros((2, 2, 2))
    with pytest.raises(ValueError, match=r"term flat has shape \(2,\); it must have \(2, 2\)"):
        worlds_of({"flat": 1.0}).step(action)
    with pytest.raises(ValueError, match="reward term broken is nan for robot 0 in world 0"):
        worlds_of({"broken": 1.0}).step(action)
    with pytest.raises(ValueError, match="'a b'; it must be an identifier"):
        register_reward_term("a b")
