"""Soft actor-critic: its targets, its critics, what padding must not touch, and that it learns."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from mrsan import ConfigurationError, Kinematics, Scenario, World
from samarl.agents.learned import DeployedPolicy
from samarl.algorithms import ALGORITHMS
from samarl.algorithms.action_values import AttentionCritic
from samarl.algorithms.soft_actor_critic import SoftActorCritic, features, sequences_of
from samarl.policies.checkpoint import make_policy
from samarl.policies.squashed import SquashedPolicy, log_slope
from samarl.rollout import Rollout
from samarl.training.collector import RolloutCollector
from samarl.training.curriculum import CurriculumStage
from tests.learning import SOFT_NUMBERS, policy_numbers

SCENARIO = Scenario(
    kinematics=Kinematics.holonomic, robots=3, humans=4, time_limit=3.0, circle_radius=4.0
)


def squashed(
    action_size: int = 2, encoder: str = "temporal_spatial_graph", **changes: Any
) -> SquashedPolicy:
    torch.manual_seed(0)
    numbers = policy_numbers("squashed", encoder, **changes)
    policy = make_policy(numbers.pop("name"), numbers, action_size)
    assert isinstance(policy, SquashedPolicy)
    return policy


def learner(of: SquashedPolicy, **changes: Any) -> SoftActorCritic:
    numbers = {"name": "soft_actor_critic", **SOFT_NUMBERS, **changes}
    algorithm = ALGORITHMS["soft_actor_critic"].cls(of, ALGORITHMS.config(numbers))
    assert isinstance(algorithm, SoftActorCritic)
    return algorithm


def collected(of: SquashedPolicy, rounds: int = 3, **stage: Any) -> Rollout:
    """A rollout of crowded worlds, in the middle of episodes."""
    stage = {"scenario": SCENARIO, **stage}
    going = RolloutCollector(CurriculumStage(12, **stage), of, 10, 0)
    for _ in range(rounds - 1):
        going.collect()
    return going.collect()


# The policy


def test_what_drives_is_squashed_and_so_is_its_density() -> None:
    """The density of tanh(x) is the Gaussian's over the slope, and sums to 1."""
    policy = squashed()
    y = torch.randn(5, 3, policy.networks[0].encoder.features)
    action, log_prob = policy.draw(y.expand(4000, 5, 3, -1))
    assert (action.abs() <= 1).all()
    mean, std = policy.networks[0].heads["local"](y)
    inside = action[:100].double().atanh()
    normal = torch.distributions.Normal(mean.double(), std.double()).log_prob(inside).sum(-1)
    expected = normal - (1.0 - action[:100].double().square()).log().sum(-1)
    torch.testing.assert_close(log_prob[:100].double(), expected, atol=1e-3, rtol=0)
    # The mean of 1 / density over the square that actions lie in is its area, 4.
    assert (-log_prob).exp().mean().item() == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("action_size", [2, 3])
def test_it_is_deployed_with_the_tanh_of_the_mean(action_size: int) -> None:
    kinematics = {2: Kinematics.holonomic, 3: Kinematics.acceleration_heading}[action_size]
    scenario = Scenario(kinematics=kinematics, robots=2, humans=3)
    policy = squashed(action_size)
    with torch.no_grad():
        policy.networks[0].heads["local"].body[-1].bias[:action_size] = 3.0
    world = World(scenario, 4)
    action = DeployedPolicy(policy, scenario).act(world.reset([0, 1, 2, 3]))
    assert action == pytest.approx(np.full((4, 2, action_size), math.tanh(3.0)), abs=0.01)
    with pytest.raises(ConfigurationError, match=rf"kinematics .* {action_size}\b"):
        squashed(action_size).check(
            Scenario(
                kinematics=Kinematics.holonomic if action_size == 3 else "acceleration_heading"
            )  # type: ignore[arg-type]
        )


