"""SAMARL's hybrid spatio-temporal transformer (Sec. IV-B, Eq. 5 to 8).

Humans and robots have separate blocks, because they interact differently. A spatial transformer
relates the agents of one frame, and a temporal transformer each agent's own history. The robot
itself attends to both, and cross-modal attention fuses the results. Unknown agents are masked
everywhere, and the robot can also attend to a learned "nobody", so the result is finite with nobody
in view.

In walled environments there are further features to fuse: the robot's attention over the nearest
walls, and the ranges of its lidar. Both are of the present frame only, as walls do not move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from mrsan import ConfigurationError
from mrsan.fields import required, setting
from samarl.encoders.encoder import ENCODERS, Encoder, EncoderState, frame_numbers
from samarl.encoders.rays import RayEncoder
from samarl.encoders.transformer_layers import (
    Pool,
    SpatialTransformer,
    TemporalTransformer,
    nearness,
)
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.features import WALL_NEAR
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


class BlockScene(NamedTuple):
    """The output of the block of one kind of agent for P frames."""

    spatial: Tensor  # [P, M, D] tokens
    temporal: Tensor  # [P, M, D]
    score: Tensor  # [P, M, heads] see `nearness`


class Embedding(nn.Module):
    """Tokens of one kind of entity, conditioned on the robot's own state."""

    def __init__(self, ego: int, other: int, width: int) -> None:
        super().__init__()
        self.embed_ego = nn.Linear(ego, width)
        self.embed_other = nn.Linear(other, width)
        self.embed = nn.Linear(width, width)
        for layer in (self.embed_ego, self.embed_other, self.embed):
            nn.init.orthogonal_(layer.weight, gain=2**0.5)

    def embedded(self, ego: Tensor, others: Tensor) -> Tensor:
        """Return the tokens [..., M, D] of `others` [..., M, F_o] for robots `ego` [..., F_e]."""
        return self.embed(torch.relu(self.embed_other(others) + self.embed_ego(ego).unsqueeze(-2)))


class Block(Embedding):
    """Embedding, spatial and temporal transformer of one kind of agent."""

    def __init__(self, ego: int, other: int, config: SpatioTemporalConfig) -> None:
        super().__init__(ego, other, config.width)
        width, self.past = config.width, config.history - 1
        self.spatial = SpatialTransformer(width, config.heads, config.graph)
        self.temporal = TemporalTransformer(width, config.heads)

    def forward(
        self, ego: Tensor, others: Tensor, known: Tensor, window: Tensor, current: Tensor
    ) -> BlockScene:
        """Return the tokens of P of the frames.

        Args:
            ego: [F, F_e] of frames of all robots.
            others: [F, M, F_o].
            known: [F, M].
            window: [P, H] indices of the last H frames of each, the present first.
            current: [P, H] whether they belong to the same episode as the present.
        """
        tokens, frame = self.embedded(ego, others), window[:, 0]
        allowed = known[window] & current.unsqueeze(-1)
        key_value = self.temporal.keys_values(tokens)
        return self._scene(tokens[frame], others[frame], known[frame], key_value, window, allowed)

    def step(
        self,
        ego: Tensor,
        others: Tensor,
        known: Tensor,
        key_value: Tensor,
        buffer_known: Tensor,
        count: Tensor,
    ) -> BlockScene:
        """Do the same for one more frame, whose keys and values are written to a ring buffer.

        Args:
            ego: [B, F_e].
            others: [B, M, F_o].
            known: [B, M].
            key_value: [B, H, M, 2 D] the ring buffer, updated in place.
            buffer_known: [B, H, M] which agents were known then, updated in place.
            count: [B] frames of the episode before this one.
        """
        tokens, size = self.embedded(ego, others), self.past + 1
        rows = torch.arange(len(count), device=count.device)
        key_value[rows, count % size] = self.temporal.keys_values(tokens).to(key_value.dtype)
        buffer_known[rows, count % size] = known
        lag = torch.arange(size, device=count.device)
        slot = (count.unsqueeze(1) - lag) % size
        allowed = buffer_known[rows.unsqueeze(1), slot] & (lag <= count.unsqueeze(1)).unsqueeze(-1)
        window = rows.unsqueeze(1) * size + slot
        return self._scene(tokens, others, known, key_value.flatten(0, 1), window, allowed)

    def pooled(self, own: Tensor, scene: BlockScene) -> list[Tensor]:
        """Return the robot's spatial and temporal feature, [P, D] each."""
        return [
            self.spatial.pool(own, scene.spatial, scene.score),
            self.temporal.pool(own, scene.temporal, scene.score),
        ]

    def _scene(
        self,
        tokens: Tensor,
        others: Tensor,
        known: Tensor,
        key_value: Tensor,
        window: Tensor,
        allowed: Tensor,
    ) -> BlockScene:
        temporal = self.temporal(tokens, key_value, window, allowed)
        score = nearness(others, known, self.spatial.heads)
        return BlockScene(self.spatial(tokens, others, known), temporal, score)


