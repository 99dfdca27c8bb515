"""The layers of the spatio-temporal transformer (SAMARL, Eq. 6)."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from samarl.encoders.frame_attention import (
    frame_attention,
    frame_attention_weights,
    proximity_convolution,
)
from samarl.encoders.windowed_attention import MASKED, windowed_attention
from samarl.observations.features import LENGTH_SCALE, NEAR_NOW, NEAR_SOON, POSITION


def nearness(others: Tensor, known: Tensor, heads: int) -> Tensor:
    """Return the bias [P, M, heads] of the scores of a robot's attention over others [P, M, F].

    It falls by 1 per metre: for even heads with the present distance, for odd heads with that of
    the closest approach ahead, and when it is later. Attention that starts with equal weights
    learns too late to tell agents apart.
    """
    now, soon = (others[..., k].clamp_min(1e-20).log() / 2 for k in (NEAR_NOW, NEAR_SOON))
    score = torch.stack([(now, soon)[head % 2] for head in range(heads)], -1)
    return torch.where(known.unsqueeze(-1), score, MASKED)


class Pool(nn.Module):
    """Attention of the robot itself over a set of agents, with a key for "nobody"."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.scale = (width // heads) ** -0.5
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.nobody = nn.Parameter(torch.zeros(2 * width))
        self.out = nn.Linear(width, width)

    def forward(self, own: Tensor, tokens: Tensor, score: Tensor) -> Tensor:
        """Return a summary [P, D] of `tokens` [P, M, D] for the robot's own embedding [P, D].

        `score` [P, M, heads] is added to the scores, see `nearness`.
        """
        return self.out(frame_attention(*self._attention_inputs(own, tokens, score)).squeeze(1))

    def weights(self, own: Tensor, tokens: Tensor, score: Tensor) -> Tensor:
        """Return the attention weights of the M agents, [P, M]; "nobody" has the rest."""
        weights = frame_attention_weights(*self._attention_inputs(own, tokens, score))
        return weights.mean(1)[:, 0, 1:]

    def _attention_inputs(
        self, own: Tensor, tokens: Tensor, score: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the query [P, 1, D], keys and values [P, 1 + M, 2 D] and scores, nobody first."""
        key_value = self.key_value(tokens)
        nobody = self.nobody.to(key_value.dtype).expand(len(tokens), 1, -1)
        query = (self.query(own) * self.scale).unsqueeze(1)
        return query, torch.cat([nobody, key_value], 1), functional.pad(score, (0, 0, 1, 0))


class SpatialTransformer(nn.Module):
    """Agents of one frame: attention and graph convolution, fused by a gate (Eq. 6).

    The graph is weighted by proximity, exp(-distance / 2 m): near agents matter more.
    """

    def __init__(self, width: int, heads: int, graph: bool) -> None:
        super().__init__()
        self.heads, self.scale, self.graph = heads, (width // heads) ** -0.5, graph
        self.norm = nn.LayerNorm(width)
        # Query, key, value, and the messages of the graph.
        self.project = nn.Linear(width, (4 if graph else 3) * width)
        if graph:
            self.gate = nn.Linear(2 * width, width)
        self.pool = Pool(width, heads)

    def forward(self, tokens: Tensor, others: Tensor, known: Tensor) -> Tensor:
        """Return the tokens [P, M, D] of P frames, each updated with the others.

        Args:
            tokens: [P, M, D] embeddings.
            others: [P, M, F] features of the agents.
            known: [P, M].
        """
        p, m, d = tokens.shape
        if m == 0:
            return tokens
        normed, sizes = self.norm(tokens), (d, 2 * d, d) if self.graph else (d, 2 * d)
        query, key_value, *messages = (  # separate products, so that each result is contiguous
            functional.linear(normed, weight, bias)
            for weight, bias in zip(
                self.project.weight.split(sizes), self.project.bias.split(sizes), strict=True
            )
        )
        masked = torch.where(known, 0.0, MASKED).unsqueeze(-1).expand(p, m, self.heads)
        attention = frame_attention(query * self.scale, key_value, masked)
        if not self.graph:
            return tokens + attention
        graph = torch.relu(
            proximity_convolution(messages[0], others[..., POSITION], known, LENGTH_SCALE / 2.0)
        )
        gate = torch.sigmoid(self.gate(torch.cat([attention, graph], -1)))
        return tokens + torch.lerp(graph, attention, gate)


class TemporalTransformer(nn.Module):
    """Each agent attends to its own last H frames, causally (Eq. 6).

    The scores of earlier frames fall with a fixed slope per head, so heads look back over different
    times.
    """

    slopes: Tensor  # [heads]

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.scale = (width // heads) ** -0.5
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.register_buffer("slopes", 2.0 ** -torch.arange(heads), persistent=False)
        self.pool = Pool(width, heads)

    def keys_values(self, tokens: Tensor) -> Tensor:
        """Return keys and values [..., 2 D] of a frame's tokens [..., D] for later frames."""
        return self.key_value(self.norm(tokens))

    def forward(self, tokens: Tensor, key_value: Tensor, window: Tensor, allowed: Tensor) -> Tensor:
        """Return the tokens [P, M, D] of P frames, each updated with its own past.

        Args:
            tokens: [P, M, D] embeddings of the present.
            key_value: [F, M, 2 D] `keys_values` of all frames.
            window: [P, H] indices of the last H, the present first.
            allowed: [P, H, M] whether a frame is of this episode and the agent was known in it.
        """
        query = self.query(self.norm(tokens)) * self.scale
        lag = torch.arange(window.shape[1], device=tokens.device)
        bias = -self.slopes.unsqueeze(1) * lag
        return tokens + windowed_attention(query, key_value, window, allowed, bias)
