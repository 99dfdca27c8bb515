"""What a robot cannot see changes not one bit of what it knows."""

import numpy as np
import pytest
from staging import stage

from mrsan import Observation, Scenario, World

WORLDS = 60
RANGE = 4.0


def bits_of_robot(observation: Observation, robot: int) -> bytes:
    arrays = observation.arrays().values()
    return b"".join(np.ascontiguousarray(array[:, robot]).tobytes() for array in arrays)


def hide(world: World, rng: np.random.Generator, fov_degrees: float) -> np.ndarray:
    """Places outside the view of robot 0 in each world: behind its edges, or too far, [E, 2]."""
    state, half = world.state, np.radians(fov_degrees) / 2
    outside = half + 0.01 + rng.uniform(0, 1, WORLDS) * (np.pi - half - 0.01)
    too_far = rng.random(WORLDS) < (1.0 if fov_degrees == 360 else 0.3)
    bearing = np.where(too_far, rng.uniform(0, np.pi, WORLDS), outside)
    bearing = state.robot_heading[:, 0] + bearing * rng.choice([-1, 1], WORLDS)
    distance = np.where(too_far, RANGE + 0.01, 0.0) + rng.uniform(0.01, 6, WORLDS)
    way = np.stack([np.cos(bearing), np.sin(bearing)], -1)
    return state.robot_position[:, 0] + distance[:, None] * way


@pytest.mark.parametrize("fov_degrees", [1.0, 90.0, 270.0, 360.0])
@pytest.mark.parametrize("kind", ["human", "robot"])
def test_an_agent_outside_the_view_can_be_anything_anywhere(kind: str, fov_degrees: float) -> None:
    rng = np.random.default_rng(7)
    scenario = Scenario(
        robots=3, humans=4, humans_min=3, fov_degrees=fov_degrees, sensing_range=RANGE
    )
    world = World(scenario, WORLDS)
    world.reset(np.arange(WORLDS))
    state = world.state
    state.robot_position[:] = rng.uniform(-2, 2, state.robot_position.shape)
    state.human_position[:] = rng.uniform(-2, 2, state.human_position.shape)
    unseen = 1  # this human, or robot, is the one that is tampered with
    getattr(state, f"{kind}_position")[:, unseen] = hide(world, rng, fov_degrees)
    expected = bits_of_robot(world.observe(), 0)
    visible = world.observe()
    slots = visible.humans_visible[:, 0, 1] if kind == "human" else visible.robots_visible[:, 0, 0]
    assert not slots.any()
    assert visible.humans_visible[:, 0].any() == (fov_degrees > 1)  # it does see somebody
    for _ in range(5):
        getattr(state, f"{kind}_position")[:, unseen] = hide(world, rng, fov_degrees)
        getattr(state, f"{kind}_velocity")[:, unseen] = rng.normal(0, 3, (WORLDS, 2))
        if kind == "human":
            state.human_radius[:, unseen] = rng.uniform(0.1, 2, WORLDS)
        else:
            state.robot_heading[:, unseen] = rng.uniform(-3, 3, WORLDS)
            state.arrived[:, unseen] = rng.random(WORLDS) < 0.5
        assert bits_of_robot(world.observe(), 0) == expected


def test_goals_speeds_and_headings_of_others_are_private() -> None:
    world = World(Scenario(robots=3, humans=5), WORLDS)
    world.reset(np.arange(WORLDS))
    expected = bits_of_robot(world.observe(), 0)
    state = world.state
    state.human_goal[:] += 1
    state.human_speed[:] *= 2
    state.robot_goal[:, 1:] += 1
    state.robot_heading[:, 1:] += 1
    state.arrived[:, 1:] = True
    assert bits_of_robot(world.observe(), 0) == expected


def test_slots_of_absent_humans_are_empty() -> None:
    world = World(Scenario(robots=1, humans=6, sensing_range=20.0), WORLDS)
    world.reset(np.arange(WORLDS))
    here = np.array([False, True, False, True, True, False])
    world.state.human_present[:] = here
    observation = world.observe()
    assert (observation.humans_visible[:, 0] == here).all()
    assert not observation.humans[:, 0, ~here].any()
    expected = bits_of_robot(observation, 0)
    world.state.human_position[:, ~here] = 0.5
    assert bits_of_robot(world.observe(), 0) == expected


@pytest.mark.parametrize("blocker", ["human", "robot"])
def test_an_agent_in_the_shadow_of_another_is_hidden(blocker: str) -> None:
    """At 2 m a radius of 0.3 m covers asin(0.15), 8.6 degrees to each side."""
    robots = [(0, 0, 0, 0, 9, 9), (-5, -5, 0, 0, 9, 9)]
    humans = [(4, 0, 0, 0), (-5, 5, 0, 0)]
    if blocker == "human":
        humans[1] = (2, 0, 0, 0)
    else:
        robots[1] = (2, 0, 0, 0, 9, 9)
    world = stage(robots, humans, occlusion=True)
    rng = np.random.default_rng(3)
    expected = bits_of_robot(world.observe(), 0)
    for distance in (2.1, 3.0, 9.9):
        for degrees in (-8.5, -3.0, 0.0, 8.5):
            angle = np.radians(degrees)
            place = distance * np.array([np.cos(angle), np.sin(angle)])
            world.state.human_position[0, 0] = place
            world.state.human_velocity[0, 0] = rng.normal(0, 1, 2)
            world.state.human_radius[0, 0] = rng.uniform(0.3, 0.5)
            observation = world.observe()
            assert not observation.humans_visible[0, 0, 0]
            assert bits_of_robot(observation, 0) == expected
    edge = np.radians(8.7)
    for seen in ((4 * np.cos(edge), 4 * np.sin(edge)), (1.5, 0.0), (-4.0, 0.0)):
        world.state.human_position[0, 0] = seen
        assert world.observe().humans_visible[0, 0, 0]
