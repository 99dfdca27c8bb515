"""People who react to robots: each way of reacting, by hand; shares, cases and snapshots."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mrsan import (
    CrowdReaction,
    Kinematics,
    Layout,
    Reaction,
    Reactions,
    Scenario,
    World,
)
from mrsan.kernels.social_state import ELAPSED, REACTION

NOBODY = {reaction.name: 0.0 for reaction in Reaction if reaction is not Reaction.blind}


def everybody(reaction: Reaction, **numbers: float) -> dict[str, Any]:
    """The fields of a scenario in which everybody reacts in one way."""
    shares = NOBODY | ({} if reaction is Reaction.blind else {reaction.name: 1.0})
    return {"crowd_reaction": CrowdReaction.mixed, "reactions": Reactions(**shares, **numbers)}


def one_robot(**fields: Any) -> World:
    """A person at the origin who walks along x, and a robot with a goal far away."""
    settings = {
        "robots": 1,
        "humans": 1,
        "kinematics": Kinematics.holonomic,
        "terminate_on_collision": False,
        "goal_change_probability": 0.0,
    }
    world = World(Scenario(**(settings | fields)))
    world.reset([0])
    state = world.state
    state.human_position[0], state.human_velocity[0] = 0.0, 0.0
    state.human_goal[0] = [40.0, 0.0]
    state.robot_goal[0] = [-100.0, 0.0]
    return world


def drive(
    world: World, start: tuple[float, float], velocity: tuple[float, float], steps: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Let the robot drive straight; return the positions of the person and the robot, [T, 2]."""
    state = world.state
    heading = np.arctan2(velocity[1], velocity[0])
    state.robot_position[0], state.robot_velocity[0] = start, velocity
    state.robot_heading[0] = heading
    action = np.float32([[[np.hypot(*velocity), 0.0]]])  # ahead
    people, robots = [], []
    for _ in range(steps):
        world.step(action)
        people.append(state.human_position[0, 0].copy())
        robots.append(state.robot_position[0, 0].copy())
    return np.array(people), np.array(robots)


def test_a_surprised_person_stops_for_a_while() -> None:
    """It notices the robot within 4 m, stands for 2 s = 8 steps, and then walks on."""
    world = one_robot(**everybody(Reaction.surprised, surprised_time=2.0))
    people, robots = drive(world, (12.0, 2.0), (0.0, 0.0), 60)
    speed = np.linalg.norm(np.diff(people, axis=0, prepend=0.0), axis=1) / 0.25
    before = np.concatenate([[[0.0, 0.0]], people[:-1]])
    gap = np.linalg.norm(before - robots, axis=1) - 0.6
    first = int(np.argmax(gap < 4.0))
    assert first > 20
    np.testing.assert_allclose(speed[:first], 1.0, atol=1e-5)
    np.testing.assert_array_equal(speed[first : first + 8], 0.0)
    assert (speed[first + 8 : first + 12] > 0.5).all()


def test_who_looks_the_other_way_does_not_notice_a_robot() -> None:
    world = one_robot(**everybody(Reaction.surprised))
    people, _ = drive(world, (-2.0, 0.0), (0.5, 0.0), 20)
    np.testing.assert_allclose(people[-1], [5.0, 0.0], atol=1e-3)
    assert world.state.human_social[0, 0, ELAPSED] == 0
    all_round = one_robot(**everybody(Reaction.surprised, notice_fov_degrees=360.0))
    people, _ = drive(all_round, (-2.0, 0.0), (0.5, 0.0), 8)
    np.testing.assert_array_equal(people[-1], 0.0)


def test_robots_and_people_do_the_same_share_of_avoiding() -> None:
    """Two people meet as a person and a robot do who both decide by ORCA."""
    two = one_robot(humans=2, crowd_reaction=CrowdReaction.reciprocal)
    state = two.state
    state.robot_position[0] = [50.0, 50.0]
    state.human_position[0], state.human_velocity[0] = [[0, 0], [5, 0.1]], [[1, 0], [-1, 0]]
    state.human_goal[0] = [[40, 0], [-40, 0.1]]
    pair = two.snapshot()
    two.step(np.zeros((1, 1, 2), np.float32))
    one = one_robot(crowd_reaction=CrowdReaction.reciprocal)
    one.state.human_velocity[0] = [1, 0]
    drive(one, (5.0, 0.1), (-1.0, 0.0), 1)
    np.testing.assert_array_equal(one.state.human_velocity[0, 0], state.human_velocity[0, 0])
    # The pair is symmetric about its middle: the other person does the same, mirrored.
    np.testing.assert_allclose(
        state.human_velocity[0, 0], -state.human_velocity[0, 1], rtol=0, atol=1e-5
    )
    assert abs(state.human_velocity[0, 0, 1]) > 0.01
    assert pair.human_velocity[0, 0, 1] == 0.0


def test_reciprocal_is_a_regular_reaction_of_everybody() -> None:
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 1, 3, 3)).astype(np.float32)
    worlds = [
        World(Scenario(crowd_reaction=CrowdReaction.reciprocal)),
        World(Scenario(**everybody(Reaction.regular))),
    ]
    for world in worlds:
        world.reset([3])
        for action in actions:
            world.step(action)
    np.testing.assert_array_equal(worlds[0].state.human_position, worlds[1].state.human_position)


@pytest.mark.parametrize(("robot_x", "noticed"), [(-3.5, True), (1.5, False)])
def test_a_wall_hides_the_robot(robot_x: float, noticed: bool) -> None:
    """The wall between two rooms lies at x = 0; the person is far from the opening."""
    world = one_robot(
        layout=Layout.doorway, **everybody(Reaction.surprised, notice_fov_degrees=360.0)
    )
    state = world.state
    opening = float(state.corners[0, 1].mean())
    y = -4.0 if opening > 0 else 4.0
    state.human_position[0], state.human_goal[0] = [-1.5, y], [-1.5, 0.0]
    drive(world, (robot_x, y), (0.0, 0.0), 1)
    assert bool(state.human_social[0, 0, ELAPSED]) is noticed


def test_reactions_are_drawn_by_the_shares_and_the_case() -> None:
    shares = {"regular": 0.3, "impassive": 0.0, "surprised": 0.2, "curious": 0.1, "scared": 0.1}
    scenario = Scenario(
        robots=1,
        humans=20,
        crowd_reaction=CrowdReaction.mixed,
        circle_radius=9.0,
        reactions=Reactions(**shares, threatening=0.1),
    )
    world = World(scenario)
    kinds = []
    for case in range(100):
        world.reset([case])
        kinds.append(world.state.human_social[0, :, REACTION].copy())
    drawn = np.bincount(np.ravel(kinds), minlength=len(Reaction)) / 2000
    expected = [0.2, 0.3, 0.0, 0.2, 0.1, 0.1, 0.1]  # blind first
    np.testing.assert_allclose(drawn, expected, atol=0.03)
    world.reset([7])
    np.testing.assert_array_equal(world.state.human_social[0, :, REACTION], kinds[7])
