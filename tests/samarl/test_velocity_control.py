"""Actions retargeted to robots of other kinematics track the same velocities."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mrsan import ConfigurationError, Kinematics, Scenario, World
from mrsan.features import HEADING_COS, HEADING_SIN, VELOCITY
from mrsan.parameters import kernel_parameters
from samarl.agents import build_agent
from samarl.agents.learned import Learned
from samarl.configuration import load_agent_config
from samarl.planning.velocity_control import retarget_actions, stop_fully

ALONE = Scenario(robots=1, humans=0)


def moved(world: World, action: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities [E, N, 2] in the previous body frame and turns [E, N] of one step."""
    before = world.observe().ego
    after = world.step(action).observation.ego
    cos = before[..., HEADING_COS] * after[..., HEADING_COS]
    cos += before[..., HEADING_SIN] * after[..., HEADING_SIN]
    sin = before[..., HEADING_COS] * after[..., HEADING_SIN]
    sin -= before[..., HEADING_SIN] * after[..., HEADING_COS]
    x, y = after[..., VELOCITY][..., 0], after[..., VELOCITY][..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], -1), np.arctan2(sin, cos)


@pytest.mark.parametrize("own", Kinematics)
def test_a_holonomic_robot_reproduces_the_motion_of_any_other(own: Kinematics) -> None:
    """It can reach every velocity, so both worlds agree, including turns in place."""
    source, target = replace(ALONE, kinematics=own), replace(ALONE, kinematics=Kinematics.holonomic)
    rng = np.random.default_rng(0)
    one, other = World(source, 50), World(target, 50)
    one.reset(range(50))
    other.reset(range(50))
    for _ in range(8):
        action = rng.uniform(-1, 1, (50, 1, source.action_size)).astype(np.float32)
        ego = other.observe().ego
        tracked = retarget_actions(
            ego, action, kernel_parameters(source), kernel_parameters(target)
        )
        assert np.abs(tracked).max() <= 1.0
        expected, turn = moved(one, action)
        velocity, turned = moved(other, tracked)
        np.testing.assert_allclose(
            velocity, expected, atol=2e-3
        )  # it creeps while turning in place
        drives = np.linalg.norm(expected, axis=-1) > 1e-3
        standing = ~drives & (np.linalg.norm(velocity, axis=-1) > 0)
        for mask in (drives, standing):
            np.testing.assert_allclose(turned[mask], turn[mask], atol=1e-3)


def test_a_robot_with_limits_tracks_the_velocity_within_them() -> None:
    """By hand: start moving; a quarter turn to the left at full speed; brake to half speed."""
    own = kernel_parameters(replace(ALONE, kinematics=Kinematics.holonomic))
    here = kernel_parameters(ALONE)
    ego = np.zeros((1, 3, 11), np.float32)
    ego[..., HEADING_COS] = 1.0
    ego[0, 1, VELOCITY.start] = 1.0
    ego[0, 2, VELOCITY.start] = 1.0
    action = np.array([[[1.0, 0.0], [0.0, 1.0], [0.5, 0.0]]], np.float32)
    tracked = retarget_actions(ego, action, own, here)
    # 1 m/s in 0.25 s is 4 of 5 m/s^2; a sharp turn is made in place; 0.5 m/s less is -2 of 5.
    np.testing.assert_allclose(tracked[0], [[0.8, 0, 0], [-0.8, 0, 1], [-0.4, 0, 0]], atol=1e-6)
    gentle = np.array([[math.cos(0.1), math.sin(0.1)]] * 3, np.float32)[None]
    turn = 0.1 / math.radians(15.0)
    np.testing.assert_allclose(
        retarget_actions(ego, gentle, own, here)[0, 1], [0, 0, turn], atol=1e-5
    )


def test_a_robot_that_would_creep_stops_and_turns_in_place() -> None:
    """A robot at 0.04 m/s that asks for a turn of 15 degrees, three times."""
    world = World(ALONE, 1)
    world.reset([0])
    ask = np.array([[[0.0, 0.0, 1.0]]], np.float32)
    start = float(world.state.robot_heading[0, 0])
    for stop_speed, turned in ((0.0, 1.7), (0.1, 45.0)):
        world.state.robot_heading[0, 0] = start
        world.state.robot_velocity[0, 0] = 0.04 * math.cos(start), 0.04 * math.sin(start)
        for _ in range(3):
            world.step(stop_fully(ask, world.observe().ego, stop_speed, ALONE))
        turn = math.degrees(float(world.state.robot_heading[0, 0]) - start)
        # In motion the turning radius of 1 m allows 0.04 m/s x 0.25 s / 1 m = 0.57 degrees a step.
        assert math.remainder(turn - turned, 360.0) == pytest.approx(0.0, abs=0.1)
    ego = world.observe().ego
    drives = np.array([[[0.2, 0.0, 1.0]]], np.float32)  # to 0.25 m/s
    assert (stop_fully(drives, ego, 0.1, ALONE) == drives).all()
    aside = np.array([[[0.0, 0.1, 1.0]]], np.float32)  # 0.125 m/s to the side
    assert (stop_fully(aside, ego, 0.1, ALONE) == aside).all()
    own = replace(ALONE, kinematics=Kinematics.holonomic)
    assert (stop_fully(drives[..., :2] * 0, ego, 0.1, own) == 0).all()


def test_a_policy_drives_other_robots_only_with_track_velocity() -> None:
    config = load_agent_config("msa3cpred")
    with pytest.raises(
        ConfigurationError,
        match=r"scenario\.kinematics is acceleration_heading; .*agent\.track_velocity",
    ):
        build_agent(config, ALONE)
    agent = build_agent({**config, "track_velocity": True}, ALONE)
    assert isinstance(agent, Learned)
    assert agent.kinematics_mismatch
    agent.reset(np.ones(4, np.bool_))
    action = agent.act(World(ALONE, 4).reset(range(4)))
    assert action.shape == (4, 1, 3)
    assert action[..., 0].max() > 0.5  # it starts moving
    own = replace(ALONE, kinematics=Kinematics.holonomic)
    same_kinematics = build_agent({**config, "track_velocity": True}, own)
    assert isinstance(same_kinematics, Learned)
    assert not same_kinematics.kinematics_mismatch
