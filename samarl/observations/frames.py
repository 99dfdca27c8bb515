"""The inputs of the networks: what robots know, as scaled tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.utils._pytree import tree_map

from mrsan import Entities, Observation

# What B robots knew in T frames, [B, T, ...], scaled for the networks by `features.py`. Encoders
# read the groups and sensors they know and ignore the others.
Frames = Observation[Tensor]


@dataclass(frozen=True)
class FeatureSizes:
    """The number of features of each part of a frame."""

    ego: int
    entities: dict[str, int]  # of each group
    sensors: dict[str, tuple[int, ...]]  # the shape of each sensor's values

    @staticmethod
    def of(frames: Frames) -> FeatureSizes:
        """Return the sizes of some frames."""
        return FeatureSizes(
            frames.ego.shape[-1],
            {name: group.features.shape[-1] for name, group in frames.entities.items()},
            {name: tuple(values.shape[2:]) for name, values in frames.sensors.items()},
        )

    def select(self, frames: Frames) -> Frames:
        """Return the groups and sensors with a size, and as many features of the robots."""
        entities = {name: frames.entities[name] for name in self.entities}
        sensors = {name: frames.sensors[name] for name in self.sensors}
        return Observation(frames.ego[..., : self.ego], entities, sensors)


def slice_time(frames: Frames, steps: slice) -> Frames:
    """Return some of the T frames."""
    return frames.apply(lambda tensor: tensor[:, steps])


def split(frames: Frames, rows: int) -> list[Frames]:
    """Split into parts of at most that many rows; no rows make one part."""
    starts = range(0, max(len(frames.ego), 1), rows)
    return [frames.select(slice(start, start + rows)) for start in starts]


def concatenate(parts: Sequence[Frames]) -> Frames:
    """Concatenate along the robots; empty slots are added to smaller groups."""
    entities = {}
    for name in parts[0].entities:
        groups = [part.entities[name] for part in parts]
        slots = max(group.mask.shape[2] for group in groups)
        missing = [slots - group.mask.shape[2] for group in groups]
        pairs = list(zip(groups, missing, strict=True))
        entities[name] = Entities(
            torch.cat([pad(group.features, (0, 0, 0, more)) for group, more in pairs]),
            torch.cat([pad(group.mask, (0, more)) for group, more in pairs]),
        )
    egos, sensors = zip(*((part.ego, part.sensors) for part in parts), strict=True)
    return Observation(torch.cat(egos), entities, tree_map(lambda *s: torch.cat(s), *sensors))
