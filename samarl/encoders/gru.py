"""A recurrent encoder: a maximum over the agents, remembered by a gated recurrent unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS, Encoder, EncoderState
from samarl.observations.frames import FeatureSizes, Frames


@dataclass
class GRUConfig:
    """Sizes of the recurrent encoder."""

    width: int = required(8, 1024, help="width of the embeddings and of the hidden state")
    features: int = required(8, 4096, help="length of the output Y")


def unroll(cell: nn.GRUCell, inputs: Tensor, is_init: Tensor, hidden: Tensor) -> Tensor:
    """Return the hidden states [B, T, D] of a recurrent cell.

    Args:
        cell: called once per frame.
        inputs: [B, T, F].
        is_init: [B, T] bool, an episode begins and the hidden state is cleared.
        hidden: [B, D] before the first frame.
    """
    hidden_states = []
    for t in range(inputs.shape[1]):
        hidden = cell(inputs[:, t], torch.where(is_init[:, t, None], 0.0, hidden))
        hidden_states.append(hidden)
    return torch.stack(hidden_states, 1)


@ENCODERS.register("gru", GRUConfig)
class GRUEncoder(Encoder):
    """Embed every agent, pool each feature by its maximum, and feed a GRU (Cho et al., 2014)."""

    def __init__(self, config: GRUConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        width, self.features = config.width, config.features
        self.ego = nn.Linear(sizes.ego, width)
        self.humans, self.robots = (
            nn.Sequential(
                nn.Linear(sizes.entities[group], width), nn.ReLU(), nn.Linear(width, width)
            )
            for group in ("humans", "robots")
        )
        self.cell = nn.GRUCell(width, width)
        self.query = nn.Linear(sizes.ego, width)
        self.out = nn.Sequential(nn.ReLU(), nn.Linear(2 * width, config.features), nn.ReLU())

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> Tensor:
        """See `Encoder.observe`; the scene is the summary plus the hidden state, [P, D]."""
        summary = self._summary(frames)
        scene = (summary + unroll(self.cell, summary, is_init, state["hidden"])).flatten(0, 1)
        return scene if samples is None else scene[samples]

    def read(self, scene: Tensor, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        return self.out(torch.cat([scene, self.query(query)], -1))

    def initial_state(self, frame: Frames) -> EncoderState:
        """The hidden state, [B, D]."""
        return {"hidden": frame.ego.new_zeros(len(frame.ego), self.cell.hidden_size)}

    def step(self, frame: Frames, is_init: Tensor, state: EncoderState) -> Any:
        """See `Encoder.step`."""
        summary = self._summary(frame)[:, 0]
        hidden = self.cell(summary, torch.where(is_init[:, None], 0.0, state["hidden"]))
        state["hidden"][:] = hidden
        return summary + hidden

    def _summary(self, frames: Frames) -> Tensor:
        """Return the maximum over agents of each feature in each frame, [B, T, D]."""
        out = self.ego(frames.ego)
        for embed, (others, known) in (
            (self.humans, frames.entities["humans"]),
            (self.robots, frames.entities["robots"]),
        ):
            if others.shape[2]:
                out = out + (torch.relu(embed(others)) * known.unsqueeze(-1)).amax(2)
        return torch.relu(out)
