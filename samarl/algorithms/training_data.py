"""What the losses of PPO read: the robots of all rollouts, in minibatches.

Rollouts of different scenarios have different numbers of slots for people and robots. In a
minibatch, empty slots are added where that costs little, so that one pass of the networks serves
them all.
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

MAX_PADDING = 1.3  # of encoders that compute empty slots as well


class TrainingData(NamedTuple):
    """T steps of B robots, from a rollout, or of a minibatch from several ones."""

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

    def shuffled(self, number: int) -> Tensor:
        """Draw the minibatch of each row [B]: whole sequences are shuffled."""
        sequences = int(self.sequence[-1]) + 1
        parts = torch.randperm(sequences).tensor_split(number)
        minibatch = torch.empty(sequences, dtype=torch.long)
        # In random order, as the first parts may be larger.
        for index, part in zip(torch.randperm(number).tolist(), parts, strict=True):
            minibatch[part] = index
        return minibatch.to(self.sequence.device)[self.sequence]


def minibatches(
    data: Sequence[TrainingData], number: int, max_padding: float = MAX_PADDING
) -> Iterator[list[TrainingData]]:
    """Shuffle the sequences of all rollouts into minibatches, which are copied one at a time.

    Each is in as few parts as `merge` allows, and may be empty.
    """
    minibatch = [part.shuffled(number) for part in data]
    for index in range(number):
        rows = [(of_row == index).nonzero().squeeze(1) for of_row in minibatch]
        pairs = zip(data, rows, strict=True)
        yield merge([part.of(of_part) for part, of_part in pairs if len(of_part)], max_padding)


def merge(parts: Sequence[TrainingData], max_padding: float = MAX_PADDING) -> list[TrainingData]:
    """Merge rollouts if that multiplies their number of slots by at most `max_padding`."""
    merged: list[list[TrainingData]] = []
    for part in sorted(parts, key=_slots):
        if merged and _can_merge([*merged[-1], part], max_padding):
            merged[-1].append(part)
        else:
            merged.append([part])
    return [_concatenate(group) for group in merged]


def _slots(data: TrainingData) -> int:
    """Return the number of entities in a frame."""
    return sum(group.mask.shape[2] for group in data.sequences.features.entities.values())


def _can_merge(parts: list[TrainingData], max_padding: float) -> bool:
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
    return len(shapes) == 1 and rows * padded <= max_padding * slots


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
