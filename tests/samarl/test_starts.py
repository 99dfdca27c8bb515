"""Training episodes that do not begin at the start."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from samarl.training.rollout import RETRY_STEPS, Rollout
from samarl.training.starts import Crowd

from mrsan import Scenario, World
from samarl.agents.planners.perimeter import Perimeter
from samarl.policies.hierarchical import Architecture, HierarchicalPolicy
from samarl.training.curriculum import Group

SCENARIO = Scenario(fov_degrees=90.0)


def test_robots_are_put_on_their_way_among_people_who_have_walked() -> None:
    torch.manual_seed(0)
    world, crowd = World(SCENARIO, 64), Crowd(SCENARIO, 64, 0)
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


def test_the_crowd_walks_on_when_its_time_is_over() -> None:
    crowd = Crowd(replace(SCENARIO, humans=3), 4, 0)
    crowd.world.state.clock[:2] = crowd.world.scenario.time_limit / SCENARIO.time_step - 1
    crowd.step()
    assert crowd.world.state.clock.tolist() == [0, 0, 1, 1]
    for _ in range(3):
        crowd.step()
    assert crowd.world.state.clock.tolist() == [3, 3, 4, 4]
    assert not crowd.world.state.done.any()


def test_a_collision_is_tried_again_from_shortly_before() -> None:
    torch.manual_seed(0)
    scenario = replace(SCENARIO, fov_degrees=360.0, circle_radius=4.0)
    rollout = Rollout(
        Group(32, retried_share=1.0, scenario=scenario), tiny_policy(), 1, 0, 0.98, 0.5
    )
    state, again = rollout.world.state, 0
    for _ in range(40):
        before = [array.copy() for array in rollout._remembered()]
        kept = [[array.copy() for array in arrays] for arrays in rollout.past.kept]
        age = rollout.age.copy()
        rollout.collect()
        back = rollout.began & ~rollout.fresh
        for e in np.flatnonzero(back):  # as it was at one of the last steps of this episode
            assert age[e] >= 1
            past = [*kept, before][-RETRY_STEPS:]
            backs = range(1, min(int(age[e]) + 1, RETRY_STEPS) + 1)
            steps = [k for k in backs if same(past[-k], rollout._remembered(), e)]
            assert steps, (e, age[e])
            again += 1
        begun = rollout.began & rollout.fresh
        assert (state.clock[begun] == 0).all()
        assert not state.done.any()
        assert (state.collision == 0).all()
    assert again > 10


def test_exploration_keeps_its_direction_for_a_while() -> None:
    torch.manual_seed(0)
    policy = tiny_policy()
    with torch.no_grad():
        policy.local_actor.body[-1].weight.zero_()
    rollout = Rollout(
        Group(64, noise_correlation=0.75, scenario=SCENARIO), policy, 40, 0, 0.98, 0.5
    )
    actor = policy.local_actor
    noise = (rollout.collect().steps.action - actor.body[-1].bias) / actor.log_deviation.exp()
    assert noise.mean().item() == pytest.approx(0.0, abs=0.05)
    assert noise.square().mean().item() == pytest.approx(1.0, abs=0.05)
    assert (noise[:, 1:] * noise[:, :-1]).mean().item() == pytest.approx(0.75, abs=0.05)
    assert (noise[:, :, 1:] * noise[:, :, :-1]).mean().item() == pytest.approx(0.0, abs=0.05)


def same(one: list[np.ndarray], other: list[np.ndarray], e: int) -> bool:
    """Whether two memories agree on world `e`."""
    return all(np.array_equal(a[e], b[e]) for a, b in zip(one, other, strict=True))


def tiny_policy() -> HierarchicalPolicy:
    """An untrained policy."""
    architecture = Architecture(
        actors=1, width=8, heads=1, history=2, features=8, hidden=8, macro_steps=4, levels=2,
        round_below=180.0, round_radius=8.0, waypoint_ahead=2.0, waypoint_range=2.0, track_steps=4,
    )  # fmt: skip
    return HierarchicalPolicy(architecture, 3)
