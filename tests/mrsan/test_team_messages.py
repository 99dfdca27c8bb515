"""What robots tell each other: where they are, priority, whether they are through, macro action."""

from dataclasses import replace

import numpy as np

from mrsan import Layout, Scenario, World
from mrsan.kernels.routes import GOAL
from mrsan.se2 import untransform

ROOMS = Scenario(robots=4, humans=12, layout=Layout.rooms, team_messages=True)
WORLDS, STEPS = 16, 24
OTHERS = [[k for k in range(4) if k != i] for i in range(4)]


def played(scenario: Scenario):
    """The messages [E, N, N - 1, 7], their mask, and a copy of the state at every step."""
    world = World(scenario, WORLDS)
    observation = world.reset(np.arange(WORLDS))
    rng = np.random.default_rng(3)
    for step in range(STEPS):
        yield *observation.entities["messages"], observation, world.snapshot()
        world.tell(np.full((WORLDS, 4), step) + np.arange(4))
        action = rng.uniform(-1, 1, (WORLDS, 4, 3)).astype(np.float32)
        observation = world.step(action).observation


def test_messages_hold_the_present() -> None:
    through = []
    for step, (messages, mask, observation, state) in enumerate(played(ROOMS)):
        assert mask.all()
        priority = observation.sensors["priority"][..., 0]
        np.testing.assert_array_equal(messages[..., 4], priority[:, OTHERS])
        assert len(np.unique(priority)) == priority.size
        assert (priority >= 0).all()
        assert (priority < 1).all()
        is_through = (state.route_corner[:, 12:] == GOAL) | state.arrived
        np.testing.assert_array_equal(messages[..., 5] == 1.0, is_through[:, OTHERS])
        through.append(is_through.mean())
        told = np.zeros(4) if step == 0 else step - 1 + np.arange(4)
        expected = np.broadcast_to(told[np.array(OTHERS)], messages[..., 6].shape)
        np.testing.assert_array_equal(messages[..., 6], expected)
        cos, sin = np.cos(state.robot_heading)[..., None], np.sin(state.robot_heading)[..., None]
        own, other = state.robot_position[:, :, None], state.robot_position[:, OTHERS]
        x, y = untransform(cos, sin, *np.moveaxis(own, -1, 0), *np.moveaxis(other, -1, 0))
        np.testing.assert_allclose(messages[..., :2], np.stack([x, y], -1), atol=1e-5)
    assert 0.0 < np.mean(through) < 1.0


def test_delay_range_and_loss_are_those_of_reports() -> None:
    held_back = replace(ROOMS, team_delay=0.5, team_range=6.0, team_loss=0.3)
    received = []
    for step, (messages, mask, _, state) in enumerate(played(held_back)):
        between = state.robot_position[:, :, None] - state.robot_position[:, OTHERS]
        in_range = np.linalg.norm(between, axis=-1) <= 6.0
        assert not mask[~in_range].any()
        assert not messages[~mask].any()
        assert step >= 2 or not mask.any()
        if step >= 2:
            received.append(mask[in_range].mean())
            told = 0 * np.arange(4) if step == 2 else step - 3 + np.arange(4)
            moved = mask & ~state.done[:, None, None]
            expected = np.broadcast_to(told[np.array(OTHERS)], mask.shape)
            np.testing.assert_array_equal(messages[moved][:, 6], expected[moved])
    assert 0.65 < np.mean(received) < 0.75
