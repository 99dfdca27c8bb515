"""Base classes of trainable policies.

`Policy` acts in simulation. `StochasticPolicy` has action distributions: its one function `step`
decides when experience is collected, when a policy is evaluated, and on a robot (`samarl.export`
traces it), and `evaluate` recomputes what `step` decided for whole sequences.

Shapes: E worlds, N robots, M humans, B = E N robots of all worlds (robot n of world e is row
e N + n), A numbers per action, P samples, each one step of one robot.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from mrsan import ConfigurationError, Entities, Observation, Scenario
from mrsan.fields import number, required, setting
from mrsan.sensors.team import MESSAGE_FEATURES
from mrsan.sensors.walls import WALL_FEATURES
from samarl.encoders import ENCODERS, Encoder
from samarl.encoders.encoder import samples_of
from samarl.observations.features import (
    AGENT_SIZES,
    NETWORK_EGO_FEATURES,
    empty_tracks,
    frames_of,
)
from samarl.observations.frames import FeatureSizes, Frames
from samarl.observations.route import heading_for_route, next_point
from samarl.observations.route import route as next_on_route
from samarl.observations.tracker import Tracker
from samarl.policies.explanation import Explanation
from samarl.registry import Registry, needed

POLICIES: Registry[Policy] = Registry("policy")

LOCAL = "local"  # the level that drives; every policy has it
MACRO = "macro"  # the level above it, which chooses waypoints
WAYPOINT_FEATURES = 3  # of a waypoint in the body frame, see `encode_waypoint`
PolicyState = dict[str, Any]  # nested dicts and tuples of tensors, [B, ...] each


@dataclass
class PolicyConfig:
    """What all policies share."""

    num_parameter_sets: int = required(
        1, 16, help="1: all robots share their parameters; N: each robot has its own"
    )
    hidden: int = required(8, 4096, help="width of the heads")
    track_time: float = required(
        0.0, 1000.0, unit="s", help="time for which agents out of view are remembered"
    )
    perimeter_below_fov: float = required(
        0.0,
        360.0,
        unit="degrees",
        help="robots with a narrower field of view drive round the crowd",
    )
    round_radius: float = required(
        0.1, 1000.0, unit="m", help="radius of the circle on which they do, about the origin"
    )
    encoder: dict[str, Any] = needed(help="name and settings of the encoder")
    observe_map_position: bool = setting(
        True, kw_only=True, help="the policy observes where the origin is"
    )
    stop_speed: float = number(
        0.0, 0.0, 10.0, unit="m/s", kw_only=True, help="robots that would be slower stop; 0: none"
    )


class LevelStep(NamedTuple):
    """What one level of a policy decided, for B robots or as [E, N, ...]."""

    action: Tensor  # [B, A] before it is bounded
    log_prob: Tensor  # [B] given the noise of the step before; 0 without exploration
    decided: Tensor  # [B] bool: the level chose an action in this step


class PolicyStep(NamedTuple):
    """What was decided for B robots in one step, or as [E, N, ...]."""

    action: Tensor  # [B, A] in [-1, 1], what is executed
    mean: Tensor  # [B, A] the local level's action without noise
    levels: dict[str, LevelStep]
    previous_noise: Tensor | None = None  # [B, A] of the local level, in standard deviations
    waypoint_features: Tensor | None = None  # [B, W]; None without a macro level
    scene: Any = None  # [B, ...] what the encoder made of the features, for explanations


class Decision(NamedTuple):
    """What was decided for all robots of E worlds, and from what."""

    step: PolicyStep  # [E, N, ...]
    tracks: Observation  # [E, N, ...]
    features: Frames  # [B, 1, ...] the network's view of the tracks, perhaps of active robots only
    scene: Any = None  # [B, ...]; None while exploring
    value: Tensor | None = None  # [E, N] expected discounted reward, of a policy that decides by it

    @property
    def action(self) -> NDArray[np.float32]:
        """The action of every robot, [E, N, A] in [-1, 1]."""
        return self.step.action.numpy()

    @property
    def levels(self) -> dict[str, LevelStep]:
        """What each level decided, [E, N, ...]."""
        return self.step.levels


class Networks(nn.Module):
    """One set of parameters: an encoder and a head for each level."""

    heads: Mapping[str, Any]

    def __init__(self, encoder: Encoder, heads: Mapping[str, nn.Module]) -> None:
        super().__init__()
        self.encoder = encoder
        self.heads = nn.ModuleDict(heads)  # type: ignore[assignment]


class Policy(nn.Module, ABC):
    """Drive all robots of E worlds, each from its own observations alone."""

    levels: tuple[str, ...] = (LOCAL,)
    networks: Sequence[Networks]
    config: PolicyConfig
    _device: Tensor

    def __init__(
        self, config: PolicyConfig, action_size: int, sizes: FeatureSizes | None = None
    ) -> None:
        """Create the networks.

        Args:
            config: an instance of the dataclass that the policy is registered with.
            action_size: A.
            sizes: the groups of entities and the sensors that it observes; None: people and robots.
        """
        super().__init__()
        self.config, self.action_size = config, action_size
        self.sizes = AGENT_SIZES if sizes is None else sizes
        encoder_config = ENCODERS.config(config.encoder)
        entry = ENCODERS[config.encoder["name"]]
        self.networks = nn.ModuleList(  # type: ignore[assignment]
            self._make_networks(entry.cls(encoder_config, self.sizes))
            for _ in range(config.num_parameter_sets)
        )
        # It moves with the networks; to find a parameter of theirs takes longer.
        self.register_buffer("_device", torch.empty(0), persistent=False)

    @abstractmethod
    def _make_networks(self, encoder: Encoder) -> Networks:
        """Return the encoder with the heads of all levels."""

    @abstractmethod
    def act(
        self,
        observation: Observation,
        state: PolicyState,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
        correlation: float | None = None,
        active: NDArray[np.bool_] | None = None,
    ) -> Decision:
        """Decide for all robots of E worlds.

        Args:
            observation: of E worlds.
            state: from `initial_state`, updated in place.
            is_init: [E] the worlds in which an episode begins; their memory is cleared.
            scenario: the task.
            correlation: of the exploration noise from step to step; None: take the means.
            active: [E, N] the robots whose actions matter; the others may get any, and without
                exploration the decision cannot be explained. None: all.
        """

    def initial_state(self, worlds: int, scenario: Scenario) -> PolicyState:
        """Return the memory of E worlds before their first step: the tracks of all robots.

        Raises:
            ConfigurationError: the policy cannot drive these robots.
        """
        self.check(scenario)
        tracker = Tracker(self.config.track_time, scenario.time_step)
        return {"tracks": tracker.initial(worlds, scenario.robots, scenario.humans)}

    @property
    def waypoint_size(self) -> int:
        """Return the number of features of a waypoint that the local level observes, W."""
        return WAYPOINT_FEATURES if MACRO in self.levels else 0

    def team_waypoints(
        self, state: PolicyState, ego: NDArray[np.float32]
    ) -> NDArray[np.float32] | None:
        """Return the features of the waypoints of every robot's team-mates, [E, N, N - 1, W].

        They are in the body frames of `ego` [E, N, 11], after a decision.

        Returns:
            None without a macro level.
        """
        return None

    @property
    def device(self) -> torch.device:
        """Where the networks are."""
        return self._device.device

    @property
    def history(self) -> int:
        """Number of frames that the encoder needs before the first, h."""
        return int(self.networks[0].encoder.history)

    @torch.no_grad()
    def explain(self, decision: Decision) -> Explanation | None:
        """Return the robots' attention in a decision without exploration; None if there is none."""
        rows = torch.arange(len(decision.features.ego), device=self.device)
        ego = decision.features.ego[:, 0]

        def attention(net: Any, index: int, samples: Any) -> Any:
            return net.encoder.attention(samples_of(decision.scene, samples), ego[samples])

        if attention(self.networks[0], 0, slice(0, 1)) is None:
            return None
        robots, humans = (
            share.view(*decision.step.action.shape[:2], -1).float().cpu().numpy()
            for share in self._per_parameter_set(rows, attention)
        )
        return Explanation(None, humans, robots)

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario whose robots this policy cannot drive.

        Raises:
            ConfigurationError: their kinematics or their number differs.
        """
        if self.action_size != scenario.action_size:
            raise ConfigurationError(
                f"scenario.kinematics is {scenario.kinematics.name} with {scenario.action_size} "
                f"numbers per action; this policy has {self.action_size}"
            )
        sets = self.config.num_parameter_sets
        if sets not in (1, scenario.robots):
            raise ConfigurationError(
                f"scenario.robots is {scenario.robots}; it must be {sets}, as "
                "policy.num_parameter_sets: each robot has its own parameters"
            )
        available = FeatureSizes.of(frames_of(self.as_trained(empty_tracks(scenario)), scenario))
        for kind in ("entities", "sensors"):
            for name, size in getattr(self.sizes, kind).items():
                if getattr(available, kind).get(name) != size:
                    if name == "lidar":
                        raise ConfigurationError(
                            f"scenario.lidar_rays is {scenario.lidar_rays}; it must be {size[0]}, "
                            "as in the training of this policy"
                        )
                    if name == "passages":
                        raise ConfigurationError(
                            f"scenario.next_passages is {scenario.next_passages}; it must be at "
                            "least 1, as in the training of this policy"
                        )
                    raise ConfigurationError(
                        f"scenario.sensors is {scenario.sensors!r}; it must have {name} with "
                        f"{size} features, which this policy observes"
                    )

    def _track(
        self,
        observation: Observation,
        state: PolicyState,
        is_init: NDArray[np.bool_],
        scenario: Scenario,
    ) -> Observation:
        """Update the tracks of all robots, and return them."""
        tracker = Tracker(self.config.track_time, scenario.time_step)
        return tracker.update(observation, state["tracks"], is_init)

    @property
    def observes_route(self) -> bool:
        """Return whether the policy was trained with routes round walls."""
        return self.sizes.ego - self.observes_messages > NETWORK_EGO_FEATURES

    @property
    def observes_messages(self) -> bool:
        """Return whether the policy was trained with what team-mates tell, and a priority."""
        return "messages" in self.sizes.entities

    def extract_features(self, tracks: Observation, scenario: Scenario) -> Frames:
        """Return the features [B, 1, ...] of the groups and sensors that this policy observes."""
        tracks = self.as_trained(tracks)
        frames = self.sizes.select(frames_of(tracks, scenario, self.config.observe_map_position))
        device = self.device
        return frames.apply(lambda tensor: tensor.to(device, non_blocking=True))

    def as_trained(self, tracks: Observation) -> Observation:
        """Return the tracks with the parts that this policy was trained with.

        A policy that was trained without walls takes the next corner of its route for its goal. One
        that was trained with them sees none where there are none, and its route is its goal.
        Where robots tell each other nothing, one that was trained with messages gets none.
        """
        ego, entities, sensors = tracks.ego, dict(tracks.entities), dict(tracks.sensors)
        if "route" in sensors and not self.observes_route:
            ego = heading_for_route(tracks)
            del sensors["route"]
        elif "route" not in sensors and self.observes_route:
            sensors["route"] = next_point(tracks)
        shape = (*ego.shape[:2], 1)
        for name, features in (("walls", WALL_FEATURES), ("messages", MESSAGE_FEATURES)):
            if name in self.sizes.entities and name not in entities:
                nothing = np.zeros((*shape, len(features)), np.float32)
                entities[name] = Entities(nothing, np.zeros(shape, np.bool_))
        if self.observes_messages and "priority" not in sensors:
            sensors["priority"] = np.zeros(shape, np.float32)
        return tracks._replace(ego=ego, entities=entities, sensors=sensors)

    def empty_frames(self, scenario: Scenario, rows: int) -> Frames:
        """Return frames [B, 1, ...] like those of `extract_features` in which nothing is known."""
        example = self.extract_features(empty_tracks(scenario), scenario)
        return example.apply(lambda tensor: tensor.new_zeros(rows, *tensor.shape[1:]))

    def _per_parameter_set(self, rows: Tensor, call: Callable[[Any, int, Any], Any]) -> Any:
        """Call each set of parameters on its own robots and merge the results in order.

        Args:
            rows: [P] the row b of each sample; robot b % N belongs to the set b % sets.
            call: maps the networks of a set, the set's index and the indices of its samples to
                (nested) tensors, one row per sample.
        """
        sets = len(self.networks)
        if sets == 1:
            return call(self.networks[0], 0, slice(None))
        samples = [(rows % sets == i).nonzero().squeeze(1) for i in range(sets)]
        parts = [call(net, i, samples[i]) for i, net in enumerate(self.networks)]
        order = torch.cat(samples).argsort()
        return tree_map(lambda *tensors: torch.cat(tensors)[order], *parts)

    def route(self, tracks: Observation, scenario: Scenario) -> NDArray[np.float32]:
        """Return where the route of each robot leads next, [E, N, 2]; see `next_on_route`."""
        c = self.config
        fov, has_walls = scenario.fov_degrees, scenario.has_walls
        return next_on_route(tracks, fov, has_walls, c.perimeter_below_fov, c.round_radius)
