"""The features of the networks: what robots know, and the true state, both scaled.

Shapes: E worlds, N robots, M humans, B = E N robots of all worlds, one frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.linalg import vector_norm

from mrsan import Entities, Observation, Scenario, World
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
from mrsan.kernels.team import MACRO_ACTION
from mrsan.plugin_values import PluginError, check_shape
from mrsan.se2 import rotate, untransform
from mrsan.sensors.suite import SensorSuite
from samarl.observations.frames import FeatureSizes, Frames
from samarl.observations.tracker import AGE, TRACK_FEATURES

A = TypeVar("A", NDArray[np.float32], Tensor)

LENGTH_SCALE = 5.0  # metres that are 1 to the network
NETWORK_EGO_FEATURES = 11  # without a route
NETWORK_OTHER_FEATURES = 10  # of a person or robot that is known
STATE_OTHER_FEATURES = 12  # of a person or robot in the true state

AGENT_SIZES = FeatureSizes(  # of scenarios without further sensors
    NETWORK_EGO_FEATURES,
    {"humans": NETWORK_OTHER_FEATURES, "robots": NETWORK_OTHER_FEATURES},
    {},
)

# Slices of the robot's own features, see `_ego_features`:
EGO_TARGET = slice(0, 5)  # see `features_of_target`
EGO_DIRECTION = slice(2, 4)  # of the goal, of length 1
EGO_VELOCITY = slice(5, 7)
EGO_PLACE = slice(7, 9)  # the map's origin
EGO_TIME = slice(9, 10)

# Slices of the features of a person or robot, see `_agent_features`:
POSITION = slice(0, 2)  # in the body frame, in units of LENGTH_SCALE
RADIUS = slice(4, 5)  # m
NEAR_NOW = 5  # exp(-2 gap), gap the distance between surfaces in m
NEAR_SOON = 8  # the same of the closest approach ahead, times exp(-0.5 t), t s away

WALL_NEAR = 6  # of a wall: exp(-2 gap), see `_wall_features`

# The features of further groups and sensors: from what is observed, [B, slots, F] or [B, ...], to
# what the networks get. Groups and sensors without an entry are passed on as observed.
Features = Callable[[Tensor, Scenario], Tensor]
ADDITIONAL_FEATURES: dict[str, Features] = {}


def state_sizes(sizes: FeatureSizes, waypoint_size: int = 0) -> FeatureSizes:
    """Return the sizes of the true state of a policy whose frames have `sizes`."""
    agents = {"humans": STATE_OTHER_FEATURES, "robots": STATE_OTHER_FEATURES + waypoint_size}
    return replace(sizes, entities=sizes.entities | agents)


def register_features(name: str) -> Callable[[Features], Features]:
    """Return a decorator that registers the features of a group of entities or a sensor.

    The function takes what is observed, [B, slots, F] of a group or [B, ...] of a sensor, and the
    scenario; it returns the features with the same leading shape.
    """

    def register(function: Features) -> Features:
        ADDITIONAL_FEATURES[name] = function
        return function

    return register


def frames_of(tracks: Observation, scenario: Scenario, observe_map_position: bool = True) -> Frames:
    """Return what the robots know as the input of the actors' encoder, [B, 1, ...].

    Args:
        tracks: [E, N, ...]; also as tensors, so that these features are part of an exported policy.
        scenario: the task.
        observe_map_position: whether the robots observe where the origin of the map is. A policy
            for any place must not: it would learn what is there.
    """
    ego = _ego_features(tracks, scenario)
    if not observe_map_position:
        ego[..., EGO_PLACE] = 0.0
    return _frames(ego, tracks, AGE, scenario)


def state_of(world: World) -> Frames:
    """Return the true state as seen from every robot, the input of the critics' encoder.

    Everybody is known, with the goal, and robots with whether they have arrived.
    """
    return state_features(true_state(world), world.scenario)


def true_state(world: World, waypoints: NDArray[np.float32] | None = None) -> Observation:
    """Return the true state as seen from every robot: `state_of` before it is scaled.

    Features of people and robots end with the goal in the body frame (units of `LENGTH_SCALE`) and
    whether they have arrived; those of robots with their waypoints.

    `waypoints` [E, N, N - 1, W] are features of those of the other robots; None: no macro level.
    """
    state, n = world.state, world.scenario.robots
    observation = world.observe(privileged=True)
    others = team_mates(n)
    human_goals = np.repeat(state.human_goal[:, None], n, 1)  # [E, N, M, 2]
    goals_and_arrivals = {
        "humans": (human_goals, np.zeros(human_goals.shape[:3], np.bool_)),
        "robots": (state.robot_goal[:, others], state.arrived[:, others]),
    }
    entities = dict(observation.entities)
    for name, (goals, arrived) in goals_and_arrivals.items():
        features, mask = observation.entities[name]
        goal = to_body(goals, observation.ego[:, :, None]) / np.float32(LENGTH_SCALE)
        extended = [features, goal, arrived[..., None]]
        if name == "robots" and waypoints is not None:
            extended.append(waypoints)
        entities[name] = Entities(np.concatenate(extended, -1, dtype=np.float32), mask)
    return Observation(observation.ego, entities, observation.sensors)


def team_mates(robots: int) -> NDArray[np.int64]:
    """Return the indices of the other robots of every robot, [N, N - 1]."""
    others = [[k for k in range(robots) if k != i] for i in range(robots)]
    return np.array(others, np.int64).reshape(robots, robots - 1)


def state_features(state: Observation, scenario: Scenario) -> Frames:
    """Return the features [B, 1, ...] of a `true_state`."""
    return _frames(_ego_features(state, scenario), state, OTHER_RADIUS + 1, scenario)


def _frames(ego: Tensor, tracks: Observation, extra: int, scenario: Scenario) -> Frames:
    """Return the features of all groups and sensors.

    Args:
        ego: [B, 1, F_e].
        tracks: [E, N, ...].
        extra: index of the first feature of people and robots that is passed on as it is. Robots
            may have more features than people: those of their waypoints.
        scenario: the task.
    """
    agents = {name: tracks.entities[name] for name in ("humans", "robots")}
    entities = {}
    for name, (features, known) in tracks.entities.items():
        if name not in agents:
            entities[name] = _additional_group(name, features, known, scenario)
    # People and robots in one pass: each operation of torch costs more than its arithmetic.
    common = agents["humans"].features.shape[-1]
    observed = torch.cat(
        [torch.as_tensor(features)[..., :common] for features, _ in agents.values()], -2
    )
    mask = torch.cat([torch.as_tensor(mask) for _, mask in agents.values()], -1)
    both = _agent_features(observed.flatten(0, 1), mask.flatten(0, 1), extra, scenario)
    slots = [mask.shape[-1] for _, mask in agents.values()]
    parts = zip(agents, both.features.split(slots, 2), both.mask.split(slots, 2), strict=True)
    split = {name: Entities(features, mask) for name, features, mask in parts}
    waypoints = torch.as_tensor(agents["robots"].features)[..., common:]
    if waypoints.shape[-1]:
        robots = split["robots"]
        waypoints = waypoints.flatten(0, 1).unsqueeze(1) * robots.mask.unsqueeze(-1)
        split["robots"] = Entities(torch.cat([robots.features, waypoints], -1), robots.mask)
    ordered = {name: (split | entities)[name] for name in tracks.entities}
    return Observation(ego, ordered, _additional_sensors(tracks.sensors, scenario))


def empty_tracks(scenario: Scenario, worlds: int = 1) -> Observation:
    """Return tracks in which nothing is known, in the shapes of a scenario."""
    empty = SensorSuite(scenario).empty(worlds)
    entities = {}
    for name, (features, mask) in empty.entities.items():
        size = len(TRACK_FEATURES) if name in ("humans", "robots") else features.shape[-1]
        entities[name] = Entities(np.zeros((*mask.shape, size), np.float32), np.zeros_like(mask))
    sensors = {name: np.zeros_like(values) for name, values in empty.sensors.items()}
    return Observation(np.zeros_like(empty.ego), entities, sensors)


def empty_frames(scenario: Scenario, rows: int = 1) -> Frames:
    """Return frames [B, 1, ...] in which nothing is known, in the shapes of a scenario."""
    example = frames_of(empty_tracks(scenario), scenario)
    return example.apply(lambda tensor: tensor.new_zeros(rows, *tensor.shape[1:]))


def speed_of(ego: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the speeds of robots from their own states [..., 11], m/s."""
    speed: NDArray[np.float32] = np.linalg.norm(ego[..., VELOCITY], axis=-1)
    return speed


