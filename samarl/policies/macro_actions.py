"""Macro actions: a waypoint near the route, and how the local level observes it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import torch
from torch import Tensor
from torch.linalg import vector_norm

from mrsan.fields import required
from samarl.observations.features import EGO_PLACE, EGO_TARGET, EGO_TIME
from samarl.policies.policy import PolicyConfig
from samarl.registry import needed


class Waypoints(Enum):
    """Where the waypoints of the local level come from; all but the first are ablations."""

    learned = "the macro level"
    first = "the macro level, once in an episode"
    random = "drawn uniformly"
    shuffled = "the macro level's choice for the next robot"


@dataclass
class HierarchicalConfig(PolicyConfig):
    """Numbers of the two levels."""

    macro_steps: int = required(
        1, 200, help="largest number of steps for which a waypoint is held, K"
    )
    waypoint_ahead: float = required(
        0.1, 100.0, unit="m", help="distance of the default waypoint along the route"
    )
    waypoint_range: float = required(
        0.1, 100.0, unit="m", help="largest offset of a waypoint along each axis"
    )
    waypoint_progress: float = required(
        0.0, 100.0, help="reward of the local level per metre towards its waypoint"
    )
    local_goal: bool = needed(help="the local level also observes the goal")
    arrival_bonus: float = required(
        0.0, 1000.0, help="additional reward of the local level for arriving"
    )


def waypoint_of(config: HierarchicalConfig, route: Tensor, macro: Tensor) -> Tensor:
    """Return the waypoints [B, 2] in the body frame (m) of macro actions [B, 2].

    By default a waypoint is `waypoint_ahead` in front of the robot towards the next point of its
    route (a corner or the goal), or at that point if it is nearer. The macro action in [-1, 1]
    times `waypoint_range` moves it. Without `local_goal` it is moved by proportionally less where
    the next point is nearer than `waypoint_ahead`: a local level that does not see the goal could
    not reach it otherwise.

    Args:
        config: of the policy.
        route: [B, 2] where the route leads next in the body frame, m.
        macro: [B, 2] before clipping.
    """
    c = config
    distance = vector_norm(route, dim=-1, keepdim=True).clamp(min=1e-6)
    reach = c.waypoint_range
    if not c.local_goal:
        reach = reach * (distance / c.waypoint_ahead).clamp(max=1.0)
    ahead = route * (c.waypoint_ahead / distance).clamp(max=1.0)
    return ahead + reach * macro.clamp(-1.0, 1.0)


def encode_waypoint(waypoint: Tensor) -> Tensor:
    """Return the features [..., 3] of a waypoint in the body frame [..., 2], m."""
    return torch.cat([waypoint / 2.0, torch.exp(-vector_norm(waypoint, dim=-1, keepdim=True))], -1)


def decode_waypoint(features: Tensor) -> Tensor:
    """Return the waypoint in the body frame [..., 2], m; the inverse of `encode_waypoint`."""
    return 2.0 * features[..., 0:2]


def without_goal(ego: Tensor) -> Tensor:
    """Return own states [..., F_e] without goal, place and time."""
    blind = ego.clone()
    for hidden in (EGO_TARGET, EGO_PLACE, EGO_TIME):
        blind[..., hidden] = 0.0
    return blind
