"""What robots know, in the form that networks are given it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor


class Frames(NamedTuple):
    """What B robots knew in T frames, scaled for the networks (`features.py` says how)."""

    ego: Tensor  # [B, T, F_e]
    humans: Tensor  # [B, T, M, F_o]
    humans_known: Tensor  # [B, T, M] bool
    robots: Tensor  # [B, T, N - 1, F_o]
    robots_known: Tensor  # [B, T, N - 1] bool

    def at(self, frames: slice) -> Frames:
        """Some of the frames."""
        return Frames(*(tensor[:, frames] for tensor in self))

    def of(self, robots: Tensor | slice) -> Frames:
        """Some of the robots."""
        return Frames(*(tensor[robots] for tensor in self))

    def split(self, robots: int) -> list[Frames]:
        """In parts of at most so many robots; none make one part."""
        return [Frames(*tensors) for tensors in zip(*(t.split(robots) for t in self), strict=True)]

    def to(self, device: torch.device) -> Frames:
        """The same on another device."""
        return Frames(*(tensor.to(device, non_blocking=True) for tensor in self))

    @staticmethod
    def joined(parts: Sequence[Frames], dimension: int) -> Frames:
        """Several as one, joined along the robots (0) or the frames (1)."""
        return Frames(*(torch.cat(tensors, dimension) for tensors in zip(*parts, strict=True)))
