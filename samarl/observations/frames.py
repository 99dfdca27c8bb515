"""The inputs of the networks: what robots know, as scaled tensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad
from torch.utils._pytree import tree_map

from mrsan.observation import named_arrays, parts_of_named


@dataclass(frozen=True)
class FeatureSizes:
    """The number of features of each part of a frame."""

    ego: int
    entities: dict[str, int]  # of each group
    sensors: dict[str, tuple[int, ...]]  # the shape of each sensor's values


class EntityFeatures(NamedTuple):
    """One group of entities; features are zero where the mask is False."""

    features: Tensor  # [B, T, slots, F]
    mask: Tensor  # [B, T, slots] bool: known


class Frames(NamedTuple):
    """What B robots knew in T frames, scaled for the networks by `features.py`.

    Encoders read the groups and sensors they know and ignore the others.
    """

    ego: Tensor  # [B, T, F_e]
    entities: dict[str, EntityFeatures]
    sensors: dict[str, Tensor]  # [B, T, ...]

    @property
    def humans(self) -> Tensor:
        """Return the features of people, [B, T, M, F_o]."""
        return self.entities["humans"].features

    @property
    def humans_known(self) -> Tensor:
        """Return which people are known, [B, T, M]."""
        return self.entities["humans"].mask

    @property
    def robots(self) -> Tensor:
        """Return the features of the other robots, [B, T, N - 1, F_o]."""
        return self.entities["robots"].features

    @property
    def robots_known(self) -> Tensor:
        """Return which other robots are known, [B, T, N - 1]."""
        return self.entities["robots"].mask

    @property
    def sizes(self) -> FeatureSizes:
        """Return the number of features of each part."""
        return FeatureSizes(
            self.ego.shape[-1],
            {name: group.features.shape[-1] for name, group in self.entities.items()},
            {name: tuple(values.shape[2:]) for name, values in self.sensors.items()},
        )

    def select(self, sizes: FeatureSizes) -> Frames:
        """Return the groups and sensors that `sizes` names, and as many features of the robots."""
        entities = {name: self.entities[name] for name in sizes.entities}
        sensors = {name: self.sensors[name] for name in sizes.sensors}
        return Frames(self.ego[..., : sizes.ego], entities, sensors)

    def map(self, function: Callable[[Tensor], Tensor]) -> Frames:
        """Apply a function to every tensor."""
        return Frames(
            function(self.ego),
            {
                name: EntityFeatures(function(features), function(mask))
                for name, (features, mask) in self.entities.items()
            },
            {name: function(values) for name, values in self.sensors.items()},
        )

    def at(self, frames: slice) -> Frames:
        """Return some of the frames."""
        return self.map(lambda tensor: tensor[:, frames])

    def of(self, robots: Tensor | slice) -> Frames:
        """Return the frames of some robots."""
        return self.map(lambda tensor: tensor[robots])

    def split(self, robots: int) -> list[Frames]:
        """Split into parts of at most `robots` robots; no robots make one part."""
        starts = range(0, max(len(self.ego), 1), robots)
        return [self.of(slice(start, start + robots)) for start in starts]

    def to(self, device: torch.device) -> Frames:
        """Return the frames on another device."""
        return self.map(lambda tensor: tensor.to(device, non_blocking=True))

    def tensors(self) -> list[Tensor]:
        """Return all tensors in a fixed order."""
        groups = (tensor for group in self.entities.values() for tensor in group)
        return [self.ego, *groups, *self.sensors.values()]

    def named(self) -> dict[str, Tensor]:
        """Return all tensors by flat names: `ego`, `GROUP`, `GROUP_known`, and the sensors."""
        return {**named_arrays(self.ego, self.entities, "known"), **self.sensors}

    @staticmethod
    def from_named(tensors: Mapping[str, Tensor]) -> Frames:
        """Return the frames whose `named` tensors these are."""
        ego, groups, sensors = parts_of_named(tensors, "known")
        return Frames(ego, {name: EntityFeatures(*g) for name, g in groups.items()}, sensors)

    @staticmethod
    def cat(parts: Sequence[Frames], dimension: int) -> Frames:
        """Concatenate along the robots (0) or the frames (1)."""
        return tree_map(lambda *tensors: torch.cat(tensors, dimension), *parts)

    @staticmethod
    def cat_padded(parts: Sequence[Frames]) -> Frames:
        """Concatenate along the robots; empty slots are added to smaller groups."""
        entities = {}
        for name in parts[0].entities:
            groups = [part.entities[name] for part in parts]
            slots = max(group.mask.shape[2] for group in groups)
            missing = [slots - group.mask.shape[2] for group in groups]
            pairs = list(zip(groups, missing, strict=True))
            entities[name] = EntityFeatures(
                torch.cat([pad(group.features, (0, 0, 0, more)) for group, more in pairs]),
                torch.cat([pad(group.mask, (0, more)) for group, more in pairs]),
            )
        return Frames(
            torch.cat([part.ego for part in parts]),
            entities,
            {name: torch.cat([part.sensors[name] for part in parts]) for name in parts[0].sensors},
        )
