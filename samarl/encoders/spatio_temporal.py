"""SAMARL's hybrid spatio-temporal transformer (SAMARL, Sec. IV-A, Eq. 5-8).

Shapes: B robots (of all worlds), T frames, M agents of one kind, D features, H frames of history.
Humans and robots go through separate blocks. What is not known is masked everywhere, and every
attention also offers a learned "nobody" key, so the result is finite with nobody in view.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from samarl.encoders.encoder import (
    NEAR_NOW,
    NEAR_SOON,
    POSITION,
    Encoder,
    Frames,
    encoder_named,
)

_MASKED = -1e9


def _attend(query: Tensor, key_value: Tensor, mask: Tensor, heads: int) -> Tensor:
    """Multi-head attention (Eq. 5) of `query` [R, Q, D] over `key_value` [R, K, 2 D].

    `mask` is added to the scores and broadcasts to [R, heads, Q, K].
    """
    r, q, d = query.shape
    key, value = key_value.view(r, key_value.shape[1], 2, heads, d // heads).permute(2, 0, 3, 1, 4)
    query = query.view(r, q, heads, d // heads).transpose(1, 2)
    mask = mask.expand(r, heads, q, key.shape[2])
    out = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
    return out.transpose(1, 2).reshape(r, q, d)


def nearness(others: Tensor, known: Tensor, heads: int) -> Tensor:
    """What is added to the scores [R, heads, M] of a robot's attention over others [R, M, F].

    Nearer agents matter more: to the even heads those that are near now, to the odd ones those
    whose closest approach ahead is near and soon, each less by 1 per metre. Attention that begins
    with equal shares learns to tell agents apart too late.
    """
    now, soon = (others[..., k].clamp_min(1e-20).log() / 2 for k in (NEAR_NOW, NEAR_SOON))
    score = torch.stack([(now, soon)[head % 2] for head in range(heads)], 1)
    return torch.where(known.unsqueeze(1), score, _MASKED)


class Pool(nn.Module):
    """Attention of the robot itself over a set of agents, with a key for "nobody"."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.nobody = nn.Parameter(torch.zeros(2 * width))
        self.out = nn.Linear(width, width)

    def forward(self, own: Tensor, tokens: Tensor, score: Tensor) -> Tensor:
        """Summary [R, D] of `tokens` [R, M, D] for the robot's own embedding [R, D].

        `score` [R, heads, M] is added to the attention's own, see `nearness`.
        """
        return self.out(_attend(*self._asked(own, tokens, score), self.heads).squeeze(1))

    def shares(self, own: Tensor, tokens: Tensor, score: Tensor) -> Tensor:
        """The share of the attention that each of the M gets, [R, M]; "nobody" gets the rest."""
        query, key_value, mask = self._asked(own, tokens, score)
        r, keys, d = len(query), key_value.shape[1], query.shape[2] // self.heads
        key = key_value.view(r, keys, 2, self.heads, d)[:, :, 0]
        found = torch.einsum("rhd,rkhd->rhk", query.view(r, self.heads, d), key) / d**0.5
        return torch.softmax(found + mask[:, :, 0], -1).mean(1)[:, 1:]

    def _asked(self, own: Tensor, tokens: Tensor, score: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Query, keys with values, and mask, as `_attend` takes them."""
        nobody = self.nobody.expand(len(tokens), 1, -1)
        key_value = torch.cat([nobody, self.key_value(tokens)], 1)
        mask = functional.pad(score, (1, 0)).unsqueeze(2)
        return self.query(own).unsqueeze(1), key_value, mask


class SpatialTransformer(nn.Module):
    """Agents of one frame: attention and graph convolution, fused by a gate (Eq. 6).

    The graph is weighted by proximity, exp(-distance / 2 m): near agents matter more.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.graph = nn.Linear(width, width)
        self.gate = nn.Linear(2 * width, width)
        self.pool = Pool(width, heads)

    def forward(self, tokens: Tensor, others: Tensor, known: Tensor) -> Tensor:
        """The tokens [R, M, D] of R robot-frames, each knowing of the others.

        Args:
            tokens: [R, M, D] embeddings.
            others: [R, M, F] what is known of them.
            known: [R, M].
        """
        if tokens.shape[1] == 0:
            return tokens
        normed, position = self.norm(tokens), others[..., POSITION].contiguous()
        masked = torch.where(known, 0.0, _MASKED)
        attention = _attend(
            self.query(normed), self.key_value(normed), masked[:, None, None, :], self.heads
        )
        near = torch.softmax(-2.5 * torch.cdist(position, position) + masked.unsqueeze(1), -1)
        graph = torch.relu(torch.bmm(near, self.graph(normed)))
        gate = torch.sigmoid(self.gate(torch.cat([attention, graph], -1)))
        return tokens + torch.lerp(graph, attention, gate)


class Window(NamedTuple):
    """What the temporal transformer keeps of the last H frames, the newest last."""

    key_value: Tensor  # [B, M, H, 2 D]
    known: Tensor  # [B, M, H] in this episode

    def follow(self, key_value: Tensor, known: Tensor, begins: Tensor) -> Window:
        """One frame later: keys and values [B, M, 2 D], `known` [B, M], `begins` [B]."""
        past = self.known[:, :, 1:] & ~begins[:, None, None]
        return Window(
            torch.cat([self.key_value[:, :, 1:], key_value.unsqueeze(2)], 2),
            torch.cat([past, known.unsqueeze(2)], 2),
        )


class TemporalTransformer(nn.Module):
    """Each agent along its own last H frames, causal (Eq. 6).

    Recent frames weigh more by a fixed slope per head, so heads look back differently far.
    """

    slopes: Tensor  # [heads]

    def __init__(self, width: int, heads: int, history: int) -> None:
        super().__init__()
        self.heads = heads
        self.history = history
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.register_buffer("slopes", 2.0 ** -torch.arange(heads), persistent=False)
        self.pool = Pool(width, heads)

    def forward(self, tokens: Tensor, known: Tensor, begins: Tensor) -> Tensor:
        """Tokens [B, M, T - H + 1, D] of the frames that have H - 1 frames before them.

        Args:
            tokens: [B, M, T, D] embeddings of all frames.
            known: [B, M, T].
            begins: [B, T] whether an episode begins with a frame.
        """
        b, m, t, d = tokens.shape
        normed = self.norm(tokens)
        present = normed[:, :, self.history - 1 :]
        if self.history == 1:
            return tokens + self.key_value(normed)[..., d:]
        episode = begins.long().cumsum(1)
        frame = torch.arange(t, device=tokens.device)
        lag = frame[self.history - 1 :].unsqueeze(1) - frame  # [T', T]
        allowed = (lag >= 0) & (lag < self.history)
        allowed = allowed & (episode[:, self.history - 1 :].unsqueeze(2) == episode.unsqueeze(1))
        allowed = allowed.unsqueeze(1) & known.unsqueeze(2)  # [B, M, T', T]
        bias = -self.slopes[:, None, None] * lag.clamp_min(0)
        mask = bias + torch.where(allowed, 0.0, _MASKED).flatten(0, 1).unsqueeze(1)
        query, key_value = self.query(present), self.key_value(normed)
        timed = _attend(query.flatten(0, 1), key_value.flatten(0, 1), mask, self.heads)
        return tokens[:, :, self.history - 1 :] + timed.view(b, m, present.shape[2], d)

    def step(self, tokens: Tensor, window: Window) -> Tensor:
        """Tokens [B, M, D] of the newest frame over the window that ends with it."""
        b, m, d = tokens.shape
        lag = torch.arange(self.history - 1, -1, -1, device=tokens.device)
        bias = (-self.slopes[:, None] * lag).unsqueeze(1)  # [heads, 1, H]
        mask = bias + torch.where(window.known, 0.0, _MASKED).view(b * m, 1, 1, self.history)
        query = self.query(self.norm(tokens)).view(b * m, 1, d)
        return tokens + _attend(query, window.key_value.flatten(0, 1), mask, self.heads).view(
            b, m, d
        )


class Block(nn.Module):
    """Embedding, spatial and temporal transformer of one kind of agent."""

    def __init__(self, ego: int, other: int, width: int, heads: int, history: int) -> None:
        super().__init__()
        self.embed_ego = nn.Linear(ego, width)
        self.embed_other = nn.Linear(other, width)
        self.embed = nn.Linear(width, width)
        for layer in (self.embed_ego, self.embed_other, self.embed):
            nn.init.orthogonal_(layer.weight, gain=2**0.5)
        self.spatial = SpatialTransformer(width, heads)
        self.temporal = TemporalTransformer(width, heads, history)

    def forward(
        self, own: Tensor, ego: Tensor, others: Tensor, known: Tensor, begins: Tensor
    ) -> list[Tensor]:
        """Spatial and temporal feature, each [B T', D], of the frames after the first H - 1."""
        past = self.temporal.history - 1
        tokens = self._embedded(ego, others)  # [B, T, M, D]
        timed = self.temporal(tokens.transpose(1, 2), known.transpose(1, 2), begins)
        tokens, timed, others, known = (
            tensor.flatten(0, 1)
            for tensor in (
                tokens[:, past:],
                timed.transpose(1, 2),
                others[:, past:],
                known[:, past:],
            )
        )
        return self._features(own, tokens, timed, others, known)

    def step(
        self,
        own: Tensor,
        ego: Tensor,
        others: Tensor,
        known: Tensor,
        begins: Tensor,
        window: Window,
    ) -> tuple[list[Tensor], Window]:
        """The same of one more frame (T = 1), and the window that ends with it."""
        tokens = self._embedded(ego, others)[:, 0]
        temporal = self.temporal
        key_value = temporal.key_value(temporal.norm(tokens))
        window = window.follow(key_value, known[:, 0], begins)
        timed = temporal.step(tokens, window)
        return self._features(own, tokens, timed, others[:, 0], known[:, 0]), window

    def attention(self, own: Tensor, ego: Tensor, others: Tensor, known: Tensor) -> Tensor:
        """The shares [B, M] of the robot's attention in one frame (T = 1)."""
        tokens, others, known = self._embedded(ego, others)[:, 0], others[:, 0], known[:, 0]
        score = nearness(others, known, self.spatial.heads)
        return self.spatial.pool.shares(own, self.spatial(tokens, others, known), score)

    def _features(
        self, own: Tensor, tokens: Tensor, timed: Tensor, others: Tensor, known: Tensor
    ) -> list[Tensor]:
        score = nearness(others, known, self.spatial.heads)
        spatial = self.spatial(tokens, others, known)
        return [
            pool(own, both, score)
            for pool, both in ((self.spatial.pool, spatial), (self.temporal.pool, timed))
        ]

    def _embedded(self, ego: Tensor, others: Tensor) -> Tensor:
        embedded = self.embed_other(others) + self.embed_ego(ego).unsqueeze(2)
        return self.embed(torch.relu(embedded))


class CrossModal(nn.Module):
    """Each of the four features queries their concatenation, then a transformer (Eq. 7)."""

    def __init__(self, width: int, heads: int, out: int) -> None:
        super().__init__()
        self.cross = nn.MultiheadAttention(width, heads, batch_first=True)
        self.norm = nn.LayerNorm(width)
        self.final = nn.TransformerEncoderLayer(
            width, heads, 2 * width, dropout=0.0, batch_first=True, norm_first=True
        )
        self.out = nn.Linear(5 * width, out)

    def forward(self, own: Tensor, modalities: Tensor) -> Tensor:
        """Y [R, out] from the robot's own embedding [R, D] and the features [R, 4, D]."""
        fused = self.norm(modalities)
        crossed, _ = self.cross(fused, fused, fused, need_weights=False)
        final = self.final(modalities + crossed)
        return torch.relu(self.out(torch.cat([own, final.flatten(1)], -1)))


@encoder_named("spatio_temporal")
class SpatioTemporalEncoder(Encoder):
    """Y_t of each robot from what it knew in its last H frames (Eq. 8)."""

    def __init__(
        self, ego_features: int, other_features: int, width: int, heads: int, history: int, out: int
    ) -> None:
        """See `Encoder`."""
        super().__init__(ego_features, other_features, width, heads, history, out)
        self.width = width
        self.own = nn.Sequential(nn.Linear(ego_features, width), nn.ReLU(), nn.Linear(width, width))
        self.humans = Block(ego_features, other_features, width, heads, history)
        self.robots = Block(ego_features, other_features, width, heads, history)
        self.cross = CrossModal(width, heads, out)

    def forward(self, frames: Frames, begins: Tensor) -> Tensor:
        """See `Encoder.forward`.

        A frame's embedding, keys and values are computed once, however many windows it is in.
        """
        past = self.history - 1
        own = self.own(frames.ego[:, past:]).flatten(0, 1)
        features = [
            *self.robots(own, frames.ego, frames.robots, frames.robots_known, begins),
            *self.humans(own, frames.ego, frames.humans, frames.humans_known, begins),
        ]
        y = self.cross(own, torch.stack(features, 1))
        return y.unflatten(0, frames.ego[:, past:].shape[:2])

    def windows(self, frame: Frames) -> tuple[Window, Window]:
        """Empty windows of robots and humans."""

        def empty(known: Tensor) -> Window:
            b, _, m = known.shape
            key_value = frame.ego.new_zeros(b, m, self.history, 2 * self.width)
            return Window(key_value, known.new_zeros(b, m, self.history))

        return empty(frame.robots_known), empty(frame.humans_known)

    def step(
        self, frame: Frames, begins: Tensor, windows: tuple[Window, Window]
    ) -> tuple[Tensor, tuple[Window, Window]]:
        """See `Encoder.step`; the earlier frames are not computed again."""
        own = self.own(frame.ego[:, 0])
        f, robots, humans = frame, *windows
        of_robots, robots = self.robots.step(own, f.ego, f.robots, f.robots_known, begins, robots)
        of_humans, humans = self.humans.step(own, f.ego, f.humans, f.humans_known, begins, humans)
        return self.cross(own, torch.stack([*of_robots, *of_humans], 1)), (robots, humans)

    def attention(self, frame: Frames) -> tuple[Tensor, Tensor]:
        """How each robot's spatial attention is shared out in one frame (T = 1).

        Returns:
            Over the other robots [B, N - 1] and over the humans [B, M].
        """
        own, f = self.own(frame.ego[:, 0]), frame
        return (
            self.robots.attention(own, f.ego, f.robots, f.robots_known),
            self.humans.attention(own, f.ego, f.humans, f.humans_known),
        )
