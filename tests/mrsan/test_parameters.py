"""The numbers of a scenario in the form that kernels take."""

from dataclasses import replace

import numpy as np
import pytest

from mrsan import Kinematics, Layout, Reward, Scenario
from mrsan.parameters import _COMPUTED, kernel_parameters


def test_durations_angles_and_absent_limits_are_converted() -> None:
    p = kernel_parameters(
        Scenario(
            time_step=0.1,
            time_limit=20.0,
            late_time=3.0,
            max_turn_rate=90.0,
            fov_degrees=120.0,
            humans=7,
            kinematics=Kinematics.unicycle,
            circle_radius=4.0,
            reward=Reward(goal_distance=0.8),
        )
    )
    assert (p.time_limit_steps, p.late_steps) == (200, 30)
    assert p.max_turn == pytest.approx(np.pi / 20)  # 90 degrees/s for 0.1 s
    assert p.cos_half_fov == pytest.approx(0.5)
    assert (p.humans_min, p.arena_radius) == (7, np.inf)
    assert p.goal_change_probability_max == p.goal_change_probability == np.float32(0.5)
    assert p.instant_velocity is True
    assert p.reward_goal_distance == pytest.approx(0.05)  # 0.8 / 4^2


def test_all_scenarios_have_parameters_of_the_same_types() -> None:
    """Otherwise kernels would be compiled once for each kind of scenario."""
    plain = kernel_parameters(Scenario())
    other = kernel_parameters(
        Scenario(
            humans_min=2, arena_radius=12.0, layout=Layout.mixed, goal_change_probability_max=1
        )
    )
    assert [type(value) for value in plain] == [type(value) for value in other]


def test_the_numbers_are_computed_again_only_if_a_field_was_changed() -> None:
    scenario = Scenario(robot_radius=0.2)
    numbers = kernel_parameters(scenario)
    assert kernel_parameters(scenario) is numbers
    assert kernel_parameters(replace(scenario, robot_radius=0.25)).robot_radius == np.float32(0.25)
    assert kernel_parameters(scenario) is numbers
    scenario.robot_radius = 0.3
    assert kernel_parameters(scenario).robot_radius == np.float32(0.3)
    scenario.reward.discomfort_distance = 2.0
    assert kernel_parameters(scenario).reward_discomfort_distance == 2.0


def test_the_numbers_are_forgotten_with_their_scenario() -> None:
    count = len(_COMPUTED)
    for radius in (0.2, 0.25, 0.3):  # objects that may get the same address one after the other
        assert kernel_parameters(Scenario(robot_radius=radius)).robot_radius == np.float32(radius)
    assert len(_COMPUTED) <= count
