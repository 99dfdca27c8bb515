"""The ranges of a lidar, encoded by circular convolutions."""

from __future__ import annotations

from torch import Tensor, nn

_CHANNELS, _KERNEL, _STRIDE = 16, 5, 2


class RayEncoder(nn.Module):
    """Two circular convolutions over the rays, and a linear layer that keeps their directions.

    Rays of less than a full circle are padded as if their ends met, which the linear layer learns.
    """

    def __init__(self, rays: int, width: int) -> None:
        """Create the layers for `rays` rays; `width` is the length of the output."""
        super().__init__()
        padding, left = _KERNEL // 2, rays
        layers: list[nn.Module] = []
        for channels in (1, _CHANNELS):
            layers += [
                nn.Conv1d(
                    channels,
                    _CHANNELS,
                    _KERNEL,
                    _STRIDE,
                    padding=min(padding, left),
                    padding_mode="circular",
                ),
                nn.ReLU(),
            ]
            left = (left + 2 * min(padding, left) - _KERNEL) // _STRIDE + 1
        self.layers = nn.Sequential(
            *layers, nn.Flatten(), nn.Linear(_CHANNELS * left, width), nn.ReLU()
        )

    def forward(self, ranges: Tensor) -> Tensor:
        """Return the features [P, width] of scaled ranges [P, L]."""
        encoded: Tensor = self.layers(ranges.unsqueeze(1))
        return encoded
