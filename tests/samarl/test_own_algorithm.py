"""An algorithm of a user: MAPPO with a KL penalty instead of clipped probability ratios."""

from collections import defaultdict
from typing import Any

import torch
from torchrl.objectives import KLPENPPOLoss

from samarl.algorithms.ppo import MAPPO, PPOConfig, Statistics
from samarl.algorithms.training_data import TrainingData
from samarl.policies.policy import LOCAL, MACRO
from samarl.rollout import Rollout
from tests.learning import PPO_NUMBERS, collector, policy


class KLPenalty(MAPPO):
    """The old distribution is stored in `prepare`; `BETA` weighs the divergence from it."""

    BETA = 1.0
    loss_class = KLPENPPOLoss

    def _loss_settings(self) -> dict[str, Any]:
        return {"beta": self.BETA, "increment": 1.0, "decrement": 1.0}

    @torch.no_grad()
    def prepare(self, rollouts: list[Rollout], statistics: Statistics) -> list[TrainingData]:
        data = super().prepare(rollouts, statistics)
        for part in data:
            _, levels = self._selected_decisions(part)
            for level, decisions in levels.items():
                to = part.levels[level]
                self.policy.actor(level).get_dist(decisions)
                for key in ("loc", "scale"):
                    to[key] = torch.ones_like(to["action"])
                    to[key][part.selected & to["decides"]] = decisions[key]
        return data


class Strict(KLPenalty):
    """Hardly any divergence is allowed."""

    BETA = 1e4


def test_a_kl_penalty_keeps_both_levels_near_the_old_policy() -> None:
    moved: dict[str, list[float]] = defaultdict(list)
    for learner in (KLPenalty, Strict):
        training = learner(policy("hierarchical", "gru"), PPOConfig(**PPO_NUMBERS | {"epochs": 20}))
        rollout = collector(training.policy).collect()
        (part,) = training.prepare([rollout], defaultdict(list))
        training._run_epochs([part], defaultdict(list))
        for level, decisions in training._selected_decisions(part)[1].items():
            old = decisions["loc"].clone()
            training.policy.actor(level).get_dist(decisions)
            moved[level].append(float((decisions["loc"] - old).abs().mean().detach()))
    assert moved.keys() == {LOCAL, MACRO}
    for free, strict in moved.values():
        assert 0.0 < strict < 0.5 * free