def to_world(point: A, ego: A) -> A:
    """Transform points [..., 2] from the body frames of robots `ego` to the world frame."""
    cos, sin = ego[..., HEADING_COS], ego[..., HEADING_SIN]
    dx, dy = point[..., 0] - ego[..., ORIGIN_X], point[..., 1] - ego[..., ORIGIN_Y]
    return _stacked(*rotate(cos, sin, dx, dy))


def to_body(point: A, ego: A) -> A:
    """Transform points [..., 2] from the world frame to the body frames of robots `ego`."""
    cos, sin = ego[..., HEADING_COS], ego[..., HEADING_SIN]
    x, y = rotate(cos, sin, ego[..., ORIGIN_X], ego[..., ORIGIN_Y])
    return _stacked(*untransform(cos, sin, -x, -y, point[..., 0], point[..., 1]))


def _stacked(x: A, y: A) -> A:
    if isinstance(x, Tensor):
        return torch.stack([x, y], -1)
    return np.stack([x, y], -1)


def _ego_features(tracks: Observation, scenario: Scenario) -> Tensor:
    """Return the robots' own features [B, 1, F_e]."""
    ego = torch.as_tensor(tracks.ego).flatten(0, 1)
    goal, velocity, origin = ego[:, GOAL], ego[:, VELOCITY], ego[:, ORIGIN]
    view = ego.new_full((len(ego), 1), math.cos(math.radians(scenario.fov_degrees / 2)))
    parts = [
        features_of_target(goal),
        velocity,
        origin / LENGTH_SCALE,
        ego[:, TIME : TIME + 1],
        view,
    ]
    if "route" in tracks.sensors:
        parts.append(features_of_target(torch.as_tensor(tracks.sensors["route"]).flatten(0, 1)))
    if "priority" in tracks.sensors:
        parts.append(torch.as_tensor(tracks.sensors["priority"]).flatten(0, 1))
    return torch.cat(parts, -1).unsqueeze(1)


