"""SAMARL's hybrid spatio-temporal transformer (Sec. IV-B, Eq. 5 to 8).

Humans and robots have blocks of their own, as they interact differently. A spatial transformer
relates the agents of one frame, a temporal one each agent's own history; the robot itself asks
both, and cross-modal attention fuses what it gets. Who is not known is masked everywhere, and every
question of the robot also has a learned "nobody" to turn to, so the result is finite with nobody
in view.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from mrsan import ConfigurationError
from mrsan.fields import required, setting
from samarl.encoders.encoder import ENCODERS, Encoder, State, frame_numbers
from samarl.encoders.frame_attention import frame_attention, frame_shares, proximity_convolution
from samarl.encoders.windowed_attention import MASKED, windowed_attention
from samarl.observations.features import LENGTH_SCALE, NEAR_NOW, NEAR_SOON, POSITION
from samarl.observations.frames import FeatureSizes, Frames


@dataclass
class SpatioTemporalConfig:
    """Sizes of the transformer."""

    width: int = required(8, 1024, help="width D of every token")
    heads: int = required(1, 64, help="attention heads")
    history: int = required(1, 64, help="history frames H; 1: no temporal transformer")
    features: int = required(8, 4096, help="length of the output Y")
    # Ablations:
    graph: bool = setting(True, kw_only=True, help="graph convolution weighted by proximity")
    cross_modal: bool = setting(True, kw_only=True, help="attention between the four features")
    one_block: bool = setting(False, kw_only=True, help="treat people and robots alike")


def nearness(others: Tensor, known: Tensor, heads: int) -> Tensor:
    """What is added to the scores [P, M, heads] of a robot's attention over others [P, M, F].

    Nearer agents matter more: to the even heads those that are near now, to the odd ones those
    whose closest approach ahead is near and soon, each less by 1 per metre. Attention that begins
    with equal shares learns to tell agents apart too late.
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
        """Summary [P, D] of `tokens` [P, M, D] for the robot's own embedding [P, D].

        `score` [P, M, heads] is added to the attention's own, see `nearness`.
        """
        return self.out(frame_attention(*self._asked(own, tokens, score)).squeeze(1))

    def shares(self, own: Tensor, tokens: Tensor, score: Tensor) -> Tensor:
        """The share of the attention that each of the M gets, [P, M]; "nobody" gets the rest."""
        return frame_shares(*self._asked(own, tokens, score)).mean(1)[:, 0, 1:]

    def _asked(self, own: Tensor, tokens: Tensor, score: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The question [P, 1, D], keys and values [P, 1 + M, 2 D] and score with nobody first."""
        kept = self.key_value(tokens)
        kept = torch.cat([self.nobody.to(kept.dtype).expand(len(tokens), 1, -1), kept], 1)
        query = (self.query(own) * self.scale).unsqueeze(1)
        return query, kept, functional.pad(score, (0, 0, 1, 0))


class SpatialTransformer(nn.Module):
    """Agents of one frame: attention and graph convolution, fused by a gate (Eq. 6).

    The graph is weighted by proximity, exp(-distance / 2 m): near agents matter more.
    """

    def __init__(self, width: int, heads: int, graph: bool) -> None:
        super().__init__()
        self.heads, self.scale, self.graph = heads, (width // heads) ** -0.5, graph
        self.norm = nn.LayerNorm(width)
        # Query, key, value, and what the graph passes on.
        self.project = nn.Linear(width, (4 if graph else 3) * width)
        if graph:
            self.gate = nn.Linear(2 * width, width)
        self.pool = Pool(width, heads)

    def forward(self, tokens: Tensor, others: Tensor, known: Tensor) -> Tensor:
        """The tokens [P, M, D] of P frames, each knowing of the others.

        Args:
            tokens: [P, M, D] embeddings.
            others: [P, M, F] what is known of them.
            known: [P, M].
        """
        p, m, d = tokens.shape
        if m == 0:
            return tokens
        normed, sizes = self.norm(tokens), (d, 2 * d, d) if self.graph else (d, 2 * d)
        query, kept, *passed = (  # products of their own: each result is contiguous
            functional.linear(normed, weight, bias)
            for weight, bias in zip(
                self.project.weight.split(sizes), self.project.bias.split(sizes), strict=True
            )
        )
        masked = torch.where(known, 0.0, MASKED).unsqueeze(-1).expand(p, m, self.heads)
        attention = frame_attention(query * self.scale, kept, masked)
        if not self.graph:
            return tokens + attention
        graph = torch.relu(
            proximity_convolution(passed[0], others[..., POSITION], known, LENGTH_SCALE / 2.0)
        )
        gate = torch.sigmoid(self.gate(torch.cat([attention, graph], -1)))
        return tokens + torch.lerp(graph, attention, gate)


class TemporalTransformer(nn.Module):
    """Each agent along its own last H frames, causal (Eq. 6).

    Recent frames weigh more by a fixed slope per head, so heads look back differently far.
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
        """What a frame's tokens [..., D] are to later frames, [..., 2 D]."""
        return self.key_value(self.norm(tokens))

    def forward(self, tokens: Tensor, kept: Tensor, window: Tensor, allowed: Tensor) -> Tensor:
        """The tokens [P, M, D] of P frames, each knowing of its own past.

        Args:
            tokens: [P, M, D] embeddings of the present.
            kept: [F, M, 2 D] `keys_values` of all frames.
            window: [P, H] which are the last H, the present first.
            allowed: [P, H, M] whether a frame is of this episode and the agent was known in it.
        """
        query = self.query(self.norm(tokens)) * self.scale
        lag = torch.arange(window.shape[1], device=tokens.device)
        bias = -self.slopes.unsqueeze(1) * lag
        return tokens + windowed_attention(query, kept, window, allowed, bias)


class Seen(NamedTuple):
    """What the block of one kind of agent found in P frames."""

    spatial: Tensor  # [P, M, D] tokens
    temporal: Tensor  # [P, M, D]
    score: Tensor  # [P, M, heads] see `nearness`


class Block(nn.Module):
    """Embedding, spatial and temporal transformer of one kind of agent."""

    def __init__(self, ego: int, other: int, config: SpatioTemporalConfig) -> None:
        super().__init__()
        width, self.past = config.width, config.history - 1
        self.embed_ego = nn.Linear(ego, width)
        self.embed_other = nn.Linear(other, width)
        self.embed = nn.Linear(width, width)
        for layer in (self.embed_ego, self.embed_other, self.embed):
            nn.init.orthogonal_(layer.weight, gain=2**0.5)
        self.spatial = SpatialTransformer(width, config.heads, config.graph)
        self.temporal = TemporalTransformer(width, config.heads)

    def forward(
        self, ego: Tensor, others: Tensor, known: Tensor, window: Tensor, fresh: Tensor
    ) -> Seen:
        """What is to be seen in P of the frames.

        Args:
            ego: [F, F_e] of frames of all robots.
            others: [F, M, F_o].
            known: [F, M].
            window: [P, H] which of them are the last H of each, the present first.
            fresh: [P, H] whether they belong to the same episode as the present.
        """
        tokens, frame = self.embedded(ego, others), window[:, 0]
        allowed = known[window] & fresh.unsqueeze(-1)
        kept = self.temporal.keys_values(tokens)
        return self._seen(tokens[frame], others[frame], known[frame], kept, window, allowed)

    def step(
        self,
        ego: Tensor,
        others: Tensor,
        known: Tensor,
        kept: Tensor,
        kept_known: Tensor,
        count: Tensor,
    ) -> Seen:
        """Do the same for one more frame, whose keys and values go into a ring buffer.

        Args:
            ego: [B, F_e].
            others: [B, M, F_o].
            known: [B, M].
            kept: [B, H, M, 2 D] the ring buffer, updated in place.
            kept_known: [B, H, M].
            count: [B] frames of the episode before this one.
        """
        tokens, size = self.embedded(ego, others), self.past + 1
        rows = torch.arange(len(count), device=count.device)
        kept[rows, count % size] = self.temporal.keys_values(tokens).to(kept.dtype)
        kept_known[rows, count % size] = known
        lag = torch.arange(size, device=count.device)
        slot = (count.unsqueeze(1) - lag) % size
        allowed = kept_known[rows.unsqueeze(1), slot] & (lag <= count.unsqueeze(1)).unsqueeze(-1)
        window = rows.unsqueeze(1) * size + slot
        return self._seen(tokens, others, known, kept.flatten(0, 1), window, allowed)

    def embedded(self, ego: Tensor, others: Tensor) -> Tensor:
        """Tokens [..., M, D] of `others` [..., M, F_o] to robots `ego` [..., F_e]."""
        return self.embed(torch.relu(self.embed_other(others) + self.embed_ego(ego).unsqueeze(-2)))

    def asked(self, own: Tensor, seen: Seen) -> list[Tensor]:
        """The robot's spatial and temporal feature, [P, D] each."""
        return [
            self.spatial.pool(own, seen.spatial, seen.score),
            self.temporal.pool(own, seen.temporal, seen.score),
        ]

    def _seen(
        self,
        tokens: Tensor,
        others: Tensor,
        known: Tensor,
        kept: Tensor,
        window: Tensor,
        allowed: Tensor,
    ) -> Seen:
        timed = self.temporal(tokens, kept, window, allowed)
        score = nearness(others, known, self.spatial.heads)
        return Seen(self.spatial(tokens, others, known), timed, score)


class CrossModal(nn.Module):
    """Each of the four features queries their concatenation, then a transformer (Eq. 7)."""

    def __init__(self, features: int, config: SpatioTemporalConfig) -> None:
        super().__init__()
        width, heads, self.attends = config.width, config.heads, config.cross_modal
        if self.attends:
            self.cross = nn.MultiheadAttention(width, heads, batch_first=True)
            self.norm = nn.LayerNorm(width)
            self.final = nn.TransformerEncoderLayer(
                width, heads, 2 * width, dropout=0.0, batch_first=True, norm_first=True
            )
        self.out = nn.Linear((1 + features) * width, config.features)

    def forward(self, own: Tensor, modalities: Tensor) -> Tensor:
        """Y [P, out] from the robot's own embedding [P, D] and the features [P, 4, D]."""
        if self.attends:
            fused = self.norm(modalities)
            crossed, _ = self.cross(fused, fused, fused, need_weights=False)
            modalities = self.final(modalities + crossed)
        return torch.relu(self.out(torch.cat([own, modalities.flatten(1)], -1)))


SpatioTemporalScene = tuple[Seen, ...]
"""What each block found: of robots and of humans, or of all together."""


@ENCODERS.register("spatio_temporal", SpatioTemporalConfig)
class SpatioTemporalEncoder(Encoder):
    """Y_t of each robot from what it knew in its last H frames (Eq. 8).

    The tokens of a frame, their keys and values are computed once, however many windows they are
    in, and not where they are in none; everything else is computed for the samples alone.
    """

    def __init__(self, config: SpatioTemporalConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        if config.width % config.heads:
            raise ConfigurationError(
                f"encoder.heads is {config.heads}; it must divide encoder.width ({config.width})"
            )
        width = config.width
        self.width, self.history, self.features = width, config.history - 1, config.features
        self.own = nn.Sequential(nn.Linear(sizes.ego, width), nn.ReLU(), nn.Linear(width, width))
        if config.one_block:  # the features of people and robots have the same length
            self.everybody = Block(sizes.ego, sizes.entities["humans"], config)
        else:
            self.humans = Block(sizes.ego, sizes.entities["humans"], config)
            self.robots = Block(sizes.ego, sizes.entities["robots"], config)
        self.kinds = ("everybody",) if config.one_block else ("robots", "humans")
        self.cross = CrossModal(2 * len(self.kinds), config)

    def observe(
        self, frames: Frames, is_init: Tensor, state: State, samples: Tensor | None = None
    ) -> SpatioTemporalScene:
        """See `Encoder.observe`."""
        frame = frame_numbers(frames, self.history, samples).unsqueeze(1)
        steps = torch.arange(is_init.shape[1], device=is_init.device)
        began = torch.where(is_init, steps, -1).cummax(1).values  # [B, h + T]
        lag = torch.arange(self.history + 1, device=is_init.device)
        fresh = frame % is_init.shape[1] - lag >= began.flatten()[frame].clamp_min(0)
        needed, window = torch.where(fresh, frame - lag, frame).unique(return_inverse=True)
        f = frames.map(lambda tensor: tensor.flatten(0, 1)[needed])
        return tuple(
            getattr(self, kind)(f.ego, *_agents(f, kind), window, fresh) for kind in self.kinds
        )

    def read(self, scene: SpatioTemporalScene, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        own = self.own(query)
        features: list[Tensor] = []
        for kind, seen in zip(self.kinds, scene, strict=True):
            features += getattr(self, kind).asked(own, seen)
        y: Tensor = self.cross(own, torch.stack(features, 1))
        return y

    def initial_state(self, frame: Frames) -> State:
        """Ring buffers of the keys and values of the last H frames, and how many there were."""
        state: State = {
            "count": torch.zeros(len(frame.ego), dtype=torch.long, device=frame.ego.device)
        }
        for kind in self.kinds:
            _, known = _agents(frame, kind)
            b, _, m = known.shape
            state[kind] = frame.ego.new_zeros(b, self.history + 1, m, 2 * self.width)
            state[f"{kind}_known"] = known.new_zeros(b, self.history + 1, m)
        return state

    def step(self, frame: Frames, is_init: Tensor, state: State) -> Any:
        """See `Encoder.step`; the earlier frames are not computed again."""
        count = torch.where(is_init, 0, state["count"])
        state["count"][:] = count + 1
        f = frame.map(lambda tensor: tensor[:, 0])
        return tuple(
            getattr(self, kind).step(
                f.ego, *_agents(f, kind), state[kind], state[f"{kind}_known"], count
            )
            for kind in self.kinds
        )

    def resume(self, frames: Frames, is_init: Tensor, state: State, rows: Tensor) -> None:
        """See `Encoder.resume`: the last frames are what the ring buffers hold."""
        for t in range(self.history):  # a frame is only taken in; nobody asks about it
            begins = is_init[:, t] if t else torch.ones_like(is_init[:, 0])
            count = torch.where(begins, 0, state["count"][rows])
            slot = count % (self.history + 1)
            for kind in self.kinds:
                block: Block = getattr(self, kind)
                agents, known = _agents(frames, kind)
                tokens = block.embedded(frames.ego[:, t], agents[:, t])
                state[kind][rows, slot] = block.temporal.keys_values(tokens).to(state[kind].dtype)
                state[f"{kind}_known"][rows, slot] = known[:, t]
            state["count"][rows] = count + 1

    def memory(self, state: State) -> State:
        """Nothing: `resume` computes all of it."""
        return {}

    def attention(self, scene: SpatioTemporalScene, query: Tensor) -> tuple[Tensor, Tensor] | None:
        """See `Encoder.attention`; that of the spatial part. None where all are in one block."""
        if "robots" not in self.kinds:
            return None
        own = self.own(query)
        robots, humans = (
            getattr(self, kind).spatial.pool.shares(own, seen.spatial, seen.score)
            for kind, seen in zip(self.kinds, scene, strict=True)
        )
        return robots, humans


def _agents(frames: Frames, kind: str) -> tuple[Tensor, Tensor]:
    """Those of a kind in some frames: [..., M, F_o] what is known of them, [..., M] whether it is.

    What is known of robots and of humans has the same numbers, so `everybody` is both.
    """
    if kind == "everybody":
        return (
            torch.cat([frames.robots, frames.humans], -2),
            torch.cat([frames.robots_known, frames.humans_known], -1),
        )
    features, mask = frames.entities[kind]
    return features, mask
