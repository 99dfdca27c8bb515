"""MSA3C's social encoder, a temporal-spatial graph (MSA3C, Eq. 6-10).

A graph of gated recurrent units as in `recurrent_graph.py`, whose inputs are positions: velocities
are not observed, and the units must infer them. All spatial edges share their parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mrsan import ConfigurationError
from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS
from samarl.encoders.recurrent_graph import GraphScene, RecurrentGraph, RecurrentUnit, Unit
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.features import EGO_DIRECTION, EGO_VELOCITY, POSITION, RADIUS
from samarl.observations.frames import FeatureSizes, Frames


@dataclass
class TemporalSpatialGraphConfig:
    """Sizes of the graph."""

    embedding: int = required(8, 1024, help="width of the input of each unit")
    edge: int = required(8, 1024, help="hidden size D of an edge")
    node: int = required(8, 1024, help="hidden size of the node")
    attention: int = required(8, 1024, help="width of queries, keys and values, all heads together")
    heads: int = required(1, 64, help="attention heads")
    features: int = required(8, 4096, help="length of the output Y")


def embedding(inputs: int, outputs: int) -> nn.Sequential:
    """Return the paper's phi: a linear layer, layer normalisation and a leaky ReLU."""
    return nn.Sequential(nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.LeakyReLU())


@ENCODERS.register("temporal_spatial_graph", TemporalSpatialGraphConfig)
class TemporalSpatialGraphEncoder(RecurrentGraph):
    """Positions of the others over time; attention weights them, and the node remembers the result.

    The x axis of positions points to the goal. The heading of a holonomic robot is that of its last
    action: in its body frame all positions would jump with every step, and would not show how
    others move.

    The radius is an input of an edge as well. The paper lists only positions, but also lets robots
    observe radii with noise; a robot that does not observe them must keep the largest distance.
    """

    def __init__(self, config: TemporalSpatialGraphConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        if config.attention % config.heads:
            raise ConfigurationError(
                f"encoder.attention is {config.attention}; it must be a multiple of encoder.heads "
                f"({config.heads})"
            )
        e, self.edge, self.node, self.features = (
            config.embedding,
            config.edge,
            config.node,
            config.features,
        )
        self.heads, self.scale = config.heads, (config.attention // config.heads) ** -0.5
        self.embed = nn.ModuleDict(
            {
                name: embedding(inputs, e)
                for name, inputs in (
                    ("others", 3),
                    ("temporal", 2),
                    ("ego", sizes.ego),
                    ("found", config.attention),
                )
            }
        )
        self.units = nn.ModuleDict(  # type: ignore[assignment]
            {name: RecurrentUnit(e, self.edge) for name in ("others", "temporal")}
            | {"node": RecurrentUnit(2 * e, self.node)}
        )
        self.asks = nn.Linear(self.edge, config.attention, bias=False)
        each = config.attention // config.heads
        self.keys = nn.Parameter(torch.empty(config.heads, each, self.edge))
        self.values = nn.Parameter(torch.empty(config.heads, self.edge, each))
        for weight in (self.keys, self.values):
            nn.init.uniform_(weight, -(self.edge**-0.5), self.edge**-0.5)
        self.out = embedding(self.node + sizes.ego, self.features)

    def read(self, scene: GraphScene, query: Tensor) -> Tensor:
        """See `Encoder.read`; Eq. 10."""
        return self.out(torch.cat([scene.node, query], -1))

    def _hidden(self, robots: int, humans: int) -> dict[str, tuple[int, int]]:
        return {
            "others": (robots + humans, self.edge),
            "temporal": (1, self.edge),
            "node": (1, self.node),
        }

    def _temporal(self, frames: Frames) -> Tensor:
        # Eq. 7: its displacement in the last step, here its velocity, which differs by a factor.
        displacement = towards(frames.ego[..., EGO_DIRECTION], frames.ego[..., EGO_VELOCITY])
        return self.embed["temporal"](displacement).unsqueeze(2)

    def _spatial(self, frames: Frames, unit: Unit) -> Tensor:
        others = torch.cat([frames.robots, frames.humans], 2)
        direction = frames.ego[..., EGO_DIRECTION].unsqueeze(2)
        position = towards(direction, others[..., POSITION])
        known = torch.cat([frames.robots_known, frames.humans_known], -1)
        inputs = self.embed["others"](torch.cat([position, others[..., RADIUS]], -1))
        return unit("others", inputs, known)  # Eq. 6

    def _attend(
        self, temporal: Tensor, spatial: Tensor, known: Tensor, robots: int
    ) -> tuple[Tensor, Tensor]:
        # Eq. 8. The layer of the keys is applied to the query, and that of the values to the
        # result: the numbers are the same as for every edge, and there are many edges.
        query = self.asks(temporal.squeeze(2)).unflatten(-1, (self.heads, -1))
        query = torch.einsum("tbha,had->tbhd", query, self.keys)
        score = (query @ spatial.transpose(-2, -1)) * self.scale  # [T, B, heads, N - 1 + M]
        known = known.unsqueeze(2)
        weights = torch.softmax(torch.where(known, score, MASKED), -1) * known  # zero with nobody
        attended = torch.einsum("tbhd,hda->tbha", weights @ spatial, self.values)
        return attended.flatten(2), weights.mean(2)

    def _node(self, frames: Frames, temporal: Tensor, attended: Tensor) -> Tensor:
        return torch.cat(
            [self.embed["found"](attended), self.embed["ego"](frames.ego)], -1
        )  # Eq. 9


def towards(direction: Tensor, vector: Tensor) -> Tensor:
    """Return the components of vectors [..., 2] along a `direction` [..., 2] and to its left."""
    along = (direction * vector).sum(-1)
    left = direction[..., 0] * vector[..., 1] - direction[..., 1] * vector[..., 0]
    return torch.stack([along, left], -1)
