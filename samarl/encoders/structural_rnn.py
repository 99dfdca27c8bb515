"""The decentralised structural RNN of Liu et al. (DSRNN, ICRA 2021), the encoder of SAMARL-SRNN.

A graph of gated recurrent units (Cho et al., 2014), see `recurrent_graph.py`. Edges to humans share
their weights, and so do edges to robots: one factor for each kind.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS
from samarl.encoders.recurrent_graph import GraphScene, RecurrentGraph, RecurrentUnit, Unit
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.features import EGO_VELOCITY
from samarl.observations.frames import FeatureSizes, Frames


@dataclass
class StructuralRNNConfig:
    """Sizes of the structural RNN."""

    embedding: int = required(8, 1024, help="width of the input of each unit")
    edge: int = required(8, 1024, help="hidden size D of an edge")
    node: int = required(8, 1024, help="hidden size of the node")
    attention: int = required(8, 1024, help="width of queries and keys")
    features: int = required(8, 4096, help="length of the output Y")


@ENCODERS.register("structural_rnn", StructuralRNNConfig)
class StructuralRNNEncoder(RecurrentGraph):
    """The graph of DSRNN: the input of a spatial edge is all features of its agent."""

    def __init__(self, config: StructuralRNNConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        embedding, edge, self.features = config.embedding, config.edge, config.features
        velocity = EGO_VELOCITY.stop - EGO_VELOCITY.start
        self.scale = config.attention**-0.5
        self.embed = nn.ModuleDict(
            {
                name: nn.Sequential(nn.Linear(inputs, embedding), nn.ReLU())
                for name, inputs in (
                    ("humans", sizes.entities["humans"]),
                    ("robots", sizes.entities["robots"]),
                    ("temporal", velocity),
                    ("ego", sizes.ego),
                    ("edges", 2 * edge),
                )
            }
        )
        self.units = nn.ModuleDict(  # type: ignore[assignment]
            {name: RecurrentUnit(embedding, edge) for name in ("humans", "robots", "temporal")}
            | {"node": RecurrentUnit(2 * embedding, config.node)}
        )
        self.edge, self.node = edge, config.node
        self.asks = nn.Linear(edge, config.attention)
        self.keys = nn.ModuleDict(
            {name: nn.Linear(edge, config.attention) for name in ("robots", "humans")}
        )
        self.query = nn.Linear(sizes.ego, embedding)
        self.out = nn.Sequential(
            nn.ReLU(), nn.Linear(config.node + embedding, config.features), nn.ReLU()
        )

    def read(self, scene: GraphScene, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        return self.out(torch.cat([scene.node, self.query(query)], -1))

    def _hidden(self, robots: int, humans: int) -> dict[str, tuple[int, int]]:
        edges = {"robots": robots, "humans": humans, "temporal": 1}
        return {name: (number, self.edge) for name, number in edges.items()} | {
            "node": (1, self.node)
        }

    def _temporal(self, frames: Frames) -> Tensor:
        return self.embed["temporal"](frames.ego[..., EGO_VELOCITY]).unsqueeze(2)

    def _spatial(self, frames: Frames, unit: Unit) -> Tensor:
        return torch.cat(
            [
                unit("robots", self.embed["robots"](frames.robots), frames.robots_known),
                unit("humans", self.embed["humans"](frames.humans), frames.humans_known),
            ],
            2,
        )

    def _attend(
        self, temporal: Tensor, spatial: Tensor, known: Tensor, robots: int
    ) -> tuple[Tensor, Tensor]:
        keys = torch.cat(
            [
                self.keys["robots"](spatial[:, :, :robots]),
                self.keys["humans"](spatial[:, :, robots:]),
            ],
            2,
        )
        score = (self.asks(temporal) * keys).sum(-1) * self.scale
        score = score * known.sum(-1, keepdim=True)  # as in DSRNN: sharper with more agents
        weights = torch.softmax(torch.where(known, score, MASKED), -1) * known  # zero with nobody
        return (weights.unsqueeze(2) @ spatial).squeeze(2), weights

    def _node(self, frames: Frames, temporal: Tensor, attended: Tensor) -> Tensor:
        edges = self.embed["edges"](torch.cat([temporal, attended], -1))
        return torch.cat([self.embed["ego"](frames.ego), edges], -1)