def features_of_target(target: Tensor) -> Tensor:
    """Return the features [..., 5] of a place in the body frame [..., 2], m."""
    distance = vector_norm(target, dim=-1, keepdim=True)
    direction = target / distance.clamp_min(1e-3)
    return torch.cat([target / LENGTH_SCALE, direction, torch.exp(-distance)], -1)


def _agent_features(
    others: Tensor, known: Tensor, extra: int, scenario: Scenario
) -> Entities[Tensor]:
    """Return the features [B, 1, M, F] of people and robots [B, M, ...].

    They include the closest approach ahead: when and how near the two will pass if both keep their
    velocities. Features from index `extra` on are appended as they are.
    """
    position, velocity = others[..., OTHER_POSITION], others[..., OTHER_VELOCITY]
    radii = others[..., OTHER_RADIUS : OTHER_RADIUS + 1] + scenario.robot_radius
    gap = vector_norm(position, dim=-1, keepdim=True) - radii
    closing = -(position * velocity).sum(-1, keepdim=True)
    time = (closing / velocity.square().sum(-1, keepdim=True).clamp_min(1e-3)).clamp(0.0, 5.0)
    miss = vector_norm(position + time * velocity, dim=-1, keepdim=True) - radii
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
            others[..., extra:],
        ],
        -1,
    )
    return _masked(features, known)


def _additional_group(
    name: str, observed: NDArray[np.float32], known: NDArray[np.bool_], scenario: Scenario
) -> Entities[Tensor]:
    """Return the features of a further group of entities."""
    features = _registered_features(name, torch.as_tensor(observed).flatten(0, 1), scenario, 2)
    return _masked(features, torch.as_tensor(known).flatten(0, 1))


