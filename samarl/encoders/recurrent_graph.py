"""Base class of encoders that are a graph of gated recurrent units, as in Vemula et al. (2018).

A spatial edge leads from the robot to every other agent, a temporal edge from the robot to itself.
The temporal edge attends to the spatial edges, and the result is an input of the last unit, the
robot's node.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from samarl.encoders.encoder import Encoder, EncoderState, samples_of
from samarl.observations.frames import Frames

Unit = Callable[[str, Tensor, Tensor], Tensor]
"""Run a unit, by its name, over inputs [T, B, M, F] with mask [T, B, M]; return [T, B, M, D]."""


class RecurrentUnit(nn.Module):
    """A gated recurrent unit over sequences with gaps, in which episodes may begin."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.split = (2 * width, width)  # both gates, and the candidate state
        self.of_input, self.of_hidden = nn.Linear(inputs, 3 * width), nn.Linear(width, 3 * width)
        for layer in (self.of_input, self.of_hidden):  # initialised as in DSRNN
            nn.init.orthogonal_(layer.weight)
            nn.init.zeros_(layer.bias)

    def forward(self, inputs: Tensor, known: Tensor, begins: Tensor, hidden: Tensor) -> Tensor:
        """Return the hidden states after each of T frames, [T, B, M, D].

        Args:
            inputs: [T, B, M, F] of M sequences for each of B robots.
            known: [T, B, M] whether there is an input; without one the hidden state is kept.
            begins: [T, B] whether the hidden states are reset to zero before this frame.
            hidden: [B, M, D] before the first frame.
        """
        projected = self.of_input(inputs)  # of all frames at once; only the rest is sequential
        known, continues = known.unsqueeze(-1), ~begins[..., None, None]
        hidden, hidden_states = hidden.to(projected.dtype), []
        # Not projected[t], whose gradient would be as large as that of `projected`.
        for t, input_part in enumerate(projected.unbind()):
            hidden = hidden * continues[t]
            input_gates, input_state = input_part.split(self.split, -1)
            hidden_gates, hidden_state = self.of_hidden(hidden).split(self.split, -1)
            update, reset = torch.sigmoid(input_gates + hidden_gates).chunk(2, -1)
            candidate = torch.tanh(input_state + reset * hidden_state)
            hidden = torch.lerp(hidden, candidate, update * known[t])
            hidden_states.append(hidden)
        return torch.stack(hidden_states)


class GraphScene(NamedTuple):
    """The robot's node and its attention in P frames."""

    node: Tensor  # [P, node] hidden state of the robot's node
    robots: Tensor  # [P, N - 1] attention weights
    humans: Tensor  # [P, M]


class RecurrentGraph(Encoder):
    """Spatial edges, a temporal edge that attends to them, and a node; all are recurrent.

    In the methods below, the leading axis T is that of the frames, and robots come before humans.
    """

    units: Mapping[str, RecurrentUnit]  # `temporal`, `node`, and those of the spatial edges

    @abstractmethod
    def _hidden(self, robots: int, humans: int) -> dict[str, tuple[int, int]]:
        """Return the number of sequences of each unit for one robot, and its hidden size."""

    @abstractmethod
    def _temporal(self, frames: Frames) -> Tensor:
        """Return the input of the temporal edge, [T, B, 1, F]."""

    @abstractmethod
    def _spatial(self, frames: Frames, unit: Unit) -> Tensor:
        """Return the hidden states of the spatial edges, [T, B, N - 1 + M, D]."""

    @abstractmethod
    def _attend(
        self, temporal: Tensor, spatial: Tensor, known: Tensor, robots: int
    ) -> tuple[Tensor, Tensor]:
        """Return the result of the attention [T, B, F] and its weights [T, B, N - 1 + M].

        Args:
            temporal: [T, B, 1, D] hidden states of the temporal edge.
            spatial: [T, B, N - 1 + M, D].
            known: [T, B, N - 1 + M]; the weights of others are zero.
            robots: number of other robots, N - 1.
        """

    @abstractmethod
    def _node(self, frames: Frames, temporal: Tensor, attended: Tensor) -> Tensor:
        """Return the input of the node, [T, B, F], from `temporal` [T, B, D] and the attention."""

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> GraphScene:
        """See `Encoder.observe`."""
        scene, _ = self._unroll(frames, is_init, state)
        return scene if samples is None else samples_of(scene, samples)

    def initial_state(self, frame: Frames) -> EncoderState:
        """Return the hidden states of all units, [B, sequences, D]."""
        sizes = self._hidden(frame.robots.shape[2], frame.humans.shape[2])
        return {name: frame.ego.new_zeros(len(frame.ego), *size) for name, size in sizes.items()}

    def step(self, frame: Frames, is_init: Tensor, state: EncoderState) -> Any:
        """See `Encoder.step`."""
        scene, next_state = self._unroll(frame, is_init.unsqueeze(1), state)
        for name, hidden in next_state.items():
            state[name][:] = hidden.to(state[name].dtype)
        return scene

    def attention(self, scene: GraphScene, query: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.attention`; it does not depend on the query."""
        return scene.robots, scene.humans

    def _unroll(
        self, frames: Frames, is_init: Tensor, state: EncoderState
    ) -> tuple[GraphScene, EncoderState]:
        """Return the scene of all frames [B T, ...] and the state after the last one."""
        f, begins = frames.apply(lambda tensor: tensor.transpose(0, 1)), is_init.T  # [T, B, ...]
        next_state: EncoderState = {}

        def unit(name: str, inputs: Tensor, known: Tensor) -> Tensor:
            hidden: Tensor = self.units[name](inputs, known, begins, state[name])
            next_state[name] = hidden[-1]
            return hidden

        always = torch.ones_like(begins).unsqueeze(-1)
        temporal = unit("temporal", self._temporal(f), always)
        spatial = self._spatial(f, unit)
        known = torch.cat([f.robots_known, f.humans_known], -1)
        robots = f.robots.shape[2]
        attended, weights = self._attend(temporal, spatial, known, robots)
        node_input = self._node(f, temporal.squeeze(2), attended)
        node = unit("node", node_input.unsqueeze(2), always).squeeze(2)
        parts = (node, weights[..., :robots], weights[..., robots:])
        return GraphScene(*(x.transpose(0, 1).flatten(0, 1) for x in parts)), next_state
