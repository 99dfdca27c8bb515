"""Rollouts of different scenarios, merged into one pass of the networks."""

import math
from collections import defaultdict
from dataclasses import replace

import pytest
import torch

from samarl.algorithms.training_data import TrainingData, minibatches
from samarl.policies.policy import LOCAL
from tests.learning import SCENARIO, algorithm, collector, policy

SIMILAR = replace(SCENARIO, humans=5, robots=3)
CROWDED = replace(SCENARIO, humans=20)


@pytest.mark.parametrize("encoder", ["spatio_temporal", "gru", "structural_rnn", "set_pool"])
def test_the_networks_compute_the_same_for_merged_rollouts(encoder: str) -> None:
    model = policy("flat", encoder)
    learner = algorithm(model)
    rollouts = [collector(model, 4, 6, scenario).collect() for scenario in (SCENARIO, SIMILAR)]
    statistics: dict[str, list[float]] = defaultdict(list)
    (data,) = minibatches(learner.prepare(rollouts, statistics), 1)
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


@pytest.mark.parametrize(("max_padding", "expected"), [(1.3, [5, 20]), (math.inf, [20])])
def test_rollouts_are_merged_as_far_as_padding_allows(
    max_padding: float, expected: list[int]
) -> None:
    model = policy("flat", "set_pool")
    rollouts = [
        collector(model, 4, 6, scenario).collect() for scenario in (SCENARIO, CROWDED, SIMILAR)
    ]
    data = algorithm(model).prepare(rollouts, defaultdict(list))
    (parts,) = minibatches(data, 1, max_padding)
    slots = [part.sequences.features.humans.shape[2] for part in parts]
    assert sorted(slots) == expected


def test_minibatches_are_whole_teams_and_cover_everything_once() -> None:
    model = policy("flat", "set_pool")
    rollouts = [
        collector(model, 5, 6, scenario).collect() for scenario in (SCENARIO, SIMILAR, CROWDED)
    ]
    data = algorithm(model).prepare(rollouts, defaultdict(list))
    assert [len(part.sequence.unique()) for part in data] == [10, 5]
    teams: dict[int, list[int]] = {}
    for number, part in enumerate(data):
        name = 100 * number + part.sequence
        teams |= {int(n): part.robot[name == n].tolist() for n in name.unique()}
        part.levels[LOCAL]["name"] = name[:, None].expand(-1, 6)
    assert sorted(map(len, teams.values())) == [2] * 10 + [3] * 5
    seen: list[int] = []
    for minibatch in minibatches(data, 3, math.inf):
        merged: TrainingData
        (merged,) = minibatch
        name = merged.levels[LOCAL]["name"][:, 0]
        assert len(merged.sequence.unique()) == len(name.unique()) == 5
        for n in name.unique().tolist():
            assert merged.robot[name == n].tolist() == teams[n]
            assert len(merged.sequence[name == n].unique()) == 1
            seen.append(n)
    assert sorted(seen) == sorted(teams)
