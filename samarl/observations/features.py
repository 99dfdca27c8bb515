"""What the networks are given: what a robot knows, and the true state, both scaled.

Shapes: E worlds, N robots, M humans, B = E N robots of all worlds, one frame.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from mrsan import Scenario, World
from mrsan.features import (
    GOAL,
    HEADING_COS,
    HEADING_SIN,
    ORIGIN,
    ORIGIN_X,
    ORIGIN_Y,
    OTHER_POSITION,
    OTHER_RADIUS,
    OTHER_VELOCITY,
    TIME,
    VELOCITY,
)
from mrsan.se2 import rotate, untransform
from samarl.observations.frames import Frames
from samarl.observations.tracker import AGE, Tracks

A = TypeVar("A", NDArray[np.float32], Tensor)

LENGTH_SCALE = 5.0  # metres that are 1 to the network
NETWORK_EGO_FEATURES = 11
NETWORK_OTHER_FEATURES = 10  # of what a robot knows of another
STATE_OTHER_FEATURES = 12  # of the true state of another

# Where some of them stand in what a robot knows of itself, see `_own`:
EGO_TARGET = slice(0, 5)  # see `features_of_target`
EGO_DIRECTION = slice(2, 4)  # of the goal, of length 1
EGO_VELOCITY = slice(5, 7)
EGO_PLACE = slice(7, 9)  # the map's origin
EGO_TIME = slice(9, 10)

# Where some of them stand in what a robot knows of another, see `_others`:
POSITION = slice(0, 2)  # seen from the robot, in units of LENGTH_SCALE
RADIUS = slice(4, 5)  # m
NEAR_NOW = 5  # exp(-2 gap), gap the distance between surfaces in m
NEAR_SOON = 8  # the same of the closest approach ahead, times exp(-0.5 t), t s away


def frames_of(tracks: Tracks, scenario: Scenario, known_origin: bool = True) -> Frames:
    """What the robots know: the input of the actors' encoder.

    The tracks may be tensors as well: so these features are part of an exported policy.

    A policy for any place must not know where the middle of the map is: it would learn what is
    there.
    """
    age = [torch.as_tensor(known[..., AGE : AGE + 1]) for known in (tracks.humans, tracks.robots)]
    humans = _others(tracks.humans, age[0], tracks.humans_known, scenario)
    robots = _others(tracks.robots, age[1], tracks.robots_known, scenario)
    own = _own(tracks.ego, scenario)
    if not known_origin:
        own[..., EGO_PLACE] = 0.0
    return Frames(own, *humans, *robots)


def state_of(world: World) -> Frames:
    """The true state seen from every robot: the input of the critics' encoder.

    Everybody is known, with the goal, and robots with whether they have arrived.
    """
    state, scenario = world.state, world.scenario
    seen = world.observe(all_seeing=True)
    n = scenario.robots
    others = np.array([[k for k in range(n) if k != i] for i in range(n)], int).reshape(n, n - 1)
    human_goals = np.repeat(state.human_goal[:, None], n, 1)  # [E, N, M, 2]
    robot_goals, arrived = state.robot_goal[:, others], state.arrived[:, others]
    found: list[Tensor] = []
    for rows, visible, goals, there in (
        (seen.humans, seen.humans_visible, human_goals, np.zeros(human_goals.shape[:3], np.bool_)),
        (seen.robots, seen.robots_visible, robot_goals, arrived),
    ):
        goal = to_body(goals, seen.ego[:, :, None]) / np.float32(LENGTH_SCALE)
        extra = torch.from_numpy(np.concatenate([goal, there[..., None]], -1, dtype=np.float32))
        found += _others(rows, extra, visible, scenario)
    return Frames(_own(seen.ego, scenario), *found)


def speed_of(ego: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the speeds of robots from their own states [..., 11], m/s."""
    speed: NDArray[np.float32] = np.linalg.norm(ego[..., VELOCITY], axis=-1)
    return speed


def to_world(point: A, ego: A) -> A:
    """From the body frames of robots `ego` [..., 11] to the world frame, [..., 2]."""
    cos, sin = ego[..., HEADING_COS], ego[..., HEADING_SIN]
    dx, dy = point[..., 0] - ego[..., ORIGIN_X], point[..., 1] - ego[..., ORIGIN_Y]
    return _stacked(*rotate(cos, sin, dx, dy))


def to_body(point: A, ego: A) -> A:
    """From the world frame to the body frames of robots `ego` [..., 11], [..., 2]."""
    cos, sin = ego[..., HEADING_COS], ego[..., HEADING_SIN]
    x, y = rotate(cos, sin, ego[..., ORIGIN_X], ego[..., ORIGIN_Y])
    return _stacked(*untransform(cos, sin, -x, -y, point[..., 0], point[..., 1]))


def _stacked(x: A, y: A) -> A:
    if isinstance(x, Tensor):
        return torch.stack([x, y], -1)
    return np.stack([x, y], -1)


def _own(of_robots: NDArray[np.float32], scenario: Scenario) -> Tensor:
    """[B, 1, NETWORK_EGO_FEATURES]."""
    ego = torch.as_tensor(of_robots).flatten(0, 1)
    goal, velocity, origin = ego[:, GOAL], ego[:, VELOCITY], ego[:, ORIGIN]
    view = ego.new_full((len(ego), 1), math.cos(math.radians(scenario.fov_degrees / 2)))
    own = torch.cat(
        [
            features_of_target(goal),
            velocity,
            origin / LENGTH_SCALE,
            ego[:, TIME : TIME + 1],
            view,
        ],
        -1,
    )
    return own.unsqueeze(1)


def features_of_target(target: Tensor) -> Tensor:
    """A place in the body frame [..., 2] as a network is told it, [..., 5]."""
    distance = target.norm(dim=-1, keepdim=True)
    direction = target / distance.clamp_min(1e-3)
    return torch.cat([target / LENGTH_SCALE, direction, torch.exp(-distance)], -1)


def _others(
    of_others: NDArray[np.float32], extra: Tensor, known: NDArray[np.bool_], scenario: Scenario
) -> tuple[Tensor, Tensor]:
    """Features [B, 1, M, 9 + extra] and mask [B, 1, M], with the closest approach ahead.

    That is when and how near the two will pass if both keep their velocities.
    """
    others, mask = torch.as_tensor(of_others).flatten(0, 1), torch.as_tensor(known).flatten(0, 1)
    position, velocity = others[..., OTHER_POSITION], others[..., OTHER_VELOCITY]
    radii = others[..., OTHER_RADIUS : OTHER_RADIUS + 1] + scenario.robot_radius
    gap = position.norm(dim=-1, keepdim=True) - radii
    closing = -(position * velocity).sum(-1, keepdim=True)
    time = (closing / velocity.square().sum(-1, keepdim=True).clamp_min(1e-3)).clamp(0.0, 5.0)
    miss = (position + time * velocity).norm(dim=-1, keepdim=True) - radii
    soon, near = torch.exp(-0.5 * time), torch.exp(-2.0 * miss.clamp_min(0.0))
    features = torch.cat(
        [
            position / LENGTH_SCALE,
            velocity,
            others[..., OTHER_RADIUS : OTHER_RADIUS + 1],
            torch.exp(-2.0 * gap.clamp_min(0.0)),
            soon,
            near,
            soon * near,
            extra.flatten(0, 1),
        ],
        -1,
    )
    return (features * mask.unsqueeze(-1)).unsqueeze(1), mask.unsqueeze(1)
