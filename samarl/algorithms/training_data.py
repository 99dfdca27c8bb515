"""What the losses of PPO read: the robots of all rollouts together.

Rollouts of different scenarios have different numbers of slots for people and robots. Empty slots
are added where that costs little, so that one pass of the networks serves them all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor
from torch.utils._pytree import tree_leaves, tree_map

from samarl.observations.frames import Frames, concatenate
from samarl.policies.stochastic import Sequences

MAX_PADDING = 2.5  # rollouts are merged if that multiplies the number of slots by at most this


class TrainingData(NamedTuple):
    """T steps of B robots, from one or several rollouts."""

    sequences: Sequences  # [B, h + T + 1, ...] what the actors observed
    critic_frames: Frames  # [B, T + 1, ...] what the critics observe
    levels: dict[str, TensorDict]  # [B, T] see `PPO.prepare`
    selected: Tensor  # [B, T] bool: the policy learns from this step
    robot: Tensor  # [B] the index of the robot within its team
    sequence: Tensor  # [B] the index of the sequence, which has the rows of a whole team

    def of(self, rows: Tensor) -> TrainingData:
        """Return some rows: those of whole sequences."""
        sets = len(self.sequences.encoder_states)
        states = tuple(
            tree_map(lambda tensor, i=i: tensor[rows[i::sets] // sets], state)
            for i, state in enumerate(self.sequences.encoder_states)
        )
        return TrainingData(
            Sequences(self.sequences.features.select(rows), self.sequences.is_init[rows], states),
            self.critic_frames.select(rows),
            {level: data[rows] for level, data in self.levels.items()},
            self.selected[rows],
            self.robot[rows],
            self.sequence[rows],
        )

    def minibatches(self, number: int) -> Iterator[TrainingData]:
        """Shuffle the sequences into minibatches, copied one at a time; some may be empty."""
        sequences = int(self.sequence[-1]) + 1
        order = torch.randperm(sequences)
        minibatch = torch.empty(sequences, dtype=torch.long)
        for index, part in enumerate(order.tensor_split(number)):
            minibatch[part] = index
        of_row = minibatch.to(self.sequence.device)[self.sequence]
        for index in range(number):
            yield self.of((of_row == index).nonzero().squeeze(1))


def merge(parts: Sequence[TrainingData]) -> list[TrainingData]:
    """Merge the data of several rollouts as far as padding costs little, see `MAX_PADDING`."""
    merged: list[list[TrainingData]] = []
    for part in sorted(parts, key=_slots):
        if merged and _can_merge([*merged[-1], part]):
            merged[-1].append(part)
        else:
            merged.append([part])
    return [_concatenate(group) for group in merged]


def _slots(data: TrainingData) -> int:
    """Return the number of entities in a frame."""
    return sum(group.mask.shape[2] for group in data.sequences.features.entities.values())


def _can_merge(parts: list[TrainingData]) -> bool:
    rows = sum(len(part.robot) for part in parts)
    slots = sum(len(part.robot) * _slots(part) for part in parts)
    # The memory of recurrent encoders has one entry for each agent, in the encoder's own order.
    shapes = {
        tuple(leaf.shape[1:] for leaf in tree_leaves(part.sequences.encoder_states))
        for part in parts
    }
    padded = sum(
        max(part.sequences.features.entities[group].mask.shape[2] for part in parts)
        for group in parts[0].sequences.features.entities
    )
    return len(shapes) == 1 and rows * padded <= MAX_PADDING * slots


def _concatenate(parts: list[TrainingData]) -> TrainingData:
    if len(parts) == 1:
        return parts[0]
    firsts = [0]
    for part in parts[:-1]:
        firsts.append(firsts[-1] + int(part.sequence[-1]) + 1)
    encoder_states = tree_map(
        lambda *tensors: torch.cat(tensors), *(part.sequences.encoder_states for part in parts)
    )
    return TrainingData(
        Sequences(
            concatenate([part.sequences.features for part in parts]),
            torch.cat([part.sequences.is_init for part in parts]),
            encoder_states,
        ),
        concatenate([part.critic_frames for part in parts]),
        {level: torch.cat([part.levels[level] for part in parts]) for level in parts[0].levels},
        torch.cat([part.selected for part in parts]),
        torch.cat([part.robot for part in parts]),
        torch.cat([part.sequence + first for part, first in zip(parts, firsts, strict=True)]),
    )
