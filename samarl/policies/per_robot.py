"""Parameters of their own for every robot, instead of shared ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.distributions import Independent, Normal
from torch.utils._pytree import tree_map

from samarl.encoders.encoder import Encoder, Frames


class PerRobotEncoder(nn.Module):
    """An encoder for each of N robots; row b of its inputs is of robot b % N."""

    def __init__(self, make: Callable[[], Encoder], robots: int) -> None:
        super().__init__()
        self.of = nn.ModuleList(make() for _ in range(robots))

    def forward(self, frames: Frames, begins: Tensor) -> Tensor:
        """See `Encoder.forward`."""
        return self._each(Encoder.__call__, frames, begins)

    def windows(self, frame: Frames) -> Any:
        """See `Encoder.windows`."""
        return self._each(lambda encoder, example: encoder.windows(example), frame)

    def step(self, frame: Frames, begins: Tensor, windows: Any) -> tuple[Tensor, Any]:
        """See `Encoder.step`."""
        return self._each(lambda encoder, *inputs: encoder.step(*inputs), frame, begins, windows)

    def attention(self, frame: Frames) -> tuple[Tensor, Tensor] | None:
        """See `Encoder.attention`."""
        if self.of[0].attention(frame) is None:  # type: ignore[operator]
            return None
        return self._each(lambda encoder, *inputs: encoder.attention(*inputs), frame)

    def _each(self, call: Callable, *inputs: Any) -> Any:
        n = len(self.of)
        outputs = [
            call(encoder, *(tree_map(lambda rows, i=i: rows[i::n], tree) for tree in inputs))
            for i, encoder in enumerate(self.of)
        ]
        return tree_map(lambda *parts: torch.stack(parts, 1).flatten(0, 1), *outputs)


class PerRobotGaussian(nn.Module):
    """A Gaussian head for each of N robots."""

    def __init__(self, make: Callable[[], nn.Module], robots: int) -> None:
        super().__init__()
        self.of = nn.ModuleList(make() for _ in range(robots))

    def forward(self, inputs: Tensor, robot: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation, [..., A], of inputs [..., F] of robots [...]."""
        outputs = [head(inputs, robot) for head in self.of]
        mean, deviation = (torch.stack(parts, -1) for parts in zip(*outputs, strict=True))
        own = robot[..., None, None].expand(*mean.shape[:-1], 1)
        return mean.gather(-1, own).squeeze(-1), deviation.gather(-1, own).squeeze(-1)

    def cap_deviation(self, largest: float) -> None:
        """Bring the standard deviation down to `largest` where it is above."""
        for head in self.of:
            head.cap_deviation(largest)  # type: ignore[operator]

    def distribution(self, inputs: Tensor, robot: Tensor) -> Independent:
        """The distribution of the action."""
        return Independent(Normal(*self(inputs, robot)), 1)
