"""Critics: their scale, and what they see."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from mrsan import World
from samarl.algorithms.critics import PopArtHead
from samarl.observations.features import state_of
from samarl.policies.policy import LOCAL
from tests import learning
from tests.learning import SCENARIO


def test_a_new_scale_changes_no_value() -> None:
    torch.manual_seed(0)
    head, inputs = PopArtHead(5, 8), torch.randn(20, 5)
    for round_ in range(5):
        before = head.denormalise(head(inputs)).detach()
        old = before.clone()  # as it is kept until the update
        head.update(100.0 * round_ + (3.0 + 7.0 * round_) * torch.randn(50))
        after = head.denormalise(head(inputs))
        torch.testing.assert_close(after, before, atol=1e-3, rtol=1e-4)
        # Clipping begins where the value is: its normalised self is the head's own output.
        torch.testing.assert_close(head.normalise(old), head(inputs), atol=1e-4, rtol=1e-4)


def test_the_scale_is_that_of_the_targets() -> None:
    head = PopArtHead(5, 8)
    for _ in range(50):
        head.update(torch.tensor([10.0, 30.0]))
    assert head.normalise(torch.tensor([10.0, 20.0, 30.0])).tolist() == pytest.approx(
        [-1.0, 0.0, 1.0], abs=1e-4
    )


def test_a_value_is_not_led_further_than_the_clip() -> None:
    learner = learning.algorithm(learning.policy("flat"), clip_epsilon=0.2)
    head = learner.critics[LOCAL]
    with torch.no_grad():
        head.last.weight.zero_()
        head.last.bias.fill_(1.5)
    size = learner.config.critic_features
    numbers = {"critic_features": torch.zeros(1, size), "state_value": torch.ones(1, 1)}
    samples = TensorDict({**numbers, "value_target": torch.full((1, 1), 3.0)}, [1])
    loss = learner.losses[LOCAL].loss_critic(samples)[0].mean()
    assert loss.item() == pytest.approx((3.0 - 1.2) ** 2)
    loss.backward()
    assert head.last.bias.grad is not None
    assert head.last.bias.grad.item() == 0.0


def test_critics_see_everybody_with_their_goals() -> None:
    world = World(replace(SCENARIO, fov_degrees=30.0, sensing_range=1.0), 3)
    world.reset([0, 1, 2])
    state = state_of(world)
    assert state.humans_known.all()
    assert state.robots_known.all()
    goals = torch.linalg.vector_norm(state.humans[:, 0, :, 9:11] * 5.0, dim=-1).view(3, 2, 4)
    true = world.state.human_goal[:, None] - world.state.robot_position[:, :, None]
    np.testing.assert_allclose(goals, np.linalg.norm(true, axis=-1), rtol=1e-5)
    world.state.arrived[0, 1] = True
    assert state_of(world).robots[0, 0, 0, 11] == 1.0
    assert state_of(world).robots[1, 0, 0, 11] == 0.0