def _masked(features: Tensor, mask: Tensor) -> Entities[Tensor]:
    return Entities((features * mask.unsqueeze(-1)).unsqueeze(1), mask.unsqueeze(1))


def _additional_sensors(
    observed: Mapping[str, NDArray[np.float32]], scenario: Scenario
) -> dict[str, Tensor]:
    """Return the features [B, 1, ...] of further sensors."""
    sensors = {}
    for name, values in observed.items():
        if name in ("route", "priority"):  # parts of the robots' own features
            continue
        features = _registered_features(name, torch.as_tensor(values).flatten(0, 1), scenario, 1)
        sensors[name] = features.unsqueeze(1)
    return sensors


def _registered_features(name: str, observed: Tensor, scenario: Scenario, axes: int) -> Tensor:
    """Return the registered features of what is observed, [B, ...], or what is observed itself.

    Args:
        name: of the group or the sensor.
        observed: of all robots.
        scenario: the task.
        axes: number of leading axes that features share with what is observed.

    Raises:
        PluginError: the features have another leading shape, or one is not finite.
    """
    if name not in ADDITIONAL_FEATURES:
        return observed
    features = ADDITIONAL_FEATURES[name](observed, scenario)
    if torch.onnx.is_in_onnx_export():
        return features
    expected = (*observed.shape[:axes], *features.shape[axes:])
    check_shape(f"features {name}", tuple(features.shape), expected)
    if features.isfinite().all():
        return features
    row, *index = (~features.isfinite()).nonzero()[0].tolist()
    world, robot = divmod(row, scenario.robots)
    raise PluginError(
        f"features {name} are {float(features[(row, *index)])} for robot {robot} in world {world} "
        f"at index {index}; they must be finite"
    )


@register_features("walls")
def _wall_features(segments: Tensor, scenario: Scenario) -> Tensor:
    """Return the features [B, K, 7] of wall segments [B, K, 4].

    These are both ends and the nearest point, in units of `LENGTH_SCALE`, and exp(-2 gap).
    """
    start, along = segments[..., :2], segments[..., 2:] - segments[..., :2]
    squared_length = along.square().sum(-1, keepdim=True).clamp_min(1e-6)
    nearest = start + ((-start * along).sum(-1, keepdim=True) / squared_length).clamp(0, 1) * along
    gap = (vector_norm(nearest, dim=-1, keepdim=True) - scenario.robot_radius).clamp_min(0.0)
    return torch.cat([segments / LENGTH_SCALE, nearest / LENGTH_SCALE, torch.exp(-2.0 * gap)], -1)


@register_features("lidar")
def _lidar_features(ranges: Tensor, scenario: Scenario) -> Tensor:
    """Return the features [B, L] of ranges [B, L]: exp(-gap / 2), so that near walls stand out."""
    return torch.exp(-0.5 * (ranges - scenario.robot_radius).clamp_min(0.0))


@register_features("messages")
def _message_features(messages: Tensor, scenario: Scenario) -> Tensor:
    """Return the features [B, N - 1, 6] of messages [B, N - 1, 7]; macro actions are left out.

    They are the numbers of the agent that tells them, and mean nothing to another one.
    """
    position, rest = messages[..., OTHER_POSITION], messages[..., 2:MACRO_ACTION]
    return torch.cat([position / LENGTH_SCALE, rest], -1)


@register_features("passages")
def _passage_features(passages: Tensor, scenario: Scenario) -> Tensor:
    """Return the features [B, K, 12] of passages [B, K, 11].

    Lengths are in units of `LENGTH_SCALE`; exp(-distance / 2) stands out before the mouth.
    """
    mouth, axis, lengths, rest = passages.split((2, 2, 3, 4), -1)
    near = torch.exp(-0.5 * lengths[..., :1])
    return torch.cat([mouth / LENGTH_SCALE, axis, lengths / LENGTH_SCALE, rest, near], -1)
