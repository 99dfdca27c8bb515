"""SARL's encoder: each encounter is embedded separately, and attention weighs them.

Chen et al., Crowd-robot interaction: crowd-aware robot navigation with attention-based deep
reinforcement learning (2019), without its local maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS, Encoder, EncoderState, single_frames
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.frames import FeatureSizes, Frames


@dataclass
class SocialAttentionConfig:
    """Sizes of the networks."""

    embedding: int = required(8, 1024, help="width of an encounter and of the attention layers")
    interaction: int = required(8, 1024, help="width of the crowd feature")


@ENCODERS.register("social_attention", SocialAttentionConfig)
class SocialAttentionEncoder(Encoder):
    """Y is the robot's own state and the attention-weighted sum of its encounters.

    The score of an encounter also depends on the mean of all encounters. Humans and robots have
    different first layers.
    """

    def __init__(self, config: SocialAttentionConfig, sizes: FeatureSizes) -> None:
        """See `Encoder`."""
        super().__init__(config, sizes)
        e, i = config.embedding, config.interaction
        self.features = sizes.ego + i
        self.own = nn.Linear(2 * sizes.ego, e)
        self.robots, self.humans = (
            nn.Linear(sizes.entities[group], e, bias=False) for group in ("robots", "humans")
        )
        self.embed = nn.Sequential(nn.ReLU(inplace=True), nn.Linear(e, e), nn.ReLU(inplace=True))
        self.tells = nn.Sequential(nn.Linear(e, e), nn.ReLU(inplace=True), nn.Linear(e, i))
        self.of_one, self.of_all = nn.Linear(e, e), nn.Linear(e, e, bias=False)
        self.score = nn.Sequential(nn.ReLU(inplace=True), nn.Linear(e, 1))

    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> Frames:
        """See `Encoder.observe`; the scene is the frames of P samples."""
        return single_frames(frames, samples)

    def read(self, scene: Frames, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        (sample, slot), encounters, weight = self._attend(scene, query)
        weighted = self.tells(encounters) * weight[sample, slot].unsqueeze(-1)
        return torch.cat([query, _sum_by_sample(weighted, sample, len(query))], -1)

    def attention(self, scene: Frames, query: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.attention`."""
        _, _, weight = self._attend(scene, query)
        robots = scene.robots.shape[1]
        return weight[:, :robots], weight[:, robots:]

    def _attend(self, scene: Frames, query: Tensor) -> tuple[tuple[Tensor, Tensor], Tensor, Tensor]:
        """Return the encounters with known agents and their attention weights.

        Only known agents are embedded. Robots come before humans.

        Returns:
            Sample and slot of each of the Q encounters, [Q] both; the encounters [Q, D]; and the
            weights of all slots [P, N - 1 + M], zero where nobody is known.
        """
        known = torch.cat([scene.robots_known, scene.humans_known], 1)
        sample, slot = known.nonzero(as_tuple=True)
        others = torch.cat([scene.robots, scene.humans], 1)[sample, slot]
        is_robot = (slot < scene.robots.shape[1]).unsqueeze(-1)
        # One product for both: features of a robot meet the robots' weights, those of a human the
        # humans'.
        weight = torch.cat([self.robots.weight, self.humans.weight], 1)
        embedded = functional.linear(torch.cat([others * is_robot, others * ~is_robot], 1), weight)
        own = self.own(torch.cat([scene.ego, query], -1))
        encounters = self.embed(embedded + own[sample])
        number = known.sum(1, keepdim=True).clamp_min(1)
        mean = _sum_by_sample(encounters, sample, len(known)) / number
        score = self.score(self.of_one(encounters) + self.of_all(mean)[sample]).squeeze(-1)
        scores = torch.full_like(known, MASKED, dtype=score.dtype).index_put((sample, slot), score)
        return (sample, slot), encounters, torch.softmax(scores, -1) * known


def _sum_by_sample(values: Tensor, sample: Tensor, samples: int) -> Tensor:
    """Return the sums [P, D] of values [Q, D] that belong to the same of P samples."""
    zero = values.new_zeros(samples, values.shape[-1])
    if torch.onnx.is_in_onnx_export():  # its index_add drops repeated indices
        return zero.scatter_add(0, sample.unsqueeze(-1).expand_as(values), values)
    return zero.index_add(0, sample, values)
