"""The central critics of both levels; needed in training alone, they see the true state."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from samarl.encoders import Frames
from samarl.encoders.spatio_temporal import Pool, nearness
from samarl.observations.features import NETWORK_EGO_FEATURES, STATE_OTHER_FEATURES


class CentralEncoder(nn.Module):
    """From the true state seen from a robot to a feature for its critics.

    The state holds all velocities and goals, so a single frame tells everything.
    """

    def __init__(self, width: int, heads: int, out: int) -> None:
        super().__init__()

        def perceptron(inputs: int, outputs: int) -> nn.Sequential:
            return nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, outputs))

        self.own = perceptron(NETWORK_EGO_FEATURES, width)
        self.embed_humans = perceptron(STATE_OTHER_FEATURES, width)
        self.embed_robots = perceptron(STATE_OTHER_FEATURES, width)
        self.humans, self.robots = Pool(width, heads), Pool(width, heads)
        self.out = nn.Sequential(nn.Linear(3 * width, out), nn.ReLU(), nn.Linear(out, out))

    def forward(self, state: Frames) -> Tensor:
        """Features [B, T, out] of `state` [B, T, ...]."""
        own = self.own(state.ego.flatten(0, 1))
        pooled = [own]
        for pool, embed, others, known in (
            (self.humans, self.embed_humans, state.humans, state.humans_known),
            (self.robots, self.embed_robots, state.robots, state.robots_known),
        ):
            others, known = others.flatten(0, 1), known.flatten(0, 1)
            score = nearness(others, known, pool.heads)
            pooled.append(pool(own, torch.relu(embed(others)), score))
        features = torch.relu(self.out(torch.cat(pooled, -1)))
        return features.unflatten(0, state.ego.shape[:2])


class Critic(nn.Module):
    """A central value: the robot's own feature and the mean of its team-mates'."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Linear(2 * inputs, hidden),
            nn.Tanh(),
            nn.Linear(hidden, hidden),
            nn.Tanh(),
            nn.Linear(hidden, 1),
        )

    def forward(self, joint: Tensor) -> Tensor:
        """Value [..., 1] of joint features [..., 2 F], in units of the value normaliser."""
        return self.body(joint)


def joint_features(own: Tensor) -> Tensor:
    """Own features and the mean of the other robots', [E, ..., N, F] to [E, ..., N, 2 F]."""
    n = own.shape[-2]
    others = (own.sum(-2, keepdim=True) - own) / max(n - 1, 1)
    return torch.cat([own, others], -1)
