"""MSA3C's social encoder, a temporal-spatial graph (MSA3C, Eq. 6-10).

A graph of gated recurrent units as in `recurrent_graph.py`, from places alone: nobody's velocity is
looked at, it is left to the units to find out who moves how. All spatial edges share their weights.
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
    """The paper's phi: a layer, its normalisation and a leaky rectifier."""
    return nn.Sequential(nn.Linear(inputs, outputs), nn.LayerNorm(outputs), nn.LeakyReLU())


@ENCODERS.register("temporal_spatial_graph", TemporalSpatialGraphConfig)
class TemporalSpatialGraphEncoder(RecurrentGraph):
    """Where others are, over time; attention weighs them, and the node keeps what it finds.

    Places are seen along the line to the goal. A holonomic robot's heading is that of its last
    action: seen from its body all the world would jump with every step, and memories of where
    somebody was would say nothing of how he moves.

    An edge is told the radius as well. The paper lists positions alone, but also lets robots sense
    everybody's radius with noise; and who does not know it must keep the largest from everybody.
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
        """See `Encoder.read`; Eq. 10, of the node and of what is asked."""
        return self.out(torch.cat([scene.node, query], -1))

    def _hidden(self, robots: int, humans: int) -> dict[str, tuple[int, int]]:
        return {
            "others": (robots + humans, self.edge),
            "temporal": (1, self.edge),
            "node": (1, self.node),
        }

    def _temporal(self, frames: Frames) -> Tensor:
        # Eq. 7: how far it went in the last step, which is its velocity but for the time step.
        moved = towards(frames.ego[..., EGO_DIRECTION], frames.ego[..., EGO_VELOCITY])
        return self.embed["temporal"](moved).unsqueeze(2)

    def _spatial(self, frames: Frames, unit: Unit) -> Tensor:
        others = torch.cat([frames.robots, frames.humans], 2)
        direction = frames.ego[..., EGO_DIRECTION].unsqueeze(2)
        place = towards(direction, others[..., POSITION])
        known = torch.cat([frames.robots_known, frames.humans_known], -1)
        inputs = self.embed["others"](torch.cat([place, others[..., RADIUS]], -1))
        return unit("others", inputs, known)  # Eq. 6

    def _attend(
        self, temporal: Tensor, spatial: Tensor, known: Tensor, robots: int
    ) -> tuple[Tensor, Tensor]:
        # Eq. 8. What is asked goes through the keys' layer, and what is found through the values':
        # the same numbers as when every edge does, but there are many edges.
        asked = self.asks(temporal.squeeze(2)).unflatten(-1, (self.heads, -1))
        asked = torch.einsum("tbha,had->tbhd", asked, self.keys)
        score = (asked @ spatial.transpose(-2, -1)) * self.scale  # [T, B, heads, N - 1 + M]
        known = known.unsqueeze(2)
        share = torch.softmax(torch.where(known, score, MASKED), -1) * known  # zero with nobody
        found = torch.einsum("tbhd,hda->tbha", share @ spatial, self.values)
        return found.flatten(2), share.mean(2)

    def _node(self, frames: Frames, temporal: Tensor, found: Tensor) -> Tensor:
        return torch.cat([self.embed["found"](found), self.embed["ego"](frames.ego)], -1)  # Eq. 9


def towards(direction: Tensor, vector: Tensor) -> Tensor:
    """Vectors [..., 2] as they lie along a `direction` [..., 2] and to the left of it."""
    along = (direction * vector).sum(-1)
    left = direction[..., 0] * vector[..., 1] - direction[..., 1] * vector[..., 0]
    return torch.stack([along, left], -1)
