"""TorchRL's own collector gathers what our learner learns from."""

import torch

from benchmarks.collecting import torchrl_rollouts
from mrsan import Scenario
from samarl.policies.policy import LOCAL
from tests import learning


def test_what_torchrl_collects_is_what_the_policy_did() -> None:
    policy = learning.policy("flat", gain=30.0)
    for rollout in torchrl_rollouts(policy, learning.SCENARIO, worlds=5, steps=9, total=4):
        choice, stored, _ = learning.choices(policy, rollout)[LOCAL]
        assert len(stored) > 0
        torch.testing.assert_close(choice.log_prob, stored, atol=1e-4, rtol=0.0)


def test_the_learner_learns_from_what_torchrl_collects() -> None:
    def paid(learns: bool) -> float:
        policy, scenario = learning.policy("flat"), Scenario(robots=2, humans=0)
        learner = learning.algorithm(policy, "ippo", learning_rate=1e-2, minibatches=4, epochs=2)
        rewards = []
        for rollout in torchrl_rollouts(policy, scenario, worlds=12, steps=16, total=10):
            if learns:
                learner.update([rollout])
            active = rollout.steps["agents", "active_mask"]
            rewards.append(float(rollout.steps["next", "agents", "reward"][active].mean()))
        return sum(rewards[-4:]) / 4

    assert paid(learns=True) > paid(learns=False) + 0.15
