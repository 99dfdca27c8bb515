"""Robots in MuJoCo: motors, friction, latency, walls, lidar, and the cases of `mrsan`."""

import dataclasses

import numpy as np
import pytest

from mrsan import Outcome, Scenario, World
from mrsan.features import GOAL, HEADING_COS, HEADING_SIN, ORIGIN
from mrsan.place_shapes import walls_of
from samarl.agents import build_agent
from samarl.configuration import load_agent_config
from samarl.evaluation.runner import run_cases
from samarl.physics.engine import MujocoEngine
from samarl.physics.odometry import Odometry
from samarl.physics.runner import run_physics_cases
from samarl.physics.world import Motion, PhysicsWorld

ALONE = Scenario(robots=1, humans=0)
DRIVES = pytest.mark.parametrize("kinematics", ["acceleration_heading", "holonomic"])
GRAVITY = 9.81


def driven(world: PhysicsWorld, speed: float, decisions: int, case: int = 0) -> np.ndarray:
    """The distance of the first robot from its start after each control period, [T] m."""
    world.reset(case)
    start, distances = world.bodies.position[0].copy(), []
    drive = world.bodies.drive

    def watched(velocities: np.ndarray) -> None:
        drive(velocities)
        distances.append(float(np.linalg.norm(world.bodies.position[0] - start)))

    world.bodies.drive = watched  # type: ignore[method-assign]
    robots = world.scenario.robots
    for _ in range(decisions):
        world.step(Motion(np.full(robots, speed), np.zeros(robots)))
    return np.array(distances)


def test_strong_robots_follow_the_commanded_trajectory_within_centimetres() -> None:
    """From rest to 0.8 m/s in one decision, straight on, then a circle: as `mrsan` would."""
    world = PhysicsWorld(ALONE, MujocoEngine(motor_torque=50.0, friction=2.0))
    distance = driven(world, 0.8, decisions=8)
    assert distance[24] == pytest.approx(0.5 * 0.8 * 0.25, abs=0.01)
    assert distance[-1] == pytest.approx(0.1 + 0.8 * 1.75, abs=0.01)
    heading = world.heading[0]
    for _ in range(8):
        world.step(Motion(np.array([0.8]), np.array([0.2])))
    assert world.heading[0] - heading == pytest.approx(8 * 0.2, abs=0.03)
    assert max(world.tracking_errors) < 0.02


def test_latency_delays_the_response_by_exactly_that() -> None:
    prompt = driven(PhysicsWorld(ALONE, MujocoEngine()), 0.5, decisions=4)
    late = driven(PhysicsWorld(ALONE, MujocoEngine(latency=0.15)), 0.5, decisions=4)
    assert np.abs(late[:15]).max() < 1e-4
    np.testing.assert_allclose(late[15:], prompt[:-15], atol=1e-4)
    assert prompt[14] > 0.01


@DRIVES
def test_the_torque_of_the_motors_bounds_the_acceleration(kinematics: str) -> None:
    """F = torque / radius of two wheels, or of four mecanum wheels; rotors add to the mass."""
    scenario = dataclasses.replace(ALONE, kinematics=kinematics)
    world = PhysicsWorld(scenario, MujocoEngine(motor_torque=0.5, mass=20.0))
    driven(world, 1.0, decisions=2)
    speed = float(np.linalg.norm(world.bodies.velocity[0]))
    wheels = 4 if kinematics == "holonomic" else 2
    limit = 0.5 * wheels * 0.5 / 0.1 / 20.0  # after 0.5 s, m/s
    assert 0.75 * limit < speed < limit


@DRIVES
def test_wheels_slip_on_a_slippery_floor(kinematics: str) -> None:
    """However strong the motors, friction times gravity is the greatest acceleration."""
    scenario = dataclasses.replace(ALONE, kinematics=kinematics)
    world = PhysicsWorld(scenario, MujocoEngine(friction=0.05))
    driven(world, 1.0, decisions=2)
    limit = 0.05 * GRAVITY * 0.5  # after 0.5 s, m/s
    speed = float(np.linalg.norm(world.bodies.velocity[0]))
    assert 0.5 * limit < speed <= 1.02 * limit
    spins = np.abs(world.bodies.data.qvel[6:])
    assert 0.1 * spins.max() > 2.0 * speed


def test_walls_stop_robots() -> None:
    """A robot that drives straight on for 20 s ends at a wall, which it never enters."""
    scenario = Scenario(
        robots=1, humans=0, layout="rooms", terminate_on_collision=False, turn_in_place=False
    )
    world = PhysicsWorld(scenario, MujocoEngine())
    world.reset(3)
    world.world.state.robot_goal[:] = 50.0  # so that it never arrives
    walls = walls_of(world.world.state, 0).astype(float)
    for _ in range(80):
        world.step(Motion(np.array([1.0]), np.array([0.0])))
        assert distance_to(walls, world.bodies.position[0]) > scenario.robot_radius - 0.005
    assert distance_to(walls, world.bodies.position[0]) < scenario.robot_radius + 0.005
    assert world.world.state.collision[0, 0] == Outcome.hit_wall


def distance_to(walls: np.ndarray, point: np.ndarray) -> float:
    start, along = walls[:, :2], walls[:, 2:] - walls[:, :2]
    share = np.clip(((point - start) * along).sum(1) / (along**2).sum(1), 0.0, 1.0)
    return float(np.linalg.norm(start + share[:, None] * along - point, axis=1).min())


