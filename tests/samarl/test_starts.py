"""Training episodes that do not begin at the start."""

from dataclasses import replace

import numpy as np
import torch

from mrsan import Scenario, World
from samarl.agents.planners.perimeter import Perimeter
from samarl.training.restarts import WarmStartCrowd
from tests.learning import collector, policy

SCENARIO = Scenario(fov_degrees=90.0)


def test_robots_are_put_on_their_way_among_people_who_have_walked() -> None:
    torch.manual_seed(0)
    world, crowd = World(SCENARIO, 64), WarmStartCrowd(SCENARIO, 64, 0)
    for _ in range(40):
        crowd.step()
    world.reset(np.arange(64))
    before = world.state.robot_position.copy()
    chosen = np.arange(64) < 48
    crowd.enter(world, chosen, 8.0)
    state = world.state
    put = (state.robot_position != before).any((1, 2))
    assert 10 < put.sum() < 48  # not where two would stand on each other
    assert not put[48:].any()
    np.testing.assert_allclose(np.linalg.norm(state.robot_position[put], axis=-1), 8.0, rtol=1e-5)
    gap = np.linalg.norm(state.robot_position[:, :, None] - state.robot_position[:, None], axis=-1)
    assert gap[put][:, ~np.eye(3, dtype=np.bool_)].min() > 1.5
    np.testing.assert_array_equal(state.human_goal[put], crowd.world.state.human_goal[put])
    assert (state.human_position[~put] != crowd.world.state.human_position[~put]).any()
    assert state.clock[put].min() > 0
    # They drive on from there: nobody has yet turned round when the blind planner takes over.
    observation = world.observe()
    planner = Perimeter(SCENARIO, radius=8.0, lookahead=0.3, entry_angle=0.15)
    while not state.done.all():
        observation = world.step(planner.act(observation)).observation
    assert not state.truncated.any()
    assert state.arrived[put].all(1).mean() > 0.4


def test_episodes_begin_midway_as_often_as_they_should() -> None:
    torch.manual_seed(0)
    scenario = replace(SCENARIO, robots=1, humans=2, time_limit=1.0)
    going = collector(policy("flat"), 128, 4, scenario, midway_start_probability=0.5)
    going.collect()  # a whole episode
    assert going.is_init.all()
    assert 0.35 < (going.world.state.clock > 0).mean() < 0.65
