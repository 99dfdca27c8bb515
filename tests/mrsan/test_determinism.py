"""A case is the same to the last bit, whoever is simulated beside it."""

import numba
import numpy as np
import pytest

from mrsan import Crowd, CrowdReaction, Groups, Reward, Scenario, World

CASES, STEPS, ROBOTS = 500, 25, 3
SCENARIOS = {
    "orca": Scenario(robots=ROBOTS, humans=10),
    "everything": Scenario(
        robots=ROBOTS,
        humans=12,
        humans_min=2,
        fov_degrees=120.0,
        occlusion=True,
        position_noise=0.1,
        velocity_noise=0.2,
        missed_detection=0.1,
        crowd_reaction=CrowdReaction.reciprocal,
        human_radius_max=0.5,
        human_speed_max=1.5,
        goal_change_interval=1.0,
        arena_radius=7.0,
    ),
    "social force": Scenario(robots=ROBOTS, humans=6, crowd=Crowd.social_force),
    "reactions and groups": Scenario(
        robots=ROBOTS,
        humans=12,
        humans_min=2,
        crowd_reaction=CrowdReaction.mixed,
        groups=Groups(share=0.7, standing_share=0.3),
    ),
    "collisions counted": Scenario(
        robots=ROBOTS,
        humans=12,
        terminate_on_collision=False,
        radius_noise=0.1,
        goal_change_interval=1.0,
        goal_change_probability=0.0,
        goal_change_probability_max=1.0,
        goal_rotation_range_degrees=180.0,
        reward=Reward(goal_distance=1.0, time=-0.001),
    ),
}
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (STEPS, CASES, ROBOTS, 3)).astype(np.float32)


def play(scenario: Scenario, cases: np.ndarray) -> list[np.ndarray]:
    """Everything that happens in some cases, one row per world and quantity."""
    world = World(scenario, len(cases))
    observations = [world.reset(cases)]
    rewards = []
    for t in range(STEPS):
        step = world.step(ACTIONS[t, cases])
        observations.append(step.observation)
        rewards.append(step.reward)
    seen = [
        np.stack(parts, 1)
        for parts in zip(*(o.arrays().values() for o in observations), strict=True)
    ]
    return [*seen, np.stack(rewards, 1), *world.state]


@pytest.fixture(scope="module", params=SCENARIOS)
def played(request: pytest.FixtureRequest) -> tuple[Scenario, list[np.ndarray]]:
    scenario = SCENARIOS[request.param]
    return scenario, play(scenario, np.arange(CASES))


def assert_rows(a: list[np.ndarray], rows: np.ndarray, b: list[np.ndarray]) -> None:
    for whole, part in zip(a, b, strict=True):
        np.testing.assert_array_equal(whole[rows], part)


def test_alone_or_among_five_hundred(played: tuple[Scenario, list[np.ndarray]]) -> None:
    scenario, everything = played
    for case in (0, 77, 499):
        assert_rows(everything, np.array([case]), play(scenario, np.array([case])))


def test_in_any_order_and_number(played: tuple[Scenario, list[np.ndarray]]) -> None:
    scenario, everything = played
    order = np.random.default_rng(1).permutation(CASES)[:123]
    assert_rows(everything, order, play(scenario, order))


def test_on_one_thread_or_two(played: tuple[Scenario, list[np.ndarray]]) -> None:
    scenario, everything = played
    numba.set_num_threads(2)
    assert_rows(everything, np.arange(CASES), play(scenario, np.arange(CASES)))


def test_noise_differs_from_step_to_step_and_from_robot_to_robot() -> None:
    scenario = Scenario(robots=2, humans=1, crowd=Crowd.still, position_noise=0.1)
    world = World(scenario, 1)
    world.reset([0])
    world.state.robot_position[0] = 0, 0
    world.state.robot_heading[0] = 0
    first = world.observe().humans[0, :, 0, :2]
    second = world.step(np.zeros((1, 2, 3))).observation.humans[0, :, 0, :2]
    assert len(np.unique(np.concatenate([first, second]).ravel())) == 8
    np.testing.assert_array_equal(world.observe().humans[0, :, 0, :2], second)  # a pure function