def test_rays_are_as_long_as_the_analytic_distances() -> None:
    """Against the kernel of `mrsan`, which intersects rays with segments and discs."""
    scenario = Scenario(
        layout="rooms",
        humans=6,
        lidar_rays=180,
        lidar_noise=0.0,
        lidar_noise_share=0.0,
        lidar_dropout=0.0,
        lidar_targets="all",
    )
    world = PhysicsWorld(scenario, MujocoEngine())
    for case in range(3):
        ranges = world.reset(case).sensors["lidar"][0]
        expected = world.world.observe().sensors["lidar"][0]
        error = np.abs(ranges - expected)
        assert (error < 0.005).mean() > 0.99  # others graze an edge
        assert np.median(error) < 0.0011  # half the thickness of a wall with floor on both sides
        assert (expected < scenario.lidar_range).mean() > 0.9


def test_a_case_starts_as_in_mrsan_and_its_people_walk_as_there() -> None:
    scenario = Scenario(terminate_on_collision=False, goal_change_probability=0.9)
    world, expected = PhysicsWorld(scenario, MujocoEngine()), World(scenario)
    observation, beginning = world.reset(41), expected.reset([41])
    for name, array in beginning.arrays().items():
        np.testing.assert_array_equal(observation.arrays()[name], array, name)
    np.testing.assert_allclose(world.bodies.position, expected.state.robot_position[0], atol=1e-6)
    for _ in range(24):
        world.step(Motion(np.full(3, 0.7), np.full(3, 0.1)))
        expected.step(np.zeros((1, 3, 3), np.float32))
        for name in ("human_position", "human_velocity", "human_goal"):
            people = getattr(world.world.state, name)
            np.testing.assert_array_equal(people, getattr(expected.state, name), name)
        capsules = world.bodies.data.mocap_pos[:, :2]
        np.testing.assert_allclose(capsules, expected.state.human_position[0], atol=1e-5)


def test_odometry_drifts_with_the_distance_and_moves_only_what_follows_from_the_pose() -> None:
    odometry = Odometry(0.05, 7, np.zeros((2, 2)))
    for k in range(1, 101):
        odometry.update(np.array([[0.1 * k, 0.0], [0.0, 0.0]]))  # the second robot stands
    assert odometry.heading_error[1] == 0.0
    assert odometry.position[1].tolist() == [0.0, 0.0]
    turn = odometry.heading_error[0]
    assert 0.0 < abs(turn) < 2.0  # 0.05 rad per metre is one standard deviation
    # An arc of constant curvature, stretched: its chord is shorter by sin(x) / x.
    chord = np.linalg.norm(odometry.position[0])
    scale = chord / (10.0 * np.sinc(turn / 2 / np.pi))
    assert 0.8 < scale < 1.2
    assert np.arctan2(*odometry.position[0][::-1]) == pytest.approx(turn / 2, abs=0.01)


def test_a_robot_looks_for_its_goal_where_its_odometry_says() -> None:
    scenario = Scenario(humans=3, terminate_on_collision=False)
    world = PhysicsWorld(scenario, MujocoEngine(odometry_drift=0.1))
    world.reset(0)
    for _ in range(12):
        observation = world.step(Motion(np.full(3, 1.0), np.zeros(3)))
    true, odometry = world.world.observe(), world._odometry
    np.testing.assert_array_equal(observation.humans, true.humans)
    ego = observation.ego[0].astype(float)
    heading = np.arctan2(ego[:, HEADING_SIN], ego[:, HEADING_COS])
    cos, sin = np.cos(heading), np.sin(heading)
    rotation = np.stack([np.stack([cos, -sin], -1), np.stack([sin, cos], -1)], -2)
    position = -(rotation @ ego[:, ORIGIN, None])[..., 0]
    np.testing.assert_allclose(position, odometry.position, atol=1e-4)
    goal = position + (rotation @ ego[:, GOAL, None])[..., 0]
    np.testing.assert_allclose(goal, world.world.state.robot_goal[0], atol=1e-4)
    assert np.abs(odometry.position - world.bodies.position).max() > 0.05


def test_an_exported_policy_arrives_and_every_run_has_the_same_bits() -> None:
    agent = build_agent(load_agent_config("samarl_flat"), Scenario())
    engine, cases = MujocoEngine(latency=0.05), np.array([10**6 + 1])
    first, second = (run_physics_cases(agent, engine, cases, "samarl_flat") for _ in range(2))
    assert first.episodes.success.all()
    assert 0.0 < first.tracking_error < 0.03
    for name in first.episodes._fields:
        values = getattr(first.episodes, name)
        np.testing.assert_array_equal(values, getattr(second.episodes, name), name)


@DRIVES
def test_a_planner_drives_as_in_mrsan(kinematics: str) -> None:
    """Straight on until they meet: the same outcome, at most one step sooner or later."""
    scenario = Scenario(humans=0, robots=2, kinematics=kinematics)
    agent = build_agent(load_agent_config("straight"), scenario)
    cases = np.arange(3)
    episodes = run_physics_cases(agent, MujocoEngine(), cases, "straight").episodes
    expected = run_cases(agent, scenario, cases, 3)
    np.testing.assert_array_equal(episodes.outcome, expected.outcome)
    np.testing.assert_allclose(episodes.duration, expected.duration, atol=0.25)
    np.testing.assert_allclose(episodes.path_length, expected.path_length, atol=0.25)
