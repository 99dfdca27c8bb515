"""The planner that knows who goes first through doors and corridors."""

from dataclasses import replace

import numpy as np
import pytest

from mrsan import Split, World
from mrsan.passages import find_passages
from samarl import load_agent, load_scenario
from samarl.agents.agent import act_and_tell
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.evaluation.trajectory import record_episode
from samarl.policies.explanation import ACTIVITIES
from samarl.report.replays import as_replay

NARROW = load_scenario("narrow_doorway", team_messages=True)
CASES = 16


@pytest.mark.parametrize("central", [False, True])
def test_robots_pass_a_door_in_one_direction_at_a_time(central: bool) -> None:
    """Four robots, from both sides: all arrive, and no two meet in the door."""
    agent = load_agent("right_of_way", NARROW, central=central)
    world = World(NARROW, CASES)
    observation = world.reset(Split.validation.case(0) + np.arange(CASES))
    agent.reset(np.ones(CASES, np.bool_))
    state = world.state
    passages = [find_passages(state.walls[e], state.place[e], 1.6) for e in range(CASES)]
    to_the_right = np.sign(state.robot_goal[..., 0])
    assert (to_the_right[:, 0] * to_the_right[:, 1] < 0).any()
    while not state.done.all():
        for e in range(CASES):
            deep = abs(state.robot_position[e, :, 0]) < passages[e].length[0] / 2
            assert len(set(to_the_right[e, deep & ~state.arrived[e]])) <= 1
        observation = world.step(act_and_tell(agent, observation, world)).observation
    assert state.arrived.all(1).sum() >= CASES - 1


def test_robots_wait_beside_a_door_and_tell_so() -> None:
    """Whoever waits stands off the funnel; messages hold the mode and the mouth."""
    agent = load_agent("right_of_way", NARROW)
    world = World(NARROW, CASES)
    observation = world.reset(Split.validation.case(0) + np.arange(CASES))
    agent.reset(np.ones(CASES, np.bool_))
    waited = 0
    for _ in range(60):
        observation = world.step(act_and_tell(agent, observation, world)).observation
        told = world.state.macro_action
        waits = (told % 4 == 1) & ~world.state.arrived & ~world.state.done[:, None]
        stands = np.linalg.norm(world.state.robot_velocity, axis=-1) < 0.05
        for e, i in np.argwhere(waits & stands):
            passages = find_passages(world.state.walls[e], world.state.place[e], 1.6)
            mouth = told[e, i] // 4 - 1
            ahead, aside = passages.relative(mouth, world.state.robot_position[e, i])
            assert ahead > 0.0
            waited += aside > 0.8
    assert waited > 50


def test_late_messages_do_not_move_a_robot_that_is_seen() -> None:
    scenario = load_scenario("doorway", humans=0, robots=2, team_messages=True, team_delay=1.0)
    agent, world = load_agent("right_of_way", scenario), World(scenario, 8)
    assert isinstance(agent, RightOfWay)
    observation = world.reset(Split.validation.case(0) + np.arange(8))
    seen = 0
    for _ in range(40):
        action = act_and_tell(agent, observation, world)
        visible = observation.agents[4][..., 0]
        other = agent.memory.belief[:, [0, 1], [1, 0], :2]
        truth = world.state.robot_position[:, [1, 0]]
        error = np.hypot(*np.moveaxis(other - truth, -1, 0))
        assert (error[visible] < 0.01).all()
        seen += visible.sum()
        observation = world.step(action).observation
    assert seen > 50


def test_without_messages_it_says_so() -> None:
    silent = replace(NARROW, team_messages=False)
    assert "team_messages" in str(load_agent("right_of_way", silent).scope_warning())
    assert load_agent("right_of_way", silent, central=True).scope_warning() is None


def test_a_recorded_episode_says_who_waits_where_and_which_door_it_is() -> None:
    """Who waits drives to a queue place of the mouth that it tells, others to their goals."""
    trajectory = record_episode(load_agent("right_of_way", NARROW), NARROW, Split.test.case(22))
    passages, activity, waypoint = trajectory.passages, trajectory.activity, trajectory.waypoint
    assert activity is not None
    assert waypoint is not None
    places = np.concatenate(passages.places)
    names = [set(np.take(ACTIVITIES, activity[:, i])) for i in range(4)]
    assert set.union(*names) >= {"drives", "waits", "goes"}
    for t, i in np.argwhere((activity == ACTIVITIES.index("waits")) & trajectory.driving[:-1]):
        assert np.linalg.norm(places - waypoint[t, i], axis=-1).min() < 1e-5
    drives = (activity == ACTIVITIES.index("drives")) & trajectory.driving[:-1]
    assert np.abs(waypoint - trajectory.robot_goal)[drives].max() < 1e-3
    replay = as_replay(trajectory)
    assert replay["activities"] == activity.T.tolist()
    np.testing.assert_allclose(np.array(replay["mouths"])[:, :2], passages.mouth, atol=1e-3)
    assert len(replay["queuePlaces"]) == 8  # four at each mouth, where four robots have room
    spread = passages.spread_places(0, 4)
    gap = np.linalg.norm(spread[:, None] - spread, axis=-1)
    assert gap[np.triu_indices(4, 1)].min() > 2 * NARROW.robot_radius
