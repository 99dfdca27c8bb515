"""The safety shield replaces only actions after which a collision can hardly be avoided."""

import numpy as np
import pytest

from mrsan import Crowd, Kinematics, Observation, Scenario, Split, World
from mrsan.features import GOAL
from samarl.agents import Agent, build_agent
from samarl.configuration import load_agent_config, load_method_config
from samarl.evaluation.runner import run_cases
from samarl.planning.shield import Shield, apply_shield

CASES = Split.test.case(0) + np.arange(40)


def shielded_agent(name: str, scenario: Scenario) -> Agent:
    return build_agent({**load_agent_config(name), "shield": True}, scenario)


@pytest.mark.parametrize("kinematics", Kinematics)
def test_people_who_stand_still_are_never_hit(kinematics: Kinematics) -> None:
    """Predictions are exact then, so a safe action always has a safe successor."""
    scenario = Scenario(robots=1, crowd=Crowd.still, kinematics=kinematics, spawn_jitter=2.0)
    blind = run_cases(
        build_agent(load_agent_config("straight"), scenario), scenario, CASES, batch=40
    )
    safe = run_cases(shielded_agent("straight", scenario), scenario, CASES, batch=40)
    assert blind.hit_human.mean() > 0.2
    assert not safe.hit_human.any()


@pytest.mark.parametrize("fov", [90.0, 360.0])
def test_the_shield_prevents_most_collisions_of_a_blind_planner(fov: float) -> None:
    scenario = Scenario(fov_degrees=fov, robots=5)
    agent = build_agent(load_agent_config("perimeter"), scenario)
    blind = run_cases(agent, scenario, CASES, batch=40)
    safe = run_cases(shielded_agent("perimeter", scenario), scenario, CASES, batch=40)
    assert blind.hit_human.sum() > 2 * safe.hit_human.sum()
    assert not safe.hit_robot.any()


def test_actions_of_arrived_robots_are_not_replaced() -> None:
    scenario = Scenario(robots=1, humans=1)
    world = World(scenario, 1)
    world.reset(CASES[:1])
    state = world.state
    state.human_position[0, 0] = state.robot_position[0, 0] + [0.7, 0.0]
    state.human_velocity[0, 0] = [-1.0, 0.0]
    action = np.zeros((1, 1, 3), np.float32)
    assert (apply_shield(world.observe(), action, scenario, Shield()) != action).any()
    state.robot_goal[0, 0] = state.robot_position[0, 0]
    np.testing.assert_array_equal(apply_shield(world.observe(), action, scenario, Shield()), action)


@pytest.mark.parametrize("name", ["samarl", "samarl_transformer"])
def test_a_configured_shield_equals_a_wrapped_agent(name: str) -> None:
    scenario = Scenario(humans=16, fov_degrees=120.0)
    policy = build_agent(load_agent_config(name), scenario)
    free = build_agent(load_method_config(f"{name} shield=false"), scenario)
    wrapped = shielded_agent(name, scenario)
    world = World(scenario, 30)
    observation = world.reset(CASES[:30])
    replaced = 0
    for _ in range(30):
        action = policy.act(observation)
        np.testing.assert_array_equal(action, wrapped.act(observation))
        replaced += int((action != free.act(observation)).any(-1).sum())
        observation = world.step(action).observation
    assert 0 < replaced < 30 * 30 * 3 / 4


STANDOFFS = {  # starts and goals of each robot, m; a robot that starts at its goal is parked
    "behind somebody parked": ([[0.0, 0.0], [0.75, 0.05]], [[2.4, 0.0], [0.75, 0.05]]),
    "right behind somebody parked": ([[0.0, 0.0], [0.75, 0.0]], [[2.4, 0.0], [0.75, 0.0]]),
    "nearer than the margin": ([[0.0, 0.0], [0.65, 0.0]], [[2.4, 0.0], [0.65, 0.0]]),
    "between two parked": (
        [[0.0, 0.0], [0.8, 0.45], [0.8, -0.5]],
        [[3.0, 0.0], [0.8, 0.45], [0.8, -0.5]],
    ),
    "face to face": ([[-0.38, 0.0], [0.38, 0.0]], [[4.0, 0.0], [-4.0, 0.0]]),
    "three that want to cross": (
        [[0.5, 0.0], [-0.25, 0.433], [-0.25, -0.433]],
        [[-4.0, 0.0], [2.0, -3.464], [2.0, 3.464]],
    ),
}
MEETINGS = ("face to face", "three that want to cross")


def full_speed_to_goal(observation: Observation, scenario: Scenario) -> np.ndarray:
    """Drive at full speed while turning to the goal, ignoring everybody."""
    goal = observation.ego[..., GOAL]
    if scenario.kinematics is Kinematics.holonomic:
        return goal / np.maximum(np.linalg.norm(goal, axis=-1, keepdims=True), np.float32(1e-6))
    bearing = np.arctan2(goal[..., 1], goal[..., 0])
    action = np.zeros((*goal.shape[:2], scenario.action_size), np.float32)
    action[..., 0] = 1.0
    action[..., -1] = np.clip(bearing / scenario.max_turn, -1, 1)
    return action


@pytest.mark.parametrize("standoff", STANDOFFS)
@pytest.mark.parametrize("kinematics", Kinematics)
def test_robots_that_block_each_other_arrive(kinematics: Kinematics, standoff: str) -> None:
    """No robot waits forever in front of another, and none hits another."""
    starts, goals = (np.array(points) for points in STANDOFFS[standoff])
    scales = np.ones(1)
    # Meetings are tried at 50 distances; three holonomic robots may touch at some of them.
    if standoff in MEETINGS[: 1 if kinematics is Kinematics.holonomic else 2]:
        scales = np.linspace(0.61, 1.1, 50) / np.linalg.norm(starts[0] - starts[1])
    scenario = Scenario(robots=len(starts), humans=0, kinematics=kinematics)
    world = World(scenario, len(scales))
    world.reset(CASES[:1] + np.arange(len(scales)))
    state = world.state
    state.robot_position[:], state.robot_goal[:] = scales[:, None, None] * starts, goals
    state.robot_heading[:] = np.arctan2(*(goals - starts).T[::-1])
    observation = world.observe()
    while not (state.terminated | state.truncated).all():
        action = apply_shield(
            observation, full_speed_to_goal(observation, scenario), scenario, Shield()
        )
        observation = world.step(action).observation
    assert state.arrived.all()


@pytest.mark.parametrize("name", ["samarl", "samarl_flat", "perimeter shield=true"])
def test_robots_without_people_arrive(name: str) -> None:
    scenario = Scenario(robots=5, humans=0)
    cases = Split.validation.case(0) + np.arange(40)
    episodes = run_cases(build_agent(load_method_config(name), scenario), scenario, cases, batch=40)
    assert episodes.success.all()
