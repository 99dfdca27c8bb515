"""SARL's crowd: every encounter is embedded alone, and attention weighs them.

Chen et al., Crowd-robot interaction: crowd-aware robot navigation with attention-based deep
reinforcement learning (2019), without its local maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from mrsan.scenario import required
from samarl.encoders.encoder import ENCODERS, Encoder, State
from samarl.encoders.windowed_attention import MASKED
from samarl.observations.frames import Frames


@dataclass
class SocialAttentionConfig:
    """Sizes of the networks."""

    embedding: int = required(8, 1024)  # of an encounter, and of the layers of the attention
    interaction: int = required(8, 1024)  # of what it tells of the crowd


class SocialAttentionScene(NamedTuple):
    """The robot and whom it knows, P samples; robots stand before humans."""

    ego: Tensor  # [P, F_e]
    robots: Tensor  # [P, N - 1, F_o]
    humans: Tensor  # [P, M, F_o]
    known: Tensor  # [P, N - 1 + M]


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
    ) -> SocialAttentionScene:
        """See `Encoder.observe`."""
        ego, humans, humans_known, robots, robots_known = (
            tensor.flatten(0, 1) if samples is None else tensor.flatten(0, 1)[samples]
            for tensor in frames
        )
        return SocialAttentionScene(ego, robots, humans, torch.cat([robots_known, humans_known], 1))

    def read(self, scene: SocialAttentionScene, query: Tensor) -> Tensor:
        """See `Encoder.read`."""
        encounters, share = self._weighed(scene, query)
        told = self.tells(encounters) * share[scene.known].unsqueeze(-1)
        return torch.cat([query, _sums(told, scene.known)], -1)

    def attention(self, scene: SocialAttentionScene, query: Tensor) -> tuple[Tensor, Tensor]:
        """See `Encoder.attention`."""
        _, share = self._weighed(scene, query)
        robots = scene.robots.shape[1]
        return share[:, :robots], share[:, robots:]

    def _weighed(self, scene: SocialAttentionScene, query: Tensor) -> tuple[Tensor, Tensor]:
        """The Q encounters with those who are known [Q, D], and all shares [P, N - 1 + M].

        Slots of those who are not known cost nothing; their share is zero.
        """
        known = scene.known
        of, slot = known.nonzero(as_tuple=True)
        others = torch.cat([scene.robots, scene.humans], 1)[known]
        is_robot = (slot < scene.robots.shape[1]).unsqueeze(-1)
        # One layer for both: what is of a robot goes to its weights, what is of a human to its own.
        weight = torch.cat([self.robots.weight, self.humans.weight], 1)
        of_other = functional.linear(torch.cat([others * is_robot, others * ~is_robot], 1), weight)
        own = self.own(torch.cat([scene.ego, query], -1))
        encounters = self.embed(of_other + own[of])
        mean = _sums(encounters, known) / known.sum(1, keepdim=True).clamp_min(1)
        score = self.score(self.of_one(encounters) + self.of_all(mean)[of]).squeeze(-1)
        scores = torch.full_like(known, MASKED, dtype=score.dtype).index_put((of, slot), score)
        return encounters, torch.softmax(scores, -1) * known


def _sums(of_encounters: Tensor, known: Tensor) -> Tensor:
    """Sums over the encounters of each sample, [P, D]."""
    zero = of_encounters.new_zeros(len(known), of_encounters.shape[-1])
    return zero.index_add(0, known.nonzero()[:, 0], of_encounters)
