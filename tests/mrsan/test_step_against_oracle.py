"""A whole step of the compiled world against its slow float64 twin, on random worlds."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import oracle
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mrsan import Crowd, CrowdReaction, Kinematics, Layout, Outcome, Reward, Scenario, World
from mrsan.kernels.tally import TALLY

TOLERANCE = 2e-4
THRESHOLD_MARGIN = 1e-4  # nearer to a threshold than this, float32 may decide differently
NOISE = 1e-6  # what float32 does to a state of a few metres

SEEDS = st.integers(0, 2**32)
SCENARIOS = st.builds(
    Scenario,
    robots=st.sampled_from([4, 1, 2, 3]),
    humans=st.sampled_from([6, 3, 8, 1, 0]),
    kinematics=st.sampled_from(Kinematics),
    crowd=st.sampled_from([Crowd.orca, Crowd.orca, Crowd.social_force, Crowd.still]),
    crowd_reaction=st.sampled_from([CrowdReaction.blind, CrowdReaction.reciprocal]),
    fov_degrees=st.sampled_from([1.0, 60.0, 90.0, 180.0, 200.0, 359.0, 360.0]),
    sensing_range=st.sampled_from([2.0, 10.0]),
    occlusion=st.booleans(),
    turn_in_place=st.booleans(),
    max_acceleration=st.sampled_from([0.5, 5.0]),
    max_turn_rate=st.sampled_from([60.0, 480.0]),
    min_turning_radius=st.sampled_from([0.2, 1.0]),
    time_step=st.sampled_from([0.1, 0.25]),
    arena_radius=st.sampled_from([None, 6.1]),
    max_neighbors=st.sampled_from([2, 10]),
    neighbor_distance=st.sampled_from([2.0, 10.0]),
    human_safety_space=st.sampled_from([0.0, 0.25]),
    terminate_on_collision=st.booleans(),
    goal_change_probability_max=st.sampled_from([None, 0.7]),
    reward=st.builds(
        Reward,
        literal=st.booleans(),
        arrival=st.sampled_from([10.0, 25.0]),
        goal_distance=st.sampled_from([0.0, 7.0]),
        time=st.sampled_from([0.0, -0.5]),
    ),
)
# People stand: the twin knows walls as what robots touch, not as what people walk around.
AMONG_WALLS = SCENARIOS.map(
    lambda scenario: replace(scenario, layout=Layout.doorway, crowd=Crowd.still, arena_radius=None)
)
ROOMS = st.sampled_from([1.5, 3.0, 5.5])


def scatter(world: World, seed: int, room: float) -> np.ndarray:
    """Write a random state into the one world of `world`; return random actions."""
    rng, state, scenario = np.random.default_rng(seed), world.state, world.scenario
    n, m, top = scenario.robots, scenario.humans, scenario.robot_speed
    world.reset([seed])
    state.clock[0] = rng.choice([0, 7, 20, scenario.time_limit_steps - 1])
    state.robot_position[0] = rng.uniform(-room, room, (n, 2))
    state.robot_heading[0] = rng.uniform(-np.pi, np.pi, n)
    speed = rng.uniform(0, top, n) * rng.choice([0, 1, 1], n)
    heading = state.robot_heading[0]
    state.robot_velocity[0] = (speed * [np.cos(heading), np.sin(heading)]).T
    near = rng.choice([0.3, 3.0], n)[:, None]
    state.robot_goal[0] = state.robot_position[0] + near * rng.uniform(-1, 1, (n, 2))
    state.arrived[0] = rng.random(n) < 0.25
    if state.arrived[0].all():
        state.arrived[0, 0] = False
    if not scenario.terminate_on_collision:  # some touch since before, some have touched
        state.last_contact[0] = rng.choice([-1, 0, *state.clock], state.last_contact[0].shape)
        state.collision[0] = rng.choice([0, 0, Outcome.hit_human, Outcome.hit_robot], n)
    state.human_position[0] = rng.uniform(-room, room, (m, 2))
    angle, pace = rng.uniform(-np.pi, np.pi, m), rng.uniform(0.5, 1.5, m)
    state.human_velocity[0] = (pace * [np.cos(angle), np.sin(angle)]).T
    state.human_speed[0] = pace
    state.human_radius[0] = rng.uniform(0.2, 0.5, m)
    far = rng.choice([0.4, 6.0], m)[:, None]
    state.human_goal[0] = state.human_position[0] + far * rng.uniform(-1, 1, (m, 2))
    state.human_present[0] = rng.random(m) < rng.choice([0.0, 0.5, 0.8, 1.0])
    actions = rng.uniform(-1, 1, (1, n, scenario.action_size))
    actions[rng.random(actions.shape) < 0.15] = 0.0
    return actions.astype(np.float32)


def well_conditioned(before: dict[str, Any], goal: np.ndarray, scenario: Scenario) -> bool:
    """Whether what the humans choose hardly changes when the state changes by its rounding."""
    rng = np.random.default_rng(0)
    exact = oracle.human_velocities(before, goal, scenario)
    for _ in range(8):
        noisy = dict(before)
        for key in ("human_position", "human_velocity"):
            noisy[key] = before[key] + NOISE * rng.uniform(-1, 1, before[key].shape)
        if np.abs(oracle.human_velocities(noisy, goal, scenario) - exact).max(initial=0) > 5e-5:
            return False
    return True


def check_goals(before: dict[str, Any], after: dict[str, Any], scenario: Scenario) -> None:
    """A goal is redrawn on arrival and, by chance, at every interval; otherwise it stays."""
    interval = round(scenario.goal_change_interval / scenario.time_step)
    by_chance = before["clock"] > 0 and before["clock"] % interval == 0
    absent = ~before["human_present"]
    assert (after["human_goal"] == before["human_goal"])[absent].all()
    for j in np.flatnonzero(before["human_present"]):
        here = before["human_position"][j]
        reached = np.hypot(*(before["human_goal"][j] - here)) < before["human_radius"][j]
        redrawn = (after["human_goal"][j] != before["human_goal"][j]).any()
        if scenario.crowd == Crowd.still:
            assert not redrawn
        elif not by_chance:
            assert redrawn == reached
        elif reached:
            assert redrawn
        if redrawn:
            assert np.hypot(*(after["human_goal"][j] - here)) > scenario.goal_distance - 1e-4


@given(SCENARIOS, SEEDS, ROOMS)
@settings(max_examples=300)
def test_a_step_is_the_twins_step(scenario: Scenario, seed: int, room: float) -> None:
    check_step(scenario, seed, room)


@given(AMONG_WALLS, SEEDS, ROOMS)
@settings(max_examples=120)
def test_a_step_among_walls_is_the_twins_step(scenario: Scenario, seed: int, room: float) -> None:
    check_step(scenario, seed, room)


def check_step(scenario: Scenario, seed: int, room: float) -> None:
    world = World(scenario)
    actions = scatter(world, seed, room)
    before = oracle.snapshot(world.state)
    step = world.step(actions)
    after = oracle.snapshot(world.state)
    assume(well_conditioned(before, after["human_goal"], scenario))
    expected = oracle.step(before, after["human_goal"], actions[0], scenario, after["route_left"])
    assume(expected.margin.smallest > THRESHOLD_MARGIN)

    check_goals(before, after, scenario)
    close = {"rtol": 0, "atol": TOLERANCE}
    np.testing.assert_allclose(after["human_velocity"], expected.human_velocity, **close)
    np.testing.assert_allclose(after["human_position"], expected.human_position, **close)
    np.testing.assert_allclose(after["robot_position"], expected.robot_position, **close)
    np.testing.assert_allclose(after["robot_velocity"], expected.robot_velocity, **close)
    turned = after["robot_heading"] - expected.robot_heading
    np.testing.assert_allclose(np.sin(turned / 2), 0, **close)
    assert (after["arrived"] == expected.arrived).all()
    assert (after["collision"] == expected.collision).all()
    assert (after["last_contact"] == expected.last_contact).all()
    assert (bool(step.terminated[0]), bool(step.truncated[0])) == (
        expected.terminated,
        expected.truncated,
    )
    # -1/d is steep: a tenth of a millimetre at the kink, 0.2 m, is worth 0.0025.
    np.testing.assert_allclose(step.reward[0], expected.reward, rtol=0, atol=5e-3)
    tally = dict(zip(TALLY, after["tally"].T, strict=True))
    for name, added in expected.tally.items():
        np.testing.assert_allclose(tally[name], added, err_msg=name, **close)
    soonest = oracle.soonest_collisions(after, scenario, expected.margin)
    assume(expected.margin.smallest > THRESHOLD_MARGIN)
    soonest[expected.contact == Outcome.hit_human] = 0.0
    soonest[before["arrived"]] = math.inf
    found_soonest = np.minimum(tally["min_time_to_collision"], 10.0)
    np.testing.assert_allclose(found_soonest, np.minimum(soonest, 10.0), rtol=1e-3, atol=1e-3)


@given(SCENARIOS, SEEDS, st.sampled_from([1.5, 5.5]))
@settings(max_examples=300)
def test_an_observation_is_the_twins_observation(
    scenario: Scenario, seed: int, room: float
) -> None:
    world = World(scenario)
    scatter(world, seed, room)
    expected, margin = oracle.observe(oracle.snapshot(world.state), scenario)
    assume(margin.smallest > 1e-5)
    observation = world.observe()
    for name, value in expected.items():
        np.testing.assert_allclose(
            getattr(observation, name)[0], value, rtol=0, atol=1e-5, err_msg=name
        )
