"""Rollouts of different scenarios, merged into one pass of the networks."""

from collections import defaultdict
from dataclasses import replace

import pytest
import torch

from samarl.algorithms.training_data import TrainingData
from samarl.policies.policy import LOCAL
from tests.learning import SCENARIO, algorithm, collector, policy

SIMILAR = replace(SCENARIO, humans=5, robots=3)
CROWDED = replace(SCENARIO, humans=50)


@pytest.mark.parametrize("encoder", ["spatio_temporal", "gru", "structural_rnn", "set_pool"])
def test_the_networks_compute_the_same_for_merged_rollouts(encoder: str) -> None:
    model = policy("flat", encoder)
    learner = algorithm(model)
    rollouts = [collector(model, 4, 6, scenario).collect() for scenario in (SCENARIO, SIMILAR)]
    statistics: dict[str, list[float]] = defaultdict(list)
    data = learner.prepare(rollouts, statistics)
    recurrent_edges = encoder == "structural_rnn"  # whose memory has an entry for each agent
    assert len(data) == 1 + recurrent_edges
    assert sum(len(part.robot) for part in data) == 4 * 2 + 4 * 3
    for part in data:
        # Nothing has been updated yet: the probability of every action is as it was stored.
        learner._policy_loss(part, statistics, [])
        features = learner.critic_encoder(
            part.critic_frames.apply(lambda x: x[:, :-1].flatten(0, 1))
        )
        value = learner.critics[LOCAL](features).view(part.selected.shape)
        valued = part.levels[LOCAL]["valued"]
        before = part.levels[LOCAL]["state_value"].squeeze(-1)
        torch.testing.assert_close(value[valued], before[valued], atol=1e-4, rtol=1e-4)
    assert max(map(abs, statistics["losses/local_approx_kl"])) < 1e-5


def test_rollouts_with_very_different_numbers_of_agents_are_not_padded() -> None:
    model = policy("flat", "set_pool")
    rollouts = [
        collector(model, 4, 6, scenario).collect() for scenario in (SCENARIO, CROWDED, SIMILAR)
    ]
    data = algorithm(model).prepare(rollouts, defaultdict(list))
    slots = [part.sequences.features.humans.shape[2] for part in data]
    assert sorted(slots) == [5, 50]


def test_minibatches_are_whole_teams_and_cover_everything_once() -> None:
    model = policy("flat", "set_pool")
    learner = algorithm(model)
    rollouts = [collector(model, 5, 6, scenario).collect() for scenario in (SCENARIO, SIMILAR)]
    (data,) = learner.prepare(rollouts, defaultdict(list))
    parts: list[TrainingData] = list(data.minibatches(3))
    assert sorted(torch.cat([part.sequence for part in parts]).tolist()) == data.sequence.tolist()
    for part in parts:
        for sequence in part.sequence.unique():
            team = part.robot[part.sequence == sequence].tolist()
            assert team == list(range(2 if sequence < 5 else 3))
