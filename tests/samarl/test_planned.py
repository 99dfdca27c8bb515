"""A policy and a planner together."""

import numpy as np
import pytest
import torch

from mrsan import Scenario, World
from samarl.agents.planners.model_predictive import ModelPredictive
from samarl.policies.planned import Mixture
from samarl.policies.policy import LOCAL, Policy
from tests.learning import POLICIES, policy


def trusting(trust: float, **changes: float) -> Policy:
    """A policy that trusts its planner so much, before the sigmoid."""
    made = policy("planned", gain=30.0, **changes)
    head = made.networks[0].heads[LOCAL]
    assert isinstance(head, Mixture)
    with torch.no_grad():
        head.trust[2].bias.fill_(trust)
    return made


def test_the_mean_is_a_mixture_by_hand() -> None:
    torch.manual_seed(0)
    head = Mixture(4, 8, (0.3, 0.0, 0.0), (0.3, 0.1, 0.3))
    inputs = torch.randn(5, 7)
    mean, std = head(inputs)
    own = head.body(inputs[:, :4])
    trust = torch.sigmoid(head.trust[2](torch.tanh(head.trust[0](inputs))))
    assert ((trust > 0.8) & (trust < 0.95)).all()  # at first
    torch.testing.assert_close(mean, (1 - trust) * own + trust * inputs[:, 4:])
    torch.testing.assert_close(std, torch.tensor([0.3, 0.1, 0.3]).expand(5, 3))
    short = Mixture(4, 8, (0.0, 0.0), (0.5, 0.5))  # robots with two numbers per action
    with torch.no_grad():
        short.trust[2].bias.fill_(50.0)
    torch.testing.assert_close(short(inputs)[0], inputs[:, 4:6])


@pytest.mark.parametrize("fov", [360.0, 90.0])
def test_with_all_trust_it_is_the_planner_on_what_is_known(fov: float) -> None:
    """Who left the view is known for `track_steps`; with none it is the planner of the table."""
    scenario = Scenario(humans=8, robots=3, fov_degrees=fov, circle_radius=4.0)
    planner = ModelPredictive(scenario, **POLICIES["planned"])
    model = trusting(50.0, track_steps=0)
    world = World(scenario, 4)
    observation, state = world.reset(range(4)), model.initial_state(4, scenario)
    is_init = np.ones(4, np.bool_)
    for _ in range(20):
        decision = model.act(observation, state, is_init, scenario)
        wanted = planner.act(observation)
        np.testing.assert_allclose(decision.action, wanted, atol=1e-5)
        np.testing.assert_array_equal(decision.target.numpy(), wanted)
        is_init[:] = False
        observation = world.step(wanted).observation


def test_without_trust_the_planner_changes_nothing() -> None:
    scenario = Scenario(humans=10, robots=2, circle_radius=4.0)
    one, other = trusting(-50.0), trusting(-50.0, human_margin=3.0)
    world = World(scenario, 4)
    observation = world.reset(range(4))
    decisions = [
        model.act(observation, model.initial_state(4, scenario), np.ones(4, np.bool_), scenario)
        for model in (one, other)
    ]
    assert not torch.equal(decisions[0].target, decisions[1].target)
    np.testing.assert_allclose(decisions[0].action, decisions[1].action, atol=1e-6)