class WallScene(NamedTuple):
    """The output of the block of walls for P frames."""

    tokens: Tensor  # [P, K, D] of the nearest walls
    score: Tensor  # [P, K, heads] that is added to those of the robot's attention


class WallBlock(Embedding):
    """Embedding of the nearest walls, and the robot's attention over them."""

    def __init__(self, ego: int, wall: int, config: SpatioTemporalConfig) -> None:
        super().__init__(ego, wall, config.width)
        self.heads, self.pool = config.heads, Pool(config.width, config.heads)

    def forward(self, frames: Frames) -> WallScene:
        """Return the tokens of the walls in frames [P, ...]; scores fall by 1 per metre."""
        walls, mask = frames.entities["walls"]
        near = walls[..., WALL_NEAR].clamp_min(1e-20).log() / 2
        score = torch.where(mask, near, MASKED).unsqueeze(-1).expand(-1, -1, self.heads)
        return WallScene(self.embedded(frames.ego, walls), score)

    def pooled(self, own: Tensor, scene: WallScene) -> Tensor:
        """Return the feature of the robot with its own embedding, [P, D]."""
        return self.pool(own, scene.tokens, scene.score)


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
        """Return Y [P, out] from the robot's own embedding [P, D] and the features [P, G, D].

        There are G = 4 of them in the paper: spatial and temporal, of humans and of robots.
        """
        if self.attends:
            fused = self.norm(modalities)
            crossed, _ = self.cross(fused, fused, fused, need_weights=False)
            modalities = self.final(modalities + crossed)
        return torch.relu(self.out(torch.cat([own, modalities.flatten(1)], -1)))


class SpatioTemporalScene(NamedTuple):
    """What the encoder observed in P frames."""

    agents: tuple[BlockScene, ...]  # of robots and of humans, or of all agents together
    walls: tuple[WallScene, ...]  # of the nearest walls; empty if they are not read
    rays: tuple[Tensor, ...]  # [P, D] of the lidar; empty if it is not read


