"""What encoders share that are a graph of gated recurrent units, as in Vemula et al. (2018).

The robot and those around it are a graph. A spatial edge leads from the robot to every other agent,
a temporal edge from the robot to itself. The temporal edge attends to the spatial ones, and a last
unit, the robot's node, takes in what it finds.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from samarl.encoders.encoder import Encoder, State, samples_of
from samarl.observations.frames import Frames

Unit = Callable[[str, Tensor, Tensor], Tensor]
"""Runs one of the units over its inputs [T, B, M, F], known where [T, B, M] says: [T, B, M, D]."""


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


class GraphScene(NamedTuple):
    """What the graph is in P frames."""

    node: Tensor  # [P, node] hidden state of the robot's node
    robots: Tensor  # [P, N - 1] shares of the attention
    humans: Tensor  # [P, M]


class RecurrentGraph(Encoder):
    """Spatial edges, a temporal edge that attends to them, and a node; all are recurrent.

    In what follows a leading T goes over the frames, and robots stand before humans.
    """

    units: Mapping[str, RecurrentUnit]  # `temporal`, `node`, and those of the spatial edges

    @abstractmethod
    def _hidden(self, robots: int, humans: int) -> dict[str, tuple[int, int]]:
        """How many sequences each unit has for one robot, and the width of its hidden state."""

    @abstractmethod
    def _temporal(self, frames: Frames) -> Tensor:
        """What the temporal edge is given, [T, B, 1, F]."""

    @abstractmethod
    def _spatial(self, frames: Frames, unit: Unit) -> Tensor:
        """The hidden states of the spatial edges, [T, B, N - 1 + M, D]."""

    @abstractmethod
    def _attend(
        self, temporal: Tensor, spatial: Tensor, known: Tensor, robots: int
    ) -> tuple[Tensor, Tensor]:
        """What the temporal edge finds, [T, B, F], and the shares of all, [T, B, N - 1 + M].

        Args:
            temporal: [T, B, 1, D] its hidden states.
            spatial: [T, B, N - 1 + M, D].
            known: [T, B, N - 1 + M]; the shares of others are zero.
            robots: how many of them are robots, N - 1.
        """

    @abstractmethod
    def _node(self, frames: Frames, temporal: Tensor, found: Tensor) -> Tensor:
        """What the node is given, [T, B, F]; `temporal` is [T, B, D]."""

    def observe(
        self, frames: Frames, is_init: Tensor, state: State, samples: Tensor | None = None
    ) -> GraphScene:
        """See `Encoder.observe`."""
        scene, _ = self._unrolled(frames, is_init, state)
        return scene if samples is None else samples_of(scene, samples)

    def initial_state(self, frame: Frames) -> State:
        """The hidden states of all units, [B, number of them, D]."""
        sizes = self._hidden(frame.robots.shape[2], frame.humans.shape[2])
        return {name: frame.ego.new_zeros(len(frame.ego), *size) for name, size in sizes.items()}

    def step(self, frame: Frames, is_init: Tensor, state: State) -> Any:
        """See `Encoder.step`."""
        scene, after = self._unrolled(frame, is_init.unsqueeze(1), state)
        for name, hidden in after.items():
            state[name][:] = hidden.to(state[name].dtype)
        return scene

    def attention(self, scene: GraphScene, query: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.attention`; it is the same whatever is asked."""
        return scene.robots, scene.humans

    def _unrolled(self, frames: Frames, is_init: Tensor, state: State) -> tuple[GraphScene, State]:
        """The scene of all frames [B T, ...], and the state after the last."""
        f, begins = frames.map(lambda tensor: tensor.transpose(0, 1)), is_init.T  # [T, B, ...]
        after: State = {}

        def unit(name: str, inputs: Tensor, known: Tensor) -> Tensor:
            hidden: Tensor = self.units[name](inputs, known, begins, state[name])
            after[name] = hidden[-1]
            return hidden

        always = torch.ones_like(begins).unsqueeze(-1)
        temporal = unit("temporal", self._temporal(f), always)
        spatial = self._spatial(f, unit)
        known = torch.cat([f.robots_known, f.humans_known], -1)
        robots = f.robots.shape[2]
        found, share = self._attend(temporal, spatial, known, robots)
        given = self._node(f, temporal.squeeze(2), found)
        node = unit("node", given.unsqueeze(2), always).squeeze(2)
        parts = (node, share[..., :robots], share[..., robots:])
        return GraphScene(*(x.transpose(0, 1).flatten(0, 1) for x in parts)), after
