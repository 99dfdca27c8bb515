"""The decentralised structural RNN of Liu et al. (DSRNN, ICRA 2021), the encoder of SAMARL-SRNN.

The robot and those around it are a graph. A spatial edge leads from the robot to every other agent,
a temporal edge from the robot to itself. Each edge is a gated recurrent unit (Cho et al., 2014).
The temporal edge attends to the spatial ones, and a last unit, the robot's node, takes in what it
finds. Edges to humans share their weights, and so do edges to robots: one factor for each kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from mrsan.scenario import required
from samarl.encoders.encoder import ENCODERS, Encoder, State, samples_of
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.features import EGO_VELOCITY
from samarl.observations.frames import Frames


@dataclass
class StructuralRNNConfig:
    """Sizes of the structural RNN."""

    embedding: int = required(8, 1024)  # of what each unit is given
    edge: int = required(8, 1024)  # hidden state of an edge, D
    node: int = required(8, 1024)  # hidden state of the node
    attention: int = required(8, 1024)  # queries and keys
    features: int = required(8, 4096)  # length of Y


class RecurrentUnit(nn.Module):
    """A gated recurrent unit over sequences that may begin anew and have gaps."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.split = (2 * width, width)  # both gates, and what is new
        self.of_input, self.of_hidden = nn.Linear(inputs, 3 * width), nn.Linear(width, 3 * width)
        for layer in (self.of_input, self.of_hidden):  # as DSRNN begins
            nn.init.orthogonal_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, inputs: Tensor, known: Tensor, begins: Tensor, hidden: Tensor) -> Tensor:
        """The hidden states after each of T frames, [T, B, M, D].

        Args:
            inputs: [T, B, M, F] of M sequences for each of B robots.
            known: [T, B, M] whether there is an input; without one the hidden state stays as it is.
            begins: [T, B] whether the hidden states are forgotten before this frame.
            hidden: [B, M, D] before the first frame.
        """
        given = self.of_input(inputs)  # of all frames at once; only the rest must go in order
        there, kept = known.unsqueeze(-1), ~begins[..., None, None]
        hidden, found = hidden.to(given.dtype), []
        for t, of_input in enumerate(given.unbind()):  # given[t] has a gradient as long as given
            hidden = hidden * kept[t]
            gates, new = of_input.split(self.split, -1)
            of_gates, of_new = self.of_hidden(hidden).split(self.split, -1)
            update, reset = torch.sigmoid(gates + of_gates).chunk(2, -1)
            hidden = torch.lerp(hidden, torch.tanh(new + reset * of_new), update * there[t])
            found.append(hidden)
        return torch.stack(found)


class StructuralRNNScene(NamedTuple):
    """What the graph is in P frames."""

    node: Tensor  # [P, node] hidden state of the robot's node
    robots: Tensor  # [P, N - 1] shares of the attention
    humans: Tensor  # [P, M]


