"""SARL's crowd: every encounter is embedded alone, and attention weighs them.

Chen et al., Crowd-robot interaction: crowd-aware robot navigation with attention-based deep
reinforcement learning (2019), without its local maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from mrsan.fields import required
from samarl.encoders.encoder import ENCODERS, Encoder, State, single_frames
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.frames import Frames


@dataclass
class SocialAttentionConfig:
    """Sizes of the networks."""

    embedding: int = required(8, 1024, help="width of an encounter and of the attention layers")
    interaction: int = required(8, 1024, help="width of the crowd feature")


@ENCODERS.register("social_attention", SocialAttentionConfig)
class SocialAttentionEncoder(Encoder):
    """Y is the robot's own state and the mean of the encounters, weighed by attention.

    The score of an encounter is told the mean of all; humans and robots differ in the first layer.
    """

    def __init__(
        self, config: SocialAttentionConfig, ego_features: int, other_features: int
    ) -> None:
        """See `Encoder`."""
        super().__init__(config, ego_features, other_features)
        e, i = config.embedding, config.interaction
        self.features = ego_features + i
        self.own = nn.Linear(2 * ego_features, e)
        self.robots, self.humans = (nn.Linear(other_features, e, bias=False) for _ in range(2))
        self.embed = nn.Sequential(nn.ReLU(inplace=True), nn.Linear(e, e), nn.ReLU(inplace=True))
        self.tells = nn.Sequential(nn.Linear(e, e), nn.ReLU(inplace=True), nn.Linear(e, i))
        self.of_one, self.of_all = nn.Linear(e, e), nn.Linear(e, e, bias=False)
        self.score = nn.Sequential(nn.ReLU(inplace=True), nn.Linear(e, 1))

    def observe(
        self, frames: Frames, is_init: Tensor, state: State, samples: Tensor | None = None
    ) -> Frames:
        """See `Encoder.observe`; what is known in P samples."""
        return single_frames(frames, samples)

    def read(self, scene: Frames, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        (of, slot), encounters, share = self._weighed(scene, query)
        told = self.tells(encounters) * share[of, slot].unsqueeze(-1)
        return torch.cat([query, _sums(told, of, len(query))], -1)

    def attention(self, scene: Frames, query: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.attention`."""
        _, _, share = self._weighed(scene, query)
        robots = scene.robots.shape[1]
        return share[:, :robots], share[:, robots:]

    def _weighed(
        self, scene: Frames, query: Tensor
    ) -> tuple[tuple[Tensor, Tensor], Tensor, Tensor]:
        """The encounters with those who are known, and the attention they get.

        Slots of those who are not known cost nothing; their share is zero. Robots stand before
        humans.

        Returns:
            Of which sample and slot each of the Q encounters is, [Q] both; the encounters [Q, D];
            and the shares of all slots [P, N - 1 + M].
        """
        known = torch.cat([scene.robots_known, scene.humans_known], 1)
        of, slot = known.nonzero(as_tuple=True)
        others = torch.cat([scene.robots, scene.humans], 1)[of, slot]
        is_robot = (slot < scene.robots.shape[1]).unsqueeze(-1)
        # One layer for both: what is of a robot goes to its weights, what is of a human to its own.
        weight = torch.cat([self.robots.weight, self.humans.weight], 1)
        of_other = functional.linear(torch.cat([others * is_robot, others * ~is_robot], 1), weight)
        own = self.own(torch.cat([scene.ego, query], -1))
        encounters = self.embed(of_other + own[of])
        mean = _sums(encounters, of, len(known)) / known.sum(1, keepdim=True).clamp_min(1)
        score = self.score(self.of_one(encounters) + self.of_all(mean)[of]).squeeze(-1)
        scores = torch.full_like(known, MASKED, dtype=score.dtype).index_put((of, slot), score)
        return (of, slot), encounters, torch.softmax(scores, -1) * known


def _sums(of_encounters: Tensor, of: Tensor, samples: int) -> Tensor:
    """Sums over the encounters of each of P samples, [P, D]; `of` [Q] says of which each is."""
    zero = of_encounters.new_zeros(samples, of_encounters.shape[-1])
    if torch.onnx.is_in_onnx_export():  # where what index_add adds to one row twice is lost
        return zero.scatter_add(0, of.unsqueeze(-1).expand_as(of_encounters), of_encounters)
    return zero.index_add(0, of, of_encounters)