def test_features_of_sequences_are_those_of_acting() -> None:
    """With one set of parameters for each robot, and from the middle of episodes."""
    policy = squashed(num_parameter_sets=3)
    rollout = collected(policy)
    batch = sequences_of(rollout, team=False)
    y = features(policy, batch)
    assert y.shape[:3] == (12, 11, 3)
    parts = [net.heads["local"](y[:, :, i]) for i, net in enumerate(policy.networks)]
    mean, std = (torch.stack(part, 2) for part in zip(*parts, strict=True))
    at = rollout.steps["agents", "active_mask"]
    inside = rollout.steps["agents", "action"]
    normal = torch.distributions.Normal(mean, std).log_prob(inside).sum(-1)
    stored = rollout.steps["agents", "sample_log_prob"]
    torch.testing.assert_close((normal - log_slope(inside))[at], stored[at], atol=1e-4, rtol=0)
    assert torch.equal(batch["action"], inside[:, :-1].tanh())


# The critics


def test_attention_among_many_by_hand() -> None:
    """Head by head in plain sums; who has arrived does not count, and the others have no order."""
    torch.manual_seed(0)
    critic = AttentionCritic(5, 2, 8, 2)
    y, own, others = torch.randn(4, 5), torch.randn(4, 2), torch.randn(4, 2)
    active = torch.tensor([True, True, False, True])
    q = critic(y, own, others, active)
    of_self = critic.embed_own(torch.cat([y, own], -1))
    of_other = critic.embed_other(torch.cat([y, others], -1))
    queries, keys, values = critic.query(of_self), critic.key(of_other), critic.value(of_other)
    for i in range(4):
        rest, attention = [j for j in (0, 1, 3) if j != i], torch.zeros(8)
        for head in (slice(0, 4), slice(4, 8)):
            weights = [((queries[i, head] @ keys[j, head]) / 2.0).exp() for j in rest]
            weighted_sum = sum(w * values[j, head] for w, j in zip(weights, rest, strict=True))
            attention[head] = weighted_sum / sum(weights)
        expected = critic.out(torch.cat([attention, of_self[i]]))
        torch.testing.assert_close(q[i], expected[0])
    order = torch.tensor([3, 2, 0, 1])
    mixed = critic(y[order], own[order], others[order], active[order])
    torch.testing.assert_close(mixed, q[order])


# What is learned from


def batch_of(
    active: list[list[list[bool]]],
    reward: list[list[list[float]]],
    done: list[list[bool]],
    terminated: list[list[list[bool]]],
    team: bool,
) -> TensorDict:
    """Sequences [S, T + 1, N] as `sequences_of` makes them of a rollout with nobody in view."""
    on_way = torch.tensor(active)
    s, t, n = on_way.shape
    scenario = Scenario(kinematics=Kinematics.holonomic, robots=n, humans=2)
    policy = squashed()
    going = RolloutCollector(CurriculumStage(s, scenario=scenario), policy, t - 1, 0)
    rollout = going.collect()
    steps = rollout.steps
    steps["agents", "active_mask"] = on_way
    paid = torch.tensor(reward)
    steps["next", "agents", "reward"] = paid.sum(-1, True).expand_as(paid) if team else paid
    steps["next", "done"] = torch.tensor(done).unsqueeze(-1)
    steps["next", "agents", "terminated"] = torch.tensor(terminated)
    return sequences_of(rollout, team)


o, x = True, False
# Robot 0 arrives in step 1, robot 1 hits somebody in step 2, and an episode begins. In the second
# sequence time is up in step 1; in the third robot 1 hits somebody while robot 0 is on its way.
ACTIVE = [
    [[o, o], [o, o], [x, o], [o, o]],
    [[o, o], [o, o], [o, o], [o, o]],
    [[o, o], [o, o], [o, o], [o, o]],
]
REWARD = [
    [[1.0, 2.0], [10.0, 3.0], [0.0, -20.0], [0.0, 0.0]],
    [[4.0, 5.0], [9.0, 9.0], [6.0, 7.0], [0.0, 0.0]],
    [[9.0, 9.0], [8.0, 0.5], [9.0, -20.0], [0.0, 0.0]],
]
DONE = [[x, x, o, x], [x, o, x, x], [x, x, o, x]]
TERMINATED = [
    [[x, x], [x, x], [x, o], [x, x]],
    [[x, x], [x, x], [x, x], [x, x]],
    [[x, x], [x, x], [x, o], [x, x]],
]


