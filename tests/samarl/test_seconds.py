"""Durations and rates mean the same at every time step."""

import numpy as np
import pytest

from mrsan import Scenario, World
from samarl.agents import build_agent
from samarl.configuration import load_agent_config
from samarl.observations.tracker import Tracker
from samarl.planning.shield import Shield, apply_shield
from tests.scenes import scene_of
from tests.staging import stage

TIME_STEPS = [0.05, 0.1, 0.25, 0.5]


@pytest.mark.parametrize("time_step", TIME_STEPS)
def test_a_robot_turns_by_so_much_in_a_second(time_step: float) -> None:
    world = World(Scenario(robots=1, humans=0, time_step=time_step, max_turn_rate=60.0))
    world.reset([0])
    heading = float(world.state.robot_heading[0, 0])
    for _ in range(round(1.0 / time_step)):
        world.step(np.float32([[[-1.0, 0.0, 1.0]]]))  # it stands and turns
    turned = np.degrees(world.state.robot_heading[0, 0] - heading) % 360
    assert turned == pytest.approx(60.0, abs=1e-3)


@pytest.mark.parametrize("time_step", TIME_STEPS)
def test_who_is_out_of_view_is_remembered_for_six_seconds(time_step: float) -> None:
    tracker = Tracker(6.0, time_step)
    memory = tracker.initial(1, 1, 1)
    visible = stage([[0, 0, 0, 0, 9, 0]], [[2, 0, 0, 0]], time_step=time_step).observe()
    hidden = visible.of_worlds(np.arange(1))
    hidden.humans_visible[:] = False
    tracker.update(visible, memory, np.array([True]))
    steps = 0
    while tracker.update(hidden, memory, np.array([False])).humans_known.any():
        steps += 1
    assert steps * time_step == pytest.approx(6.0)


@pytest.mark.parametrize("time_step", TIME_STEPS)
@pytest.mark.parametrize(("gap", "replaced"), [(2.0, False), (0.6, True)])
def test_the_shield_looks_two_seconds_ahead(time_step: float, gap: float, replaced: bool) -> None:
    """Inside a ring of people a robot at 1 m/s needs 1.7 s and 0.83 m to stop at 0.6 m/s^2."""
    scenario = Scenario(
        robots=1, humans=40, time_step=time_step, max_acceleration=0.6, min_turning_radius=10.0
    )
    bearings = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    distance = 0.3 + 0.3 + gap
    ring = [[distance * np.cos(b), distance * np.sin(b), -1.0, 0.0, 0.3] for b in bearings]
    action = np.float32([[[0.0, 0.0, 0.0]]])
    checked = apply_shield(scene_of(ring, (9.0, 0.0), 1.0, scenario), action, scenario, Shield())
    assert bool((checked != action).any()) == replaced


def test_a_policy_names_what_it_was_not_trained_for() -> None:
    config = load_agent_config("samarl_circle")
    assert build_agent(config, Scenario()).scope_warning() is None
    two = "a view of 360 degrees and a time step of 0.25 s"
    for fields, trained, here in (
        ({"robot_speed": 1.5}, "a robot speed of 1 m/s", "1.5 m/s"),
        ({"robot_radius": 0.5}, "a robot radius of 0.3 m", "0.5 m"),
        ({"fov_degrees": 90.0, "time_step": 0.5}, two, "90 degrees and 0.5 s"),
    ):
        warning = build_agent(config, Scenario(**fields)).scope_warning()
        assert warning == f"samarl_circle was trained for {trained}; here it is {here}"
