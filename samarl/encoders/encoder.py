"""What every encoder is given and gives, and the names they are known by."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

ENCODERS: dict[str, type[Encoder]] = {}


def encoder_named(name: str) -> Callable[[type[Encoder]], type[Encoder]]:
    """Make a class known as `architecture.encoder=name`."""

    def register(encoder: type[Encoder]) -> type[Encoder]:
        ENCODERS[name] = encoder
        return encoder

    return register


POSITION = slice(0, 2)  # where in F_h and F_r: seen from the robot, in units of 5 m
NEAR_NOW = 5  # exp(-2 gap), gap the distance between surfaces in m
NEAR_SOON = 8  # the same of the closest approach ahead, times exp(-0.5 t), t s away


class Frames(NamedTuple):
    """What B robots knew in T frames, scaled for the network."""

    ego: Tensor  # [B, T, F_e]
    humans: Tensor  # [B, T, M, F_h]
    humans_known: Tensor  # [B, T, M] bool
    robots: Tensor  # [B, T, N - 1, F_r]
    robots_known: Tensor  # [B, T, N - 1] bool

    def at(self, frames: slice) -> Frames:
        """Some of the frames."""
        return Frames(*(tensor[:, frames] for tensor in self))

    def of(self, robots: Tensor | slice) -> Frames:
        """Some of the robots."""
        return Frames(*(tensor[robots] for tensor in self))

    def to(self, device: torch.device) -> Frames:
        """The same on another device."""
        return Frames(*(tensor.to(device, non_blocking=True) for tensor in self))

    @staticmethod
    def joined(parts: Sequence[Frames], dimension: int) -> Frames:
        """Several as one, joined along the robots (0) or the frames (1)."""
        return Frames(*(torch.cat(tensors, dimension) for tensors in zip(*parts, strict=True)))


class Encoder(nn.Module, ABC):
    """From what a robot knew in its last H frames to a feature Y for its actors.

    Shapes: B robots (of all worlds), T frames, H frames of history. A subclass need define
    `forward` alone; what holds for all: any number of humans and robots, finite with nobody
    known, and no difference whatever stands in the slots of those who are not known.
    """

    def __init__(
        self, ego_features: int, other_features: int, width: int, heads: int, history: int, out: int
    ) -> None:
        """Make the encoder.

        Args:
            ego_features: F_e.
            other_features: F_h and F_r.
            width: D.
            heads: of every attention.
            history: H, frames; 1 has no memory.
            out: length of Y.
        """
        super().__init__()
        self.history = history

    @abstractmethod
    def forward(self, frames: Frames, begins: Tensor) -> Tensor:
        """Y [B, T - H + 1, out] of every frame that has H - 1 frames before it.

        Args:
            frames: T >= H frames of each robot; those before the first of an episode are ignored.
            begins: [B, T] bool, whether an episode begins with this frame.
        """

    def windows(self, frame: Frames) -> Any:
        """What `step` remembers, before the first frame; `frame` is an example of one."""
        past = self.history - 1
        frames = Frames(
            *(tensor.new_zeros(len(tensor), past, *tensor.shape[2:]) for tensor in frame)
        )
        return frames, frame.ego.new_ones(len(frame.ego), past, dtype=torch.bool)

    def step(self, frame: Frames, begins: Tensor, windows: Any) -> tuple[Tensor, Any]:
        """Y [B, out] of one more frame, and what to remember.

        Args:
            frame: what each robot knows now, T = 1.
            begins: [B] bool, whether an episode begins with this frame.
            windows: of the last step.
        """
        past, past_begins = windows
        frames = Frames.joined([past, frame], 1)
        all_begins = torch.cat([past_begins, begins.unsqueeze(1)], 1)
        y = self(frames, all_begins)[:, -1]
        return y, (frames.at(slice(1, None)), all_begins[:, 1:])

    def attention(self, frame: Frames) -> tuple[Tensor, Tensor] | None:
        """How each robot's attention is shared out in one frame (T = 1), for replays.

        Returns:
            Shares of the other robots [B, N - 1] and of the humans [B, M]; None: it has none.
        """
        return None
