"""Macro actions: a waypoint near the route and, before it, a mode; and how they are observed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mrsan import Entities
from mrsan.fields import number, required, setting
from samarl.observations.features import (
    EGO_PLACE,
    EGO_ROUTE,
    EGO_TARGET,
    EGO_TIME,
    EGO_VELOCITY,
    NEAR_NOW,
    POSITION,
)
from samarl.observations.frames import Frames
from samarl.observations.tracker import Tracks
from samarl.policies.policy import WAYPOINT_FEATURES, PolicyConfig
from samarl.registry import needed

YIELD_BACK, YIELD_ASIDE = 1.0, 1.2  # m; where a robot makes way: back along the route, and aside

STANDING = 0.1  # m/s; a robot that is slower stands
IN_THE_WAY = 0.5  # m; somebody whose surface is nearer may block the way


class Waypoints(Enum):
    """Where the waypoints of the local level come from; all but the first are ablations."""

    learned = "the macro level"
    first = "the macro level, once in an episode"
    random = "drawn uniformly, as is the mode"
    shuffled = "the macro level's choice for the next robot"


class Mode(IntEnum):
    """What a robot does until its next macro action."""

    go = 0  # to a waypoint near the route
    wait = 1  # where it is
    yield_left = 2  # make way: back and to the left of the route, or ...
    yield_right = 3  # ... to the right


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
        0.1, 100.0, unit="m", help="largest distance by which the macro level moves a waypoint"
    )
    waypoint_progress: float = required(
        0.0, 100.0, help="reward of the local level per metre towards its waypoint"
    )
    local_goal: bool = needed(help="the local level also observes the goal")
    arrival_bonus: float = required(
        0.0, 1000.0, help="additional reward of the local level for arriving"
    )
    observes_intent: bool = setting(
        False, kw_only=True, help="robots observe the waypoints and modes that team-mates report"
    )
    modes: bool = setting(
        False, kw_only=True, help="the macro level chooses to go, to wait or to yield to a side"
    )
    ends_when_blocked: bool = setting(
        False, kw_only=True, help="a macro action also ends when somebody stands in the way"
    )
    making_way_steps: int = number(16, 1, 1000, help="steps for which a robot waits or yields")
    making_way_penalty: float = number(
        0.25,
        0.0,
        100.0,
        help="penalty per step and metre from the waypoint of a robot that waits or yields",
    )


def waypoint_of(config: HierarchicalConfig, route: Tensor, macro: Tensor) -> Tensor:
    """Return the waypoints [B, 2] in the body frame (m) of macro actions [B, A].

    A robot that goes has its waypoint on the route, `waypoint_ahead` in front of it, moved by the
    macro action in [-1, 1] times `waypoint_range`; zero means "along the route". Without
    `local_goal` it is moved by proportionally less once less than `waypoint_ahead` of the route
    remains: a local level that does not see the goal could not reach it otherwise. The waypoint of
    a robot that waits is its own position; that of one that yields lies straight back from the
    direction of the route and to the side.

    Args:
        config: of the policy.
        route: [B, 2] where the route leads next in the body frame, m.
        macro: [B, A] before clipping.
    """
    c = config
    mode, offset = macro[:, 0], macro[:, -2:]  # without `modes` there is no mode, only the offset
    distance = route.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    share = (c.waypoint_ahead / distance).clamp(max=1.0)
    reach = c.waypoint_range
    if not c.local_goal:
        reach = reach * (distance / c.waypoint_ahead).clamp(max=1.0)
    going = route * share + reach * offset.clamp(-1.0, 1.0)
    if not c.modes:
        return going
    ahead = route / distance
    left = torch.stack([-ahead[:, 1], ahead[:, 0]], -1)
    side = (mode == Mode.yield_left).to(route.dtype) - (mode == Mode.yield_right).to(route.dtype)
    side = side.unsqueeze(-1)
    making_way = YIELD_ASIDE * side * left - YIELD_BACK * side.abs() * ahead
    return torch.where((mode == Mode.go).unsqueeze(-1), going, making_way)


def is_blocked(frames: Frames, waypoint: Tensor) -> Tensor:
    """Return which robots [B] stand because somebody is in the way of their waypoint.

    A robot stands below `STANDING`; a person or robot is in the way whose surface is nearer than
    `IN_THE_WAY` and who is less than 60 degrees from the direction of the waypoint.

    Args:
        frames: [B, 1, ...] the features of the networks.
        waypoint: [B, 2] in the body frame, m.
    """
    ego = frames.ego[:, 0]
    blocked = torch.zeros_like(ego[:, 0], dtype=torch.bool)
    ahead = waypoint / waypoint.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    for name in ("humans", "robots"):
        features, known = (tensor[:, 0] for tensor in frames.entities[name])
        position = features[..., POSITION]
        cos = (position * ahead.unsqueeze(1)).sum(-1) / position.norm(dim=-1).clamp_min(1e-6)
        near = features[..., NEAR_NOW] > math.exp(-2.0 * IN_THE_WAY)
        blocked = blocked | (known & near & (cos > 0.5)).any(-1)
    return blocked & (ego[:, EGO_VELOCITY].norm(dim=-1) < STANDING)


def encode_macro_action(waypoint: Tensor, mode: Tensor | None) -> Tensor:
    """Return the features [..., W] of waypoints in the body frame [..., 2] and modes [...]."""
    features = encode_waypoint(waypoint)
    if mode is None:
        return features
    one_hot = torch.nn.functional.one_hot(mode, len(Mode)).to(features.dtype)
    return torch.cat([features, one_hot], -1)


def waypoint_size(config: HierarchicalConfig) -> int:
    """Return the number of features of a waypoint and, with modes, of its mode, W."""
    return WAYPOINT_FEATURES + len(Mode) * config.modes


def with_waypoints(tracks: Tracks, waypoints: NDArray[np.float32]) -> Tracks:
    """Return tracks whose robots also have the features [E, N, N - 1, W] of their waypoints."""
    features, known = tracks.entities["robots"]
    robots = Entities(np.concatenate([features, waypoints], -1), known)
    return tracks._replace(entities=tracks.entities | {"robots": robots})


def encode_waypoint(waypoint: Tensor) -> Tensor:
    """Return the features [..., 3] of a waypoint in the body frame [..., 2], m."""
    return torch.cat([waypoint / 2.0, torch.exp(-waypoint.norm(dim=-1, keepdim=True))], -1)


def decode_waypoint(features: Tensor) -> Tensor:
    """Return the waypoint in the body frame [..., 2], m; the inverse of `encode_waypoint`."""
    return 2.0 * features[..., 0:2]


def without_goal(ego: Tensor, hide_route: bool) -> Tensor:
    """Return own states [..., F_e] without goal, place, time and, with `hide_route`, the route."""
    blind = ego.clone()
    for hidden in (EGO_TARGET, EGO_PLACE, EGO_TIME, *([EGO_ROUTE] if hide_route else [])):
        blind[..., hidden] = 0.0
    return blind
