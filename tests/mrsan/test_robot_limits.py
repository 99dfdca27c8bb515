"""SAMARL, Eq. 1-3: what no action can make a robot do."""

import math

import numpy as np
import pytest

from mrsan import Kinematics, Scenario, State, World

WORLDS, STEPS = 200, 120
ROUNDING = 2e-5


def driven(state: State) -> list[np.ndarray]:
    """Position, velocity and heading of the one robot of each world, copied."""
    arrays = (state.robot_position, state.robot_velocity, state.robot_heading)
    return [array[:, 0].copy() for array in arrays]


def drive(scenario: Scenario):
    """Yield (position, velocity, heading) before and after each of many random steps."""
    rng = np.random.default_rng(5)
    world = World(scenario, WORLDS)
    world.reset(np.arange(WORLDS))
    state = world.state
    state.robot_goal[:] = 500.0  # nobody arrives
    for step in range(STEPS):
        before = driven(state)
        action = rng.uniform(-1, 1, (WORLDS, 1, scenario.action_size))
        if step % 2:  # the corners, held: standing, full throttle, full lock
            action = np.round(action)
        world.step(action)
        yield before, driven(state)
    assert not state.terminated.any()


@pytest.mark.parametrize("max_acceleration", [0.4, 1.5, 5.0])
@pytest.mark.parametrize("turn_in_place", [True, False])
def test_eq_3_holds_for_every_action(max_acceleration: float, turn_in_place: bool) -> None:
    scenario = Scenario(
        robots=1,
        humans=0,
        robot_speed=0.8,
        max_acceleration=max_acceleration,
        turn_in_place=turn_in_place,
        time_limit=1000.0,
    )
    dt, max_turn = scenario.time_step, math.radians(scenario.max_turn_rate * scenario.time_step)
    tightest = greatest = standing_turns = 0.0
    for (p, v, heading), (p2, v2, heading2) in drive(scenario):
        speed, speed2 = np.hypot(*v.T), np.hypot(*v2.T)
        turn = np.abs(np.angle(np.exp(1j * (heading2.astype(float) - heading))))
        ahead = np.stack([np.cos(heading2), np.sin(heading2)], -1)
        moving = speed2 > 0
        assert (speed2 <= scenario.robot_speed + ROUNDING).all()
        assert (np.abs(speed2 - speed) <= max_acceleration * dt + ROUNDING).all()
        np.testing.assert_allclose((v2 * ahead).sum(-1), speed2, atol=ROUNDING)  # never backwards
        limit = np.minimum(max_turn, dt * speed2 / scenario.min_turning_radius)
        assert (turn[moving] <= limit[moving] + ROUNDING).all()
        assert (turn[~moving] <= max_turn * turn_in_place + ROUNDING).all()
        np.testing.assert_allclose(p2, p + (v + v2) / 2 * dt, atol=ROUNDING)  # Eq. 1
        if moving.any():
            tightest = max(tightest, (turn[moving] / limit[moving]).max())
        greatest = max(greatest, speed2.max())
        standing_turns = max(standing_turns, turn[~moving].max(initial=0))
    # The limits were reached, so the tests above did meet them.
    assert tightest == pytest.approx(1, abs=1e-3)
    assert greatest == pytest.approx(0.8, abs=1e-4)
    assert standing_turns == pytest.approx(max_turn * turn_in_place, abs=1e-3)


def test_longitudinal_and_lateral_acceleration_share_one_disc() -> None:
    """Full ahead and full left is a_max at 45 degrees: dv = 0.4 * 0.25 / sqrt(2) each."""
    scenario = Scenario(
        robots=1, humans=0, max_acceleration=0.4, min_turning_radius=0.001, max_turn_rate=720
    )
    world = World(scenario)
    world.reset([0])
    world.state.robot_heading[0] = 0
    world.step([[[1, 1, 0]]])
    np.testing.assert_allclose(world.state.robot_velocity[0, 0], 0.1 / math.sqrt(2), rtol=1e-5)
    assert world.state.robot_heading[0, 0] == pytest.approx(math.pi / 4, abs=1e-5)


@pytest.mark.parametrize("kinematics", [Kinematics.holonomic, Kinematics.unicycle])
def test_the_simple_models_keep_the_speed_limit(kinematics: Kinematics) -> None:
    scenario = Scenario(
        robots=1, humans=0, kinematics=kinematics, robot_speed=0.8, time_limit=1000.0
    )
    greatest = 0.0
    for (p, _, heading), (p2, v2, heading2) in drive(scenario):
        greatest = max(greatest, np.hypot(*v2.T).max())
        np.testing.assert_allclose(p2, p + v2 * scenario.time_step, atol=ROUNDING)
        if kinematics is Kinematics.unicycle:
            turn = np.abs(np.angle(np.exp(1j * (heading2.astype(float) - heading))))
            assert (turn <= math.radians(15) + ROUNDING).all()
    assert greatest == pytest.approx(0.8, abs=1e-4)


def test_a_holonomic_action_is_a_velocity_in_the_body_frame() -> None:
    """Facing north, half speed to the left is half a metre per second to the west."""
    world = World(Scenario(robots=1, humans=0, kinematics=Kinematics.holonomic))
    world.reset([0])
    world.state.robot_heading[0] = math.pi / 2
    world.step([[[0, 0.5]]])
    np.testing.assert_allclose(world.state.robot_velocity[0, 0], [-0.5, 0], atol=1e-6)
    assert world.state.robot_heading[0, 0] == pytest.approx(math.pi)


def test_a_unicycle_action_is_a_speed_and_a_turn() -> None:
    world = World(Scenario(robots=1, humans=0, kinematics=Kinematics.unicycle))
    world.reset([0])
    world.state.robot_heading[0] = 0
    world.step([[[0, 1]]])  # half of the speed range, 15 degrees to the left
    np.testing.assert_allclose(
        world.state.robot_velocity[0, 0],
        [0.5 * math.cos(math.pi / 12), 0.5 * math.sin(math.pi / 12)],
        rtol=1e-5,
    )


@pytest.mark.parametrize("kinematics", Kinematics)
def test_the_arena_wall_stops_robots(kinematics: Kinematics) -> None:
    scenario = Scenario(robots=1, humans=0, arena_radius=6.1, kinematics=kinematics)
    world = World(scenario, WORLDS)
    world.reset(np.arange(WORLDS))
    state = world.state
    state.robot_goal[:] = 500.0
    ahead = {2: [1, 0], 3: [1, 0, 0]}[scenario.action_size]
    for _ in range(60):
        world.step(np.broadcast_to(ahead, (WORLDS, 1, scenario.action_size)))
        distance = np.hypot(*state.robot_position[:, 0].T)
        assert (distance <= 6.1 - 0.3 + 1e-5).all()
    np.testing.assert_allclose(distance, 5.8, atol=1e-5)
    assert not state.robot_velocity.any()