def test_where_values_are_learned_and_where_they_end() -> None:
    alone = batch_of(ACTIVE, REWARD, DONE, TERMINATED, team=False)
    assert alone["valued"].tolist() == alone["acts"].tolist()
    assert alone["acts"].tolist() == [
        [[o, o], [o, o], [x, o]],
        [[o, o], [x, x], [o, o]],
        [[o, o], [o, o], [x, o]],
    ]
    assert alone["continues"][alone["acts"]].tolist() == [o, o, x, o, x, o, o, o, o, o, o, o, o, x]
    assert alone["reward"].tolist() == [row[:3] for row in REWARD]
    team = batch_of(ACTIVE, REWARD, DONE, TERMINATED, team=True)
    # Robot 0 waits in the last step of the first sequence, and is paid as robot 1 is.
    assert team["valued"].tolist() == [
        [[o, o], [o, o], [o, o]],
        [[o, o], [x, x], [o, o]],
        [[o, o], [o, o], [o, o]],
    ]
    assert team["acts"].tolist() == [
        [[o, o], [o, o], [x, o]],
        [[o, o], [x, x], [o, o]],
        [[o, o], [o, o], [o, o]],
    ]
    ends = ~team["continues"]
    assert ends.nonzero().tolist() == [[0, 2, 0], [0, 2, 1], [2, 2, 0], [2, 2, 1]]
    assert team["reward"][0].tolist() == [[3.0, 3.0], [13.0, 13.0], [-20.0, -20.0]]