@ENCODERS.register("spatio_temporal", SpatioTemporalConfig)
class SpatioTemporalEncoder(Encoder):
    """Y_t of each robot from its last H frames (Eq. 8).

    Tokens, keys and values are computed once per frame that is in any window; everything else is
    computed for the samples only.
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
        self.walls: WallBlock | None = None
        if "walls" in sizes.entities:
            self.walls = WallBlock(sizes.ego, sizes.entities["walls"], config)
        self.rays: RayEncoder | None = None
        if "lidar" in sizes.sensors:
            self.rays = RayEncoder(sizes.sensors["lidar"][0], width)
        features = 2 * len(self.kinds) + (self.walls is not None) + (self.rays is not None)
        self.cross = CrossModal(features, config)

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> SpatioTemporalScene:
        """See `Encoder.observe`."""
        frame = frame_numbers(frames, self.history, samples).unsqueeze(1)
        steps = torch.arange(is_init.shape[1], device=is_init.device)
        episode_start = torch.where(is_init, steps, -1).cummax(1).values  # [B, h + T]
        lag = torch.arange(self.history + 1, device=is_init.device)
        current = frame % is_init.shape[1] - lag >= episode_start.flatten()[frame].clamp_min(0)
        needed, window = torch.where(current, frame - lag, frame).unique(return_inverse=True)
        f = frames.apply(lambda tensor: tensor.flatten(0, 1)[needed])
        agents = tuple(
            getattr(self, kind)(f.ego, *_agents(f, kind), window, current) for kind in self.kinds
        )
        return self._scene(agents, f.select(window[:, 0]))

    def read(self, scene: SpatioTemporalScene, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        own = self.own(query)
        features: list[Tensor] = []
        for kind, of_kind in zip(self.kinds, scene.agents, strict=True):
            features += getattr(self, kind).pooled(own, of_kind)
        if self.walls is not None:
            features.append(self.walls.pooled(own, scene.walls[0]))
        features += scene.rays
        y: Tensor = self.cross(own, torch.stack(features, 1))
        return y

    def initial_state(self, frame: Frames) -> EncoderState:
        """Return ring buffers of keys and values of the last H frames, and the number of frames."""
        state: EncoderState = {
            "count": torch.zeros(len(frame.ego), dtype=torch.long, device=frame.ego.device)
        }
        for kind in self.kinds:
            _, known = _agents(frame, kind)
            b, _, m = known.shape
            state[kind] = frame.ego.new_zeros(b, self.history + 1, m, 2 * self.width)
            state[f"{kind}_known"] = known.new_zeros(b, self.history + 1, m)
        return state

    def step(self, frame: Frames, is_init: Tensor, state: EncoderState) -> Any:
        """See `Encoder.step`; earlier frames are not encoded again."""
        count = torch.where(is_init, 0, state["count"])
        state["count"][:] = count + 1
        f = frame.apply(lambda tensor: tensor[:, 0])
        agents = tuple(
            getattr(self, kind).step(
                f.ego, *_agents(f, kind), state[kind], state[f"{kind}_known"], count
            )
            for kind in self.kinds
        )
        return self._scene(agents, f)

    def _scene(self, agents: tuple[BlockScene, ...], frames: Frames) -> SpatioTemporalScene:
        """Return the scene of frames [P, ...] whose agents are encoded."""
        walls = () if self.walls is None else (self.walls(frames),)
        rays = () if self.rays is None else (self.rays(frames.sensors["lidar"]),)
        return SpatioTemporalScene(agents, walls, rays)

    def resume(self, frames: Frames, is_init: Tensor, state: EncoderState, rows: Tensor) -> None:
        """See `Encoder.resume`: fill the ring buffers with the last frames."""
        for t in range(self.history):
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

    def memory(self, state: EncoderState) -> EncoderState:
        """Return nothing: `resume` recomputes all of it."""
        return {}

    def attention(self, scene: SpatioTemporalScene, query: Tensor) -> tuple[Tensor, Tensor] | None:
        """See `Encoder.attention`: of the spatial part; None if all agents share a block."""
        if "robots" not in self.kinds:
            return None
        own = self.own(query)
        robots, humans = (
            getattr(self, kind).spatial.pool.weights(own, of_kind.spatial, of_kind.score)
            for kind, of_kind in zip(self.kinds, scene.agents, strict=True)
        )
        return robots, humans


def _agents(frames: Frames, kind: str) -> tuple[Tensor, Tensor]:
    """Return the features [..., M, F_o] and the mask [..., M] of one kind of agent.

    Robots and humans have the same features, so they can be concatenated as `everybody`.
    """
    if kind == "everybody":
        return (
            torch.cat([frames.robots, frames.humans], -2),
            torch.cat([frames.robots_known, frames.humans_known], -1),
        )
    features, mask = frames.entities[kind]
    return features, mask
