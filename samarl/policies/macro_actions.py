"""Macro actions: a waypoint near the route and, before it, a mode; and how they are observed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.jit import is_tracing  # type: ignore[attr-defined]

from mrsan import Entities
from mrsan.fields import number, required, setting
from samarl.observations.features import (
    EGO_OTHER_ROUTE,
    EGO_PLACE,
    EGO_ROUTE,
    EGO_TARGET,
    EGO_TIME,
    EGO_VELOCITY,
    LENGTH_SCALE,
    NEAR_NOW,
    POSITION,
    nearest_on_segments,
)
from samarl.observations.frames import Frames
from samarl.observations.tracker import Tracks
from samarl.policies.policy import WAYPOINT_FEATURES, PolicyConfig
from samarl.registry import needed

PLACES_TO_YIELD = [(back, aside) for aside in (1.2, 0.8) for back in (1.0, 0.0, 2.0, 3.0)]
"""Where a robot may yield, best first: back along the route and aside from it, m."""
ROOM = 0.4  # m from walls, which a robot needs where it yields

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
    other_route = 4  # along another route, if the robot observes one


def makes_way(mode: Tensor) -> Tensor:
    """Return a mask of the modes [...] that make way: to wait, and to yield."""
    return (mode >= Mode.wait) & (mode <= Mode.yield_right)


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
    observes_intent: bool = setting(
        False, kw_only=True, help="robots observe the waypoints and modes that team-mates report"
    )
    modes: bool = setting(
        False, kw_only=True, help="the macro level chooses to go, wait, yield or take another route"
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


def waypoint_of(
    config: HierarchicalConfig, route: Tensor, macro: Tensor, frames: Frames | None = None
) -> Tensor:
    """Return the waypoints [B, 2] in the body frame (m) of macro actions [B, A].

    A robot that goes has its waypoint `waypoint_ahead` in front of it towards the next point of its
    route (a corner or the goal), or at that point if it is nearer. The macro action in [-1, 1]
    times `waypoint_range` moves it. Without `local_goal` it is moved by proportionally less where
    the next point is nearer than `waypoint_ahead`: a local level that does not see the goal could
    not reach it otherwise. The waypoint of a robot that waits is its own position, and that of one
    that yields is beside its route, see `place_to_yield`. On another route the waypoint is not
    moved; without one the robot stays on its route.

    Args:
        config: of the policy.
        route: [B, 2] where the route leads next in the body frame, m.
        macro: [B, A] before clipping.
        frames: [B, 1, ...] the features of the networks; only used with modes.
    """
    c = config
    offset = macro[:, -2:]  # without `modes` there is no mode, only the offset
    distance = route.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    reach = c.waypoint_range
    if not c.local_goal:
        reach = reach * (distance / c.waypoint_ahead).clamp(max=1.0)
    going = _ahead(config, route) + reach * offset.clamp(-1.0, 1.0)
    if not c.modes:
        return going
    assert frames is not None
    mode = macro[:, :1]
    waypoint = torch.where(mode == Mode.go, going, torch.zeros_like(going))
    other = _ahead(config, other_route(frames, route))
    waypoint = torch.where(mode == Mode.other_route, other, waypoint)
    direction = route / distance
    for side, sign in ((Mode.yield_left, 1.0), (Mode.yield_right, -1.0)):
        yields = mode == side
        if is_tracing() or yields.any():
            waypoint = torch.where(yields, place_to_yield(direction, sign, frames), waypoint)
    return waypoint


def _ahead(config: HierarchicalConfig, route: Tensor) -> Tensor:
    """Return the points `waypoint_ahead` away, or less, in the direction of `route` [B, 2], m."""
    distance = route.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    return route * (config.waypoint_ahead / distance).clamp(max=1.0)


def other_route(frames: Frames, route: Tensor) -> Tensor:
    """Return where another route leads next in the body frame [B, 2], m; without one, `route`."""
    features = frames.ego[:, 0, EGO_OTHER_ROUTE]
    if features.shape[-1] == 0:
        return route
    position = LENGTH_SCALE * features[:, :2]
    return torch.where((position != 0.0).any(-1, keepdim=True), position, route)


def place_to_yield(ahead: Tensor, side: float, frames: Frames) -> Tensor:
    """Return where robots yield in the body frame, [B, 2], m.

    That is the first of `PLACES_TO_YIELD` to which the robot can move straight, with `ROOM` to the
    walls there; without a free place, the robot's position. In front of a doorway this is a place
    beside it, and in a corridor a niche.

    Args:
        ahead: [B, 2] direction of the route, of length 1.
        side: 1: to the left, -1: to the right.
        frames: [B, 1, ...] the features of the networks, with the walls if there are any.
    """
    back, aside = torch.tensor(PLACES_TO_YIELD, device=ahead.device).unbind(-1)
    left = torch.stack([-ahead[:, 1], ahead[:, 0]], -1)
    places = side * aside[:, None] * left[:, None] - back[:, None] * ahead[:, None]  # [B, C, 2]
    if "walls" not in frames.entities:
        return places[:, 0]
    features, known = (tensor[:, 0] for tensor in frames.entities["walls"])
    start, end = (LENGTH_SCALE * features[:, None, :, s] for s in (slice(0, 2), slice(2, 4)))
    along = end - start  # [B, 1, K, 2], from here on with C places
    to_place = places[:, :, None] - start
    near = (to_place - nearest_on_segments(to_place, along)).norm(dim=-1) < ROOM
    # A wall is in between if place and robot are on different sides of it, and its ends on
    # different sides of the way.
    across = _cross(along, to_place) * _cross(along, -start) < 0.0
    way = places[:, :, None]
    between = across & (_cross(way, start) * _cross(way, end) < 0.0)
    free = ~((near | between) & known[:, None]).any(-1)  # [B, C]
    first = free.long().argmax(1)
    place = places[torch.arange(len(places), device=ahead.device), first]
    return place * free.any(1, keepdim=True)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """Return the cross products [...] of vectors [..., 2]."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


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
    """Return own states [..., F_e] without goal, place, time and, with `hide_route`, routes."""
    blind = ego.clone()
    routes = [EGO_ROUTE, EGO_OTHER_ROUTE] if hide_route else []
    for hidden in (EGO_TARGET, EGO_PLACE, EGO_TIME, *routes):
        blind[..., hidden] = 0.0
    return blind