@pytest.mark.parametrize("team", [True, False])
def test_targets_by_hand(team: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums in plain Python, of critics whose values are known and of draws that are known."""
    batch = batch_of(ACTIVE, REWARD, DONE, TERMINATED, team)
    policy = squashed()
    algorithm = learner(policy, team_reward=team, discount=0.9, temperature_start=0.5)
    seen: list[Tensor] = []

    def known(offset: float) -> Any:
        class Known(torch.nn.Module):
            def forward(self, y: Tensor, own: Tensor, others: Tensor, active: Tensor) -> Tensor:
                seen.append(own)
                return offset + 10.0 * own.sum(-1) + active.sum(-1, keepdim=True)

        return Known()

    algorithm.target_critics = torch.nn.ModuleList([known(100.0), known(99.0)])
    drawn = torch.arange(3 * 3 * 2, dtype=torch.float32).view(3, 3, 2) / 20.0
    monkeypatch.setattr(
        policy, "draw", lambda y: (torch.stack([drawn, 0 * drawn], -1), -1.0 - drawn)
    )
    targets = algorithm.targets(batch, features(policy, batch)[:, 1:])
    assert (seen[0][0, 1, 0] == 0.0).all()  # it has arrived, and does nothing more
    for s in range(3):
        for t in range(3):
            for i in range(2):
                if not batch["valued"][s, t, i]:
                    continue
                paid = sum(REWARD[s][t]) if team else REWARD[s][t][i]
                on_way = ACTIVE[s][t + 1][i]
                over = DONE[s][t] or (not team and not on_way)
                q = 99.0 + 10.0 * float(drawn[s, t, i]) * on_way + sum(ACTIVE[s][t + 1])
                soft = q + 0.5 * (1.0 + float(drawn[s, t, i])) * on_way
                expected = paid + (0.0 if over else 0.9 * soft)
                assert float(targets[s, t, i]) == pytest.approx(expected, rel=1e-5)


def losses(algorithm: SoftActorCritic, batch: TensorDict) -> list[Tensor]:
    """The gradients of all weights, of both losses."""
    torch.manual_seed(5)
    algorithm.zero_grad()
    algorithm.policy.zero_grad()
    y = features(algorithm.policy, batch)
    now, later = y[:, :-1], y[:, 1:].detach()
    loss, _ = algorithm.critic_loss(batch, now, algorithm.targets(batch, later))
    loss.backward()
    of_critics = [p.grad.clone() for p in algorithm.critic_parameters if p.grad is not None]
    loss, _ = algorithm.actor_loss(batch, now.detach())
    loss.backward()
    return of_critics + [p.grad.clone() for p in algorithm.actor_parameters if p.grad is not None]


@pytest.mark.parametrize("encoder", ["temporal_spatial_graph", "social_attention"])
def test_padding_changes_no_bit_of_a_gradient(encoder: str) -> None:
    policy = squashed(encoder=encoder)
    algorithm = learner(policy)
    rollout = collected(policy)
    rollout.steps["mask"][0, 4:] = False  # from step 4 on, and all of the next one
    rollout.steps["mask"][1] = False
    batch = sequences_of(rollout, team=True)
    assert batch["valued"][2:].any()
    before = losses(algorithm, batch)
    changed = batch.clone()
    for key in (("frames", "ego"), ("frames", "humans"), ("frames", "robots")):
        changed[key][0, :, 5:] += torch.randn_like(changed[key][0, :, 5:])  # step 4 is bootstrapped
        changed[key][1] += 3.0
    for key in ("action", "reward"):
        changed[key][0, 4:] -= 0.7
        changed[key][1] += 0.3
    for one, other in zip(before, losses(algorithm, changed), strict=True):
        assert torch.equal(one, other)
    changed["frames", "ego"][0, :, 3] += 1.0  # and this is no padding
    assert not torch.equal(before[0], losses(algorithm, changed)[0])


def test_entropy_is_worth_more_when_there_is_too_little_of_it() -> None:
    for entropy, sign in ((-3.0, 1.0), (-1.0, -1.0)):  # it should come to -2
        algorithm = learner(squashed())
        assert float(algorithm.temperature) == pytest.approx(0.02)
        statistics: Any = {}
        loss = algorithm.temperature_loss(torch.full((7,), -entropy))
        algorithm._descend("temperature", loss, [], statistics)
        assert sign * float(algorithm.temperature - 0.02) > 0


def test_the_target_networks_follow_slowly() -> None:
    policy = squashed()
    algorithm = learner(policy, target_rate=0.25)
    with torch.no_grad():
        policy.networks[0].encoder.values.fill_(1.0)
        algorithm.target_policy.networks[0].encoder.values.fill_(0.0)
    for expected in (0.25, 0.25 + 0.75 * 0.25):
        algorithm._update_targets()
        assert (algorithm.target_policy.networks[0].encoder.values == expected).all()


def test_it_learns_to_drive_to_the_goal() -> None:
    """One robot, nobody else: in seconds it is paid several times what it was."""
    torch.set_num_threads(1)  # networks as small as these wait for each other on more
    scenario = Scenario(
        kinematics=Kinematics.holonomic,
        robots=1,
        humans=0,
        circle_radius=2.0,
        goal_distance=2.0,
        time_limit=10.0,
    )
    policy = squashed(encoder="social_attention")
    algorithm = learner(
        policy,
        learning_starts=400,
        updates=10,
        batch=16,
        learning_rate=2e-3,
        team_reward=False,
        target_rate=0.03,
        discount=0.9,
    )
    going = RolloutCollector(CurriculumStage(16, scenario=scenario), policy, 10, 0)
    paid = []
    for _ in range(30):
        rollout = going.collect()
        algorithm.update([rollout])
        paid.append(float(rollout.steps["next", "agents", "reward"].mean()))
    assert sum(paid[:5]) / 5 < 0.2
    assert sum(paid[-8:]) / 8 > 0.8  # on the straight way it is 0.5 a step, and 10 for arriving
