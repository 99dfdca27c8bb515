"""Advantages and value targets of both levels, each on its own time axis.

Padding is masked out: its reward, value and next value are zero. Shapes: S sequences, T steps,
N robots, at most K macro actions per sequence.
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
    """Return advantages and value targets, [S, T, N], by generalised advantage estimation.

    Args:
        reward: [S, T, N]; that of a macro action is discounted within its duration.
        value: [S, T, N].
        next_value: [S, T, N] of the next state, before any reset.
        done: [S, T, N] the robot's stream ends with this step.
        terminated: [S, T, N] it ends in a value of 0; otherwise `next_value` bootstraps.
        discount: per environment step.
        gae_lambda: per decision.
        duration: [S, T, N] environment steps of each decision; None: always one.
    """
    estimator = GAE(
        gamma=discount, lmbda=gae_lambda, value_network=None, average_gae=False, vectorized=False
    )
    following = {
        "state_value": next_value,
        "reward": reward,
        "done": done,
        "terminated": terminated,
    }
    data = TensorDict(
        {
            "state_value": value.unsqueeze(-1),
            "next": TensorDict({k: v.unsqueeze(-1) for k, v in following.items()}, value.shape[:2]),
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
    last step is removed, and the value of the state before it, in which a decision was made, is
    bootstrapped.
    """

    counts: Tensor  # the step is neither padding nor removed
    acts: Tensor  # the step counts and the robot has not arrived
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
    stream: Streams, reward: Tensor, value: Tensor, discount: float, gae_lambda: float
) -> tuple[Tensor, Tensor]:
    """Return advantages and value targets, [S, T, N], of a level that decides in every step.

    Args:
        stream: see `streams`.
        reward: [S, T, N].
        value: [S, T + 1, N].
        discount: per step.
        gae_lambda: per step.
    """
    current_value, next_value = value[:, :-1], value[:, 1:]
    zero = torch.zeros_like(current_value)
    done = stream.terminated | stream.cut | ~(stream.counts | stream.cut)
    # A removed step yields its own value, so that the step before it bootstraps from it.
    reward = torch.where(stream.counts, reward, torch.where(stream.cut, current_value, zero))
    current_value = torch.where(stream.counts | stream.cut, current_value, zero)
    next_value = torch.where(stream.counts, next_value, zero)
    return advantages(reward, current_value, next_value, done, done, discount, gae_lambda)


class MacroRecords(NamedTuple):
    """The macro actions of each robot in order of time, [S, K, N] each."""

    reward: Tensor  # discounted within the duration
    duration: Tensor  # environment steps
    start: Tensor  # step in which the action was chosen
    end: Tensor  # last step of the action
    valid: Tensor  # False: padding
    terminated: Tensor  # the action ends in a value of zero
    done: Tensor  # the action is the last one of its stream


def macro_records(
    stream: Streams, decided: Tensor, reward: Tensor, discount: float
) -> MacroRecords:
    """Split streams at their macro decisions: R = sum of discount^j r_j over the duration.

    A robot that has arrived makes no decisions: its waiting is one more record, from which the
    critic learns the value of waiting. Steps of a decision of the previous rollout are in no
    record.

    Args:
        stream: see `streams`.
        decided: [S, T, N] a waypoint was chosen.
        reward: [S, T, N].
        discount: per step.
    """
    s, t, n = decided.shape
    false = torch.zeros_like(stream.counts[:, :1])
    waits = stream.counts & ~stream.acts
    waited_before = torch.cat([false, waits[:, :-1]], 1)
    starts = (decided & stream.acts) | (waits & ~waited_before)
    ended_before = torch.cat([false, (stream.terminated | stream.cut)[:, :-1]], 1)
    record = starts.long().cumsum(1) - 1  # [S, T, N] index of the record of each step
    # An episode starts with a decision, but after a part that does not count there may be steps
    # before the next decision: they are in no record.
    part = (~stream.counts).long().cumsum(1) + ended_before.long().cumsum(1)
    part_of_record = torch.where(starts, part, -1).cummax(1).values
    in_record = stream.counts & (record >= 0) & (part == part_of_record)
    k = max(int(record.max()) + 1, 1)
    record = record.clamp_min(0)
    step = torch.arange(t, device=decided.device).view(1, t, 1).expand(s, t, n)

    def reduce_per_record(values: Tensor, reduction: str, mask: Tensor) -> Tensor:
        result = values.new_zeros(s, k + 1, n)
        index = torch.where(mask, record, k)  # other steps go to an additional record
        return result.scatter_reduce(1, index, values, reduction, include_self=True)[:, :k]

    start = reduce_per_record(step, "amax", starts)
    steps_since_start = step - start.gather(1, record)
    total_reward = reduce_per_record(reward * discount**steps_since_start, "sum", in_record)
    duration = reduce_per_record(torch.ones_like(step), "sum", in_record)
    end = reduce_per_record(step, "amax", in_record)
    valid = duration > 0
    terminated = stream.terminated.gather(1, end) & valid
    next_start = torch.cat([start[:, 1:], start.new_full((s, 1, n), t + 1)], 1)
    is_followed = torch.cat([valid[:, 1:], false], 1) & (next_start == end + 1)
    done = terminated | ~is_followed
    return MacroRecords(total_reward, duration, start, end, valid, terminated | ~valid, done)


def macro_advantages(
    stream: Streams,
    decided: Tensor,
    reward: Tensor,
    value: Tensor,
    discount: float,
    gae_lambda: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return advantages and value targets in the first step of each record, and a mask of these.

    Args:
        stream: see `streams`.
        decided: [S, T, N] a waypoint was chosen.
        reward: [S, T, N].
        value: [S, T + 1, N].
        discount: per step.
        gae_lambda: per decision.

    Returns:
        Three tensors [S, T, N].
    """
    s, t, n = decided.shape
    records = macro_records(stream, decided, reward, discount)
    zero = value.new_zeros(())
    start_value = torch.where(records.valid, value.gather(1, records.start), zero)
    end_value = torch.where(records.valid, value.gather(1, records.end + 1), zero)
    per_record = advantages(
        records.reward,
        start_value,
        end_value,
        records.done,
        records.terminated,
        discount,
        gae_lambda,
        records.duration,
    )
    step = torch.where(records.valid, records.start, t)  # padding goes to an additional step
    advantage, target = (
        value.new_zeros(s, t + 1, n).scatter(1, step, values)[:, :t] for values in per_record
    )
    mask = torch.zeros(s, t + 1, n, dtype=torch.bool, device=value.device)
    return advantage, target, mask.scatter(1, step, True)[:, :t]
