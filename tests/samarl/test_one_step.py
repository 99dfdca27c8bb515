"""Predicted outcomes of commands, against the simulator and by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mrsan import Crowd, Entities, Kinematics, Observation, Reward, Scenario, World
from mrsan.features import GOAL, HEADING_COS, HEADING_SIN
from samarl.observations.tracker import AGE
from samarl.planning.one_step import command_set, predict_outcomes
from tests.scenes import COMMANDS, known, scene_of


@pytest.mark.parametrize("kinematics", Kinematics)
def test_outcomes_of_a_single_robot_match_the_simulator(kinematics: Kinematics) -> None:
    scenario = Scenario(robots=1, humans=0, kinematics=kinematics)
    commands = command_set(COMMANDS, kinematics)
    world = World(scenario, len(commands))
    world.reset(np.full(len(commands), 3))
    for index in (22, 13, 14):  # it moves and turns away from its goal
        observation = world.step(np.tile(commands[index], (len(commands), 1, 1))).observation
    for ahead in (5.0, 0.45):  # far from the goal, and just before it
        ego = observation.ego[0, 0]
        heading = math.atan2(ego[HEADING_SIN], ego[HEADING_COS])
        world.state.robot_goal[:, 0] = world.state.robot_position[:, 0] + ahead * np.array(
            [math.cos(heading), math.sin(heading)], np.float32
        )
        observation = world.observe()
        active = np.zeros((len(commands), 1), np.bool_)
        active[0] = True
        tracks = known(observation, scenario)
        outcomes = predict_outcomes(tracks, active, observation.ego[..., GOAL], commands, scenario)
        before = world.snapshot()
        step = world.step(commands[:, None])
        np.testing.assert_allclose(outcomes.tracks.ego, step.observation.ego, atol=1e-5)
        assert outcomes.ended[:, 0].tolist() == world.state.arrived[:, 0].tolist()
        assert outcomes.ended.any() == (ahead < 1.0)
        paid = (step.reward - step.reward_parts.team)[:, 0]
        np.testing.assert_allclose(outcomes.reward[:, 0], paid, atol=1e-4)
        world.restore(before)
    assert 1 <= outcomes.ended.sum() < len(commands)


@pytest.mark.parametrize("terminate_on_collision", [True, False])
@pytest.mark.parametrize("kinematics", Kinematics)
def test_outcomes_match_the_simulator_if_others_keep_their_velocity(
    kinematics: Kinematics, terminate_on_collision: bool
) -> None:
    """Contacts, discomfort, arrivals and next positions in random crowds."""
    scenario = Scenario(
        robots=3,
        humans=4,
        kinematics=kinematics,
        crowd=Crowd.still,
        terminate_on_collision=terminate_on_collision,
        reward=Reward(goal_distance=7.0, time=-0.5),
    )
    e, rng = 200, np.random.default_rng(0)
    world = World(scenario, e)
    world.reset(np.arange(e))
    state = world.state
    heading = rng.uniform(-np.pi, np.pi, (e, 3)).astype(np.float32)
    speed = rng.uniform(0.2, 1.0, (e, 3)).astype(np.float32)
    direction = np.stack([np.cos(heading), np.sin(heading)], -1)
    state.robot_heading[:] = heading
    state.robot_velocity[:] = speed[..., None] * direction
    state.robot_position[:] = rng.uniform(-1.2, 1.2, (e, 3, 2))
    state.robot_goal[:, 0] = state.robot_position[:, 0] + rng.uniform(-0.7, 0.7, (e, 2))
    state.human_position[:] = rng.uniform(-2.0, 2.0, (e, 4, 2))
    state.human_velocity[:] = 0.0
    keep = {
        Kinematics.acceleration_heading: lambda v: (0 * v, 0 * v, 0 * v),
        Kinematics.holonomic: lambda v: (v, 0 * v),
        Kinematics.unicycle: lambda v: (2 * v - 1, 0 * v),
    }[kinematics]
    commands = command_set(COMMANDS, kinematics)
    chosen = rng.integers(len(commands), size=e)
    action = np.stack(keep(speed), -1).astype(np.float32)
    action[:, 0] = commands[chosen]
    observation = world.observe()
    active = np.zeros((e, 3), np.bool_)
    active[:, 0] = True
    outcomes = predict_outcomes(
        known(observation, scenario), active, observation.ego[..., GOAL], commands, scenario
    )
    step = world.step(action)
    rows, after = np.arange(e), step.observation
    tracks = Observation.from_arrays(
        {name: array[chosen, rows] for name, array in outcomes.tracks.arrays("known").items()}
    )
    np.testing.assert_allclose(tracks.ego, after.ego[:, 0], atol=1e-5)
    for predicted, actual in ((tracks.humans, after.humans), (tracks.robots, after.robots)):
        np.testing.assert_allclose(predicted[..., :AGE], actual[:, 0], atol=1e-5)
    assert tracks.humans_known.all()
    assert tracks.robots_known.all()
    hit, arrived = state.collision[:, 0] != 0, state.arrived[:, 0]
    assert (outcomes.ended[chosen, rows] == ((hit & terminate_on_collision) | arrived)).all()
    paid = (step.reward - step.reward_parts.team)[:, 0]
    np.testing.assert_allclose(outcomes.reward[chosen, rows], paid, atol=2e-4)
    assert min(hit.sum(), arrived.sum(), (step.reward_parts.discomfort[:, 0] < 0).sum()) > 10


def test_a_collision_between_two_moments_is_foreseen() -> None:
    """A runner is on one side before the step and on the other after it."""
    scenario = Scenario(robots=1, humans=1)
    still = np.array([[-1.0, 0.0, 0.0]], np.float32)
    active = np.ones((1, 1), np.bool_)
    for aside, hit in ((0.0, True), (0.55, True), (0.65, False)):
        tracks = scene_of([[1.0, aside, -8.0, 0.0, 0.3]], (4.0, 0.0), 0.0, scenario)
        outcomes = predict_outcomes(tracks, active, tracks.ego[..., GOAL], still, scenario)
        assert outcomes.tracks.humans[0, 0, 0, 0] == -1.0
        assert outcomes.ended[0, 0] == hit
        assert outcomes.reward[0, 0] == (scenario.reward.collision if hit else 0.0)


def test_who_is_not_known_is_not_foreseen() -> None:
    scenario = Scenario(robots=3, humans=6, fov_degrees=90.0)
    world = World(scenario, 4)
    observation = world.reset(np.arange(4))
    tracks = known(observation, scenario)
    rng = np.random.default_rng(0)
    noisy = {
        name: Entities(
            np.where(group.mask[..., None], group.features, rng.normal(size=6)).astype("f"),
            group.mask,
        )
        for name, group in tracks.entities.items()
    }
    garbage = tracks._replace(entities=noisy)
    assert (garbage.humans != tracks.humans).any()
    commands, active = command_set(COMMANDS, scenario.kinematics), np.ones((4, 3), np.bool_)
    target = observation.ego[..., GOAL]
    one, other = (
        predict_outcomes(t, active, target, commands, scenario) for t in (tracks, garbage)
    )
    for a, b in zip(
        (*one.tracks.agents, *one[1:]), (*other.tracks.agents, *other[1:]), strict=True
    ):
        np.testing.assert_array_equal(a, b)
