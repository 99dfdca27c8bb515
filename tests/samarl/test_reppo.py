"""REPPO: categorical values, the KL divergence, and a policy that follows the advantage."""

from collections import defaultdict
from typing import Any

import pytest
import torch
from torch.distributions import Independent, Normal, kl_divergence

from samarl.algorithms import ALGORITHMS
from samarl.algorithms.on_policy import selected_decisions
from samarl.algorithms.reppo import REPPO, DuelingCritic, gaussian_kl
from samarl.policies.policy import LOCAL, MACRO
from tests.learning import REPPO_NUMBERS, collector, policy


def reppo(of: Any, **changes: Any) -> REPPO:
    learner = ALGORITHMS["reppo"].cls(
        of, ALGORITHMS.config({"name": "reppo", **REPPO_NUMBERS, **changes})
    )
    assert isinstance(learner, REPPO)
    return learner


def test_values_are_the_means_of_histograms() -> None:
    torch.manual_seed(0)
    config: Any = ALGORITHMS.config({"name": "reppo", **REPPO_NUMBERS})
    critic = DuelingCritic(3, 2, 16, config)
    features, target = torch.eye(3), torch.tensor([-2.0, 0.3, 3.7])
    optimiser = torch.optim.Adam(critic.parameters(), lr=0.01)
    for _ in range(300):
        optimiser.zero_grad()
        critic.value.loss(features, target).backward()
        optimiser.step()
    torch.testing.assert_close(critic.value(features).detach(), target, atol=0.05, rtol=0.0)
    assert critic.value.loss(features, torch.full((3,), 1e3)).isfinite()  # beyond the categories


def test_the_divergence_is_that_of_torch() -> None:
    torch.manual_seed(0)
    old_mean, mean = torch.randn(2, 5, 3)
    old_std, std = torch.rand(2, 5, 3) + 0.1
    expected = kl_divergence(
        Independent(Normal(old_mean, old_std), 1), Independent(Normal(mean, std), 1)
    )
    torch.testing.assert_close(gaussian_kl(old_mean, old_std, mean, std), expected)


def test_the_policy_moves_to_the_actions_of_largest_advantage_within_the_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def mean_action(bound: float, updates: int) -> torch.Tensor:
        model = policy("flat", "set_pool")
        learner = reppo(model, kl_bound=bound, learning_rate=0.01, action_limit_penalty=0.0)
        monkeypatch.setattr(
            DuelingCritic, "advantage", lambda _, features, action: -(action - 0.4).square().sum(-1)
        )
        data = learner.prepare([collector(model, 6, 8).collect()], defaultdict(list))
        for _ in range(updates):
            learner.optimiser.zero_grad()
            learner._policy_loss(data[0], defaultdict(list), []).backward()
            learner.optimiser.step()
        _, levels = selected_decisions(model, data[0])
        local = levels[LOCAL]
        return model.distribution(LOCAL, local["embedding"], local["row"]).mean.detach().mean(0)

    free, bound = mean_action(100.0, 60), mean_action(0.01, 60)
    before = mean_action(100.0, 0)
    assert (free - 0.4).abs().max() < 0.1
    moved, moved_at_most = (bound - before).norm(), (free - before).norm()
    assert 0.01 < moved < 0.6 * moved_at_most


@pytest.mark.parametrize("name", ["flat", "hierarchical"])
def test_all_levels_are_updated(name: str) -> None:
    model = policy(name, "set_pool")
    learner = reppo(model, minibatches=1)
    levels = (MACRO, LOCAL) if name == "hierarchical" else (LOCAL,)
    before = {level: model.networks[0].heads[level].body[0].weight.clone() for level in levels}
    statistics = learner.update([collector(model, 6, 12).collect()])
    for level in levels:
        assert not torch.equal(before[level], model.networks[0].heads[level].body[0].weight)
        assert statistics[f"losses/{level}_kl"] >= 0.0
