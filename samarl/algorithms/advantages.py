"""Advantages and value targets of both levels, each on its own time axis.

Padding is masked out: its reward, value and next value are zero.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.objectives.value import GAE


def advantages(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    done: Tensor,
    terminated: Tensor,
    discount: float,
    gae_lambda: float,
    duration: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Return advantage and value target, [S, T, N], by generalised advantage estimation.

    Args:
        reward: [S, T, N]; of a macro action already discounted within its duration.
        value: [S, T, N].
        next_value: [S, T, N] of the state each step led to, before any reset.
        done: [S, T, N] the robot's stream ends here.
        terminated: [S, T, N] it ends in a value of 0; where only `done`, `next_value` bootstraps.
        discount: per environment step.
        gae_lambda: per decision.
        duration: [S, T, N] environment steps of each decision; None: one each.
    """
    estimator = GAE(
        gamma=discount, lmbda=gae_lambda, value_network=None, average_gae=False, vectorized=False
    )
    after = {"state_value": next_value, "reward": reward, "done": done, "terminated": terminated}
    data = TensorDict(
        {
            "state_value": value.unsqueeze(-1),
            "next": TensorDict({k: v.unsqueeze(-1) for k, v in after.items()}, value.shape[:2]),
        },
        value.shape[:2],
    )
    if duration is not None:
        data["steps_to_next_obs"] = duration.unsqueeze(-1)
    result = estimator(data)
    return result["advantage"].squeeze(-1), result["value_target"].squeeze(-1)


class Streams(NamedTuple):
    """Which steps of each robot's stream count, and how the stream ends; [S, T, N] bool each.

    A stream lasts as long as the episode: a robot that has arrived waits for its team and receives
    the team's rewards. Where the time limit or a team-mate's collision cuts an episode short, its
    last step is removed: the value of the state before it, in which a decision was made, is
    bootstrapped.
    """

    counts: Tensor  # the step is neither padding nor removed
    acts: Tensor  # ... and the robot is on its way
    terminated: Tensor  # the stream ends with this step, in a value of zero
    cut: Tensor  # the stream was cut off before this step


def streams(steps: TensorDict) -> Streams:
    """Return the streams of the first T of T + 1 steps (see `Rollout`)."""
    active = steps["agents", "active_mask"][:, :-1]
    mask, done = steps["mask"][:, :-1].expand_as(active), steps["next", "done"][:, :-1]
    terminated = steps["next", "agents", "terminated"][:, :-1] & mask
    cut = done & ~terminated & mask
    counts = mask & ~cut
    return Streams(counts, counts & active, terminated, cut)


def step_advantages(
    of: Streams, reward: Tensor, value: Tensor, discount: float, gae_lambda: float
) -> tuple[Tensor, Tensor]:
    """Return advantage and value target, [S, T, N], of a level that decides in every step.

    Args:
        of: the streams.
        reward: [S, T, N].
        value: [S, T + 1, N].
        discount: per step.
        gae_lambda: per step.
    """
    now, after = value[:, :-1], value[:, 1:]
    zero = torch.zeros_like(now)
    last = of.terminated | of.cut | ~(of.counts | of.cut)
    # A removed step yields its own value, so that the step before it bootstraps from it.
    reward = torch.where(of.counts, reward, torch.where(of.cut, now, zero))
    now = torch.where(of.counts | of.cut, now, zero)
    return advantages(
        reward, now, torch.where(of.counts, after, zero), last, last, discount, gae_lambda
    )


class MacroRecords(NamedTuple):
    """The macro actions of a rollout, one after another per robot: [S, K, N]."""

    reward: Tensor  # discounted within the duration
    duration: Tensor  # environment steps
    start: Tensor  # the step in which each was chosen
    end: Tensor  # the last step of each
    valid: Tensor  # False: padding
    terminated: Tensor  # it ends in a value of zero
    done: Tensor  # nothing follows it in its stream


def macro_records(of: Streams, decided: Tensor, reward: Tensor, discount: float) -> MacroRecords:
    """Cut streams at their macro decisions: R = sum of discount^j r_j over the duration.

    A robot that has arrived makes no decisions: its waiting is one more record, from which the
    critic learns the value of waiting. The rest of a decision of the previous rollout is no record.

    Args:
        of: the streams.
        decided: [S, T, N] a waypoint was chosen.
        reward: [S, T, N].
        discount: per step.
    """
    s, t, n = decided.shape
    waits = of.counts & ~of.acts
    before = torch.cat([torch.zeros_like(waits[:, :1]), waits[:, :-1]], 1)
    starts = (decided & of.acts) | (waits & ~before)
    ended = torch.cat([torch.zeros_like(waits[:, :1]), (of.terminated | of.cut)[:, :-1]], 1)
    number = starts.long().cumsum(1) - 1  # [S, T, N] which record a step belongs to
    # An episode starts with a decision, but after a part that does not count there may be steps
    # before the next decision: they belong to no record.
    gap = (~of.counts).long().cumsum(1) + ended.long().cumsum(1)
    at_start = torch.where(starts, gap, -1).cummax(1).values
    belongs = of.counts & (number >= 0) & (gap == at_start)
    k = max(int(number.max()) + 1, 1)
    slot = number.clamp_min(0)
    step = torch.arange(t, device=decided.device).view(1, t, 1).expand(s, t, n)

    def gather(values: Tensor, reduce: str, where: Tensor) -> Tensor:
        out = values.new_zeros(s, k + 1, n)
        index = torch.where(where, slot, k)  # steps that do not count go to an extra slot
        return out.scatter_reduce(1, index, values, reduce, include_self=True)[:, :k]

    start = gather(step, "amax", starts)
    within = step - start.gather(1, slot)
    total = gather(reward * discount**within, "sum", belongs)
    duration = gather(torch.ones_like(step), "sum", belongs)
    end = gather(step, "amax", belongs)
    valid = duration > 0
    terminated = of.terminated.gather(1, end) & valid
    following = torch.cat([start[:, 1:], start.new_full((s, 1, n), t + 1)], 1)
    follows = torch.cat([valid[:, 1:], torch.zeros_like(valid[:, :1])], 1) & (following == end + 1)
    done = terminated | ~follows
    return MacroRecords(total, duration, start, end, valid, terminated | ~valid, done)


def macro_advantages(
    of: Streams, decided: Tensor, reward: Tensor, value: Tensor, discount: float, gae_lambda: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Return advantage and value target, [S, T, N] at the start of each record, and where one is.

    Args:
        of: the streams.
        decided: [S, T, N].
        reward: [S, T, N].
        value: [S, T + 1, N].
        discount: per step.
        gae_lambda: per decision.
    """
    s, t, n = decided.shape
    records = macro_records(of, decided, reward, discount)
    zero = value.new_zeros(())
    now = torch.where(records.valid, value.gather(1, records.start), zero)
    after = torch.where(records.valid, value.gather(1, records.end + 1), zero)
    found = advantages(
        records.reward,
        now,
        after,
        records.done,
        records.terminated,
        discount,
        gae_lambda,
        records.duration,
    )
    at = torch.where(records.valid, records.start, t)
    advantage, target = (value.new_zeros(s, t + 1, n).scatter(1, at, x)[:, :t] for x in found)
    where = torch.zeros(s, t + 1, n, dtype=torch.bool, device=value.device)
    return advantage, target, where.scatter(1, at, True)[:, :t]
