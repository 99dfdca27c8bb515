"""Advantages of both levels against loops over each robot's own stream."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torch import Tensor

from mrsan import Scenario
from samarl.algorithms.advantages import (
    macro_advantages,
    macro_records,
    step_advantages,
    streams,
)
from samarl.policies.policy import LOCAL
from tests.learning import algorithm, collector, policy


class Made(NamedTuple):
    """Streams and what was paid in them."""

    steps: TensorDict
    decided: Tensor  # [S, T, N]
    reward: Tensor  # [S, T, N]
    value: Tensor  # [S, T + 1, N]


def made(
    active: Any, done: Any, terminated: Any, decided: Any, reward: Any, value: Any, mask: Any = None
) -> Made:
    """Of lists [S][T][N] ([S][T] for `done` and `mask`; `mask` and `value` have T + 1)."""

    def flags(values: Any) -> Tensor:
        return torch.tensor(values, dtype=torch.bool)

    active, terminated, done = flags(active), flags(terminated), flags(done).unsqueeze(-1)
    s, t, _ = active.shape
    more = torch.zeros_like(active[:, :1])
    steps = TensorDict({}, [s, t + 1])
    shown = torch.ones(s, t + 1, dtype=torch.bool) if mask is None else flags(mask)
    steps["mask"] = shown.unsqueeze(-1)
    steps["agents", "active_mask"] = torch.cat([active, ~more], 1)
    steps["next", "done"] = torch.cat([done, more[..., :1]], 1)
    steps["next", "agents", "terminated"] = torch.cat([terminated, more], 1)
    numbers = (torch.tensor(x, dtype=torch.float32) for x in (reward, value))
    return Made(steps, flags(decided), *numbers)


def segments(data: Made, s: int, n: int) -> list[tuple[list[int], float]]:
    """The steps that count of each episode of robot n in sequence s, and what follows them."""
    length, episodes, now = data.reward.shape[1], [], []
    for t in range(length):
        if not data.steps["mask"][s, t, 0]:
            continue
        now.append(t)
        if data.steps["next", "agents", "terminated"][s, t, n]:
            episodes.append((now, 0.0))
            now = []
        elif data.steps["next", "done"][s, t, 0]:  # the last step is taken off
            episodes.append((now[:-1], float(data.value[s, t, n])))
            now = []
    episodes.append((now, float(data.value[s, length, n])))
    return [(steps, after) for steps, after in episodes if steps]


def by_steps(data: Made, discount: float, lam: float) -> dict[tuple[int, int, int], float]:
    """Advantages of the local level."""
    advantages = {}
    for s in range(data.reward.shape[0]):
        for n in range(data.reward.shape[2]):
            for steps, after in segments(data, s, n):
                gae = 0.0
                for t in reversed(steps):
                    value = float(data.value[s, t, n])
                    gae *= discount * lam
                    gae += float(data.reward[s, t, n]) + discount * after - value
                    advantages[s, t, n] = gae
                    after = value
    return advantages


def by_records(data: Made, discount: float, lam: float) -> dict[tuple[int, int, int], float]:
    """Advantages of the macro level, at the first step of each record."""
    advantages = {}
    for s in range(data.reward.shape[0]):
        for n in range(data.reward.shape[2]):
            for steps, after in segments(data, s, n):
                records: list[list[int]] = []
                waited = False
                for t in steps:
                    drives = bool(data.steps["agents", "active_mask"][s, t, n])
                    if (drives and data.decided[s, t, n]) or (not drives and not waited):
                        records.append([])
                    waited = not drives
                    if records:  # else it is what is left of a decision of before
                        records[-1].append(t)
                gae = 0.0
                for record in reversed(records):
                    value, paid = float(data.value[s, record[0], n]), 0.0
                    for j, t in enumerate(record):
                        paid += discount**j * float(data.reward[s, t, n])
                    discounted = discount ** len(record)
                    gae = paid + discounted * after - value + discounted * lam * gae
                    advantages[s, record[0], n] = gae
                    after = value
    return advantages


def check(data: Made, discount: float, lam: float) -> None:
    """Both levels agree with the loops, and padding has no part in it."""
    of = streams(data.steps)
    of_steps = step_advantages(of, data.reward, data.value, discount, lam)
    *of_records, where = macro_advantages(of, data.decided, data.reward, data.value, discount, lam)
    for (advantage, target), expected, counts in (
        (of_steps, by_steps(data, discount, lam), of.counts),
        (of_records, by_records(data, discount, lam), where),
    ):
        assert {tuple(at) for at in counts.nonzero().tolist()} == set(expected)
        for at, number in expected.items():
            assert float(advantage[at]) == pytest.approx(number, rel=1e-4, abs=1e-3)
            assert float(target[at]) == pytest.approx(
                number + float(data.value[at]), rel=1e-4, abs=1e-3
            )
    for garbage in (1e30, -1e30):
        reward = torch.where(of.counts, data.reward, garbage)
        value = torch.where(data.steps["mask"], data.value, garbage)
        again = step_advantages(of, reward, value, discount, lam)
        macro = macro_advantages(of, data.decided, reward, value, discount, lam)
        for one, other in zip(of_steps, again, strict=True):
            assert torch.equal(one[of.counts], other[of.counts])
        for one, other in zip(of_records, macro, strict=False):
            assert torch.equal(one[where], other[where])


@st.composite
def worlds(draw: st.DrawFn) -> Made:
    """Episodes of all lengths and ends in sequences with and without padding."""
    r = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    s, t, n = (draw(st.integers(1, high)) for high in (3, 9, 3))
    active, done = np.ones((s, t, n), bool), np.zeros((s, t), bool)
    terminated, mask = np.zeros((s, t, n), bool), np.ones((s, t + 1), bool)
    for i in range(s):
        drives = r.random(n) < 0.8  # at the beginning of the rollout some may have arrived
        if draw(st.booleans()):  # the sequence begins with a world that was taken back
            mask[i, : r.integers(0, t)] = False
        for k in range(t):
            active[i, k] = drives
            drives = drives & (r.random(n) < 0.8)
            kind = r.random()
            if kind < 0.3:
                done[i, k] = True
                if kind < 0.1:  # all have arrived
                    terminated[i, k] = True
                elif kind < 0.2:  # a collision
                    terminated[i, k, r.integers(n)] = True
                drives = np.ones(n, bool)
        ends = np.flatnonzero(done[i] & mask[i, :-1])
        if len(ends) and draw(st.booleans()):  # it was taken back after an end
            mask[i, r.choice(ends) + 1 :] = False
    decided = (r.random((s, t, n)) < draw(st.sampled_from([0.1, 0.3, 1.0]))) & active
    return made(
        active,
        done,
        terminated,
        decided,
        r.normal(size=(s, t, n)),
        10 * r.normal(size=(s, t + 1, n)),
        mask,
    )


@given(worlds(), st.sampled_from([0.5, 0.9, 1.0]), st.sampled_from([0.0, 0.8, 0.95, 1.0]))
@settings(max_examples=60)
def test_both_levels_agree_with_loops_over_every_stream(
    data: Made, discount: float, lam: float
) -> None:
    check(data, discount, lam)


def test_macro_rewards_are_discounted_sums_over_their_durations() -> None:
    data = made(
        active=[[[1]] * 7],
        done=[[0, 0, 0, 0, 1, 0, 0]],
        terminated=[[[0]] * 4 + [[1], [0], [0]]],
        decided=[[[1], [0], [0], [1], [0], [1], [0]]],
        reward=[[[1], [2], [4], [8], [16], [32], [64]]],
        value=[[[0]] * 8],
    )
    records = macro_records(streams(data.steps), data.decided, data.reward, discount=0.5)
    assert records.reward.flatten().tolist() == [1 + 1 + 1, 8 + 8, 32 + 32]
    assert records.duration.flatten().tolist() == [3, 2, 2]
    assert records.start.flatten().tolist() == [0, 3, 5]
    assert records.end.flatten().tolist() == [2, 4, 6]
    assert records.terminated.flatten().tolist() == [False, True, False]
    assert records.done.flatten().tolist() == [False, True, True]
    assert records.valid.all()


def test_the_time_limit_and_a_team_mates_collision_bootstrap_from_the_state_before() -> None:
    # Robot 1 collides in step 2; robot 0's last step is taken off, and its state is worth 7.
    data = made(
        active=[[[1, 1]] * 3],
        done=[[0, 0, 1]],
        terminated=[[[0, 0], [0, 0], [0, 1]]],
        decided=[[[1, 1]] * 3],
        reward=[[[1, 1], [1, 1], [50, -20]]],
        value=[[[5, 5], [6, 6], [7, 7], [99, 99]]],
    )
    of = streams(data.steps)
    assert of.cut[0].tolist() == [[False, False], [False, False], [True, False]]
    assert of.counts[0].tolist() == [[True, True], [True, True], [False, True]]
    advantage, _ = step_advantages(of, data.reward, data.value, 0.5, 0.0)
    macro, _, where = macro_advantages(of, data.decided, data.reward, data.value, 0.5, 0.0)
    for advantages in (advantage, macro):
        assert advantages[0, :2].tolist() == [[1 + 3 - 5, 1 + 3 - 5], [1 + 3.5 - 6, 1 + 3.5 - 6]]
        assert advantages[0, 2, 1].item() == -20 - 7
    assert where[0].tolist() == of.counts[0].tolist()


@pytest.mark.parametrize(
    ("name", "changes", "share"),
    [("mappo", {}, 1.0), ("ippo", {}, 0.0), ("ippo", {"team_reward": True}, 1.0)],
)
def test_who_arrives_early_is_paid_for_the_team_unless_everyone_is_for_himself(
    name: str, changes: dict[str, bool], share: float
) -> None:
    scenario = Scenario(humans=0, robots=2)
    model = policy("flat")
    with torch.no_grad():  # straight ahead, at full speed
        for head in (networks.heads[LOCAL] for networks in model.networks):
            head.body[-1].weight.zero_()
            head.body[-1].bias.copy_(torch.tensor([0.8, 0.0, 0.0]))
            head.log_std.fill_(-20.0)
    learner = algorithm(model, name, gae_lambda=1.0, discount=0.9, **changes)
    going = collector(model, 1, 24, scenario)
    state = going.world.state
    for n, far in enumerate((1.5, 3.5)):
        goal, start = state.robot_goal[0, n], state.robot_start[0, n]
        ahead = (goal - start) / np.linalg.norm(goal - start)
        state.robot_position[0, n] = goal - far * ahead
        state.robot_heading[0, n] = np.arctan2(ahead[1], ahead[0])
    going.observation = going.world.observe()
    rollout = going.collect(learner.reward_shaping)
    steps = rollout.steps
    end = int(steps["next", "done"][0, :, 0].nonzero()[0])
    early = int((~steps["agents", "active_mask"][0, :, 0]).nonzero()[0])
    assert 0 < early < end - 3
    assert steps["next", "agents", "terminated"][0, end].all()
    rewards = [float(r) for r in steps["next", "agents", "reward"][0, : end + 1, 0]]
    assert rewards[-1] == pytest.approx(share * scenario.reward.team)
    with torch.no_grad():  # all values are zero
        for parameter in learner.critics[LOCAL].last.parameters():
            parameter.zero_()
    features = torch.zeros(1, 25, 2, learner.config.critic_features)
    target = learner._level_data(LOCAL, rollout, features)["value_target"]
    expected = sum(0.9**k * r for k, r in enumerate(rewards))
    assert target[0, 0, 0].item() == pytest.approx(expected, rel=1e-4)
