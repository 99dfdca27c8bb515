"""Quantiles of prediction errors by dynamically tuned adaptive conformal inference.

Source: Gibbs and Candes, Conformal inference for online prediction with arbitrary distribution
shifts (2024), with the numbers of SoNIC. Where the algorithm draws one of its experts at random,
this one takes their weighted mean, so that episodes are reproducible.
"""

from __future__ import annotations

import torch
from torch import Tensor

ALPHA = 0.1  # share of errors that may exceed the quantile
RATES = (0.05, 0.1, 0.2)  # one expert each
WEIGHT_DECAY = 0.001  # share of the weights that becomes uniform
LOSS_SCALE = 2.72
LARGEST = 1.0  # m


class ErrorQuantiles:
    """For each of B robots, S people and K steps ahead: the 90 % quantile of the error, m."""

    def __init__(self, robots: int, people: int, steps: int) -> None:
        """Start without predictions; the first quantiles are 0.1 m, 0.2 m ..."""
        shape = robots, people, steps
        # Predictions made 1..K steps ago, each [1 + K, 2]; NaN where there is none.
        self._predictions = torch.full((robots, people, steps, 1 + steps, 2), torch.nan)
        self._quantile = torch.empty(*shape, len(RATES))
        self._weight = torch.empty(*shape, len(RATES))
        self._steps_ahead = torch.arange(1, steps + 1)
        self.reset(torch.ones(robots, dtype=torch.bool))

    def reset(self, robots: Tensor) -> None:
        """Forget everything about the robots [B] for which an episode begins."""
        self._predictions[robots] = torch.nan
        self._quantile[robots] = self._steps_ahead.unsqueeze(-1) / 10
        self._weight[robots] = 1 / len(RATES)

    def update(self, predicted: Tensor, visible: Tensor) -> Tensor:
        """Compare present positions with earlier predictions; return the quantiles, [B, S, K] in m.

        Args:
            predicted: [B, S, 1 + K, 2] present position and predictions in axes at rest, m.
            visible: [B, S] whose position is known.
        """
        past = self._predictions[:, :, self._steps_ahead - 1, self._steps_ahead]
        error = (predicted[:, :, :1] - past).norm(dim=-1, keepdim=True)
        self._learn(error, visible[:, :, None, None] & error.isfinite())
        newest = predicted.masked_fill(~visible[:, :, None, None], torch.nan).unsqueeze(2)
        self._predictions = torch.cat([newest, self._predictions[:, :, :-1]], 2)
        quantile = (self._weight * self._quantile).sum(-1).clamp(0.0, LARGEST)
        return quantile * visible.unsqueeze(-1)

    def _learn(self, error: Tensor, known: Tensor) -> None:
        """Update experts and weights by the errors [B, S, K, 1] where they are known."""
        exceeds = error - self._quantile
        loss = ALPHA * exceeds - exceeds.clamp_max(0.0)  # pinball loss
        step = torch.tensor(RATES) * (ALPHA - (exceeds > 0.0).float())
        self._quantile = torch.where(known, self._quantile - step, self._quantile)
        weight = self._weight * torch.exp(-LOSS_SCALE * loss)
        weight = (1 - WEIGHT_DECAY) * weight / weight.sum(-1, keepdim=True)
        weight = weight + WEIGHT_DECAY / len(RATES)
        self._weight = torch.where(known, weight, self._weight)