@ENCODERS.register("structural_rnn", StructuralRNNConfig)
class StructuralRNNEncoder(Encoder):
    """Spatial edges, a temporal edge that attends to them, and a node; all are recurrent."""

    def __init__(self, config: StructuralRNNConfig, ego_features: int, other_features: int) -> None:
        """See `Encoder`."""
        super().__init__(config, ego_features, other_features)
        embedding, edge, self.features = config.embedding, config.edge, config.features
        velocity = EGO_VELOCITY.stop - EGO_VELOCITY.start
        self.scale = config.attention**-0.5
        self.embed = nn.ModuleDict(
            {
                name: nn.Sequential(nn.Linear(inputs, embedding), nn.ReLU())
                for name, inputs in (
                    ("humans", other_features), ("robots", other_features),
                    ("temporal", velocity), ("ego", ego_features), ("edges", 2 * edge),
                )
            }
        )  # fmt: skip
        self.units = nn.ModuleDict(
            {name: RecurrentUnit(embedding, edge) for name in ("humans", "robots", "temporal")}
            | {"node": RecurrentUnit(2 * embedding, config.node)}
        )
        self.edge, self.node = edge, config.node
        self.asks = nn.Linear(edge, config.attention)
        self.keys = nn.ModuleDict(
            {name: nn.Linear(edge, config.attention) for name in ("robots", "humans")}
        )
        self.query = nn.Linear(ego_features, embedding)
        self.out = nn.Sequential(
            nn.ReLU(), nn.Linear(config.node + embedding, config.features), nn.ReLU()
        )

    def observe(
        self, frames: Frames, is_init: Tensor, state: State, samples: Tensor | None = None
    ) -> StructuralRNNScene:
        """See `Encoder.observe`."""
        scene, _ = self._unrolled(frames, is_init, state)
        return scene if samples is None else samples_of(scene, samples)

    def read(self, scene: StructuralRNNScene, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        return self.out(torch.cat([scene.node, self.query(query)], -1))

    def initial_state(self, frame: Frames) -> State:
        """The hidden states of all units, [B, number of them, D]."""
        return {
            name: frame.ego.new_zeros(len(frame.ego), number, width)
            for name, number, width in (
                ("robots", frame.robots.shape[2], self.edge),
                ("humans", frame.humans.shape[2], self.edge),
                ("temporal", 1, self.edge), ("node", 1, self.node),
            )
        }  # fmt: skip

    def step(self, frame: Frames, is_init: Tensor, state: State, rows: Tensor | None = None) -> Any:
        """See `Encoder.step`."""
        where = slice(None) if rows is None else rows
        before = {name: hidden[where] for name, hidden in state.items()}
        scene, after = self._unrolled(frame, is_init.unsqueeze(1), before)
        for name, hidden in after.items():
            state[name][where] = hidden.to(state[name].dtype)
        return scene

    def attention(self, scene: StructuralRNNScene, query: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.attention`; it is the same whatever is asked."""
        return scene.robots, scene.humans

    def _unrolled(
        self, frames: Frames, is_init: Tensor, state: State
    ) -> tuple[StructuralRNNScene, State]:
        """The scene of all frames [B T, ...], and the state after the last."""
        f, begins = Frames(*(tensor.transpose(0, 1) for tensor in frames)), is_init.T  # [T, B, ...]
        after: State = {}

        def unit(name: str, inputs: Tensor, known: Tensor) -> Tensor:
            hidden: Tensor = self.units[name](inputs, known, begins, state[name])
            after[name] = hidden[-1]
            return hidden

        always = torch.ones_like(begins).unsqueeze(-1)
        own = f.ego.unsqueeze(2)  # [T, B, 1, F_e]
        temporal = unit("temporal", self.embed["temporal"](own[..., EGO_VELOCITY]), always)
        of_robots = unit("robots", self.embed["robots"](f.robots), f.robots_known)
        of_humans = unit("humans", self.embed["humans"](f.humans), f.humans_known)
        known = torch.cat([f.robots_known, f.humans_known], -1)
        keys = torch.cat([self.keys["robots"](of_robots), self.keys["humans"](of_humans)], 2)
        score = (self.asks(temporal) * keys).sum(-1) * self.scale
        score = score * known.sum(-1, keepdim=True)  # DSRNN's: the more there are, the sharper
        share = torch.softmax(torch.where(known, score, MASKED), -1) * known  # zero with nobody
        spatial = share.unsqueeze(2) @ torch.cat([of_robots, of_humans], 2)
        edges = self.embed["edges"](torch.cat([temporal, spatial], -1))
        node = unit("node", torch.cat([self.embed["ego"](own), edges], -1), always)
        robots = f.robots.shape[2]
        found = (node.squeeze(2), share[..., :robots], share[..., robots:])
        return StructuralRNNScene(*(x.transpose(0, 1).flatten(0, 1) for x in found)), after
