"""SAMARL's two levels: a macro actor that picks waypoints, a local actor that drives to them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Independent, Normal

from mrsan import ConfigurationError, Scenario
from mrsan.scenario import required
from samarl.agents.planners.perimeter import way_round
from samarl.encoders import ENCODERS, Encoder, Frames
from samarl.observations.features import (
    NETWORK_EGO_FEATURES,
    NETWORK_OTHER_FEATURES,
    to_body,
    to_world,
)
from samarl.policies.central import CentralEncoder, Critic
from samarl.policies.per_robot import PerRobotEncoder, PerRobotGaussian

WAYPOINT_REACHED = 0.3  # m
WAYPOINT_FEATURES = 3


@dataclass
class Architecture:
    """Sizes of the networks and of the macro level."""

    actors: int = required(1, 16)  # sets of their parameters: 1 for all robots, or one for each
    width: int = required(8, 1024)  # of the encoder, D
    heads: int = required(1, 64)
    history: int = required(1, 64)  # frames, H
    features: int = required(8, 4096)  # length of Y
    hidden: int = required(8, 4096)  # of the heads of actors and critics
    levels: int = required(1, 2)  # 1: a flat agent, without the macro level
    macro_steps: int = required(1, 200)  # a waypoint is kept for so many steps, K
    round_below: float = required(0.0, 360.0)  # a narrower view goes round the crowd, degrees ...
    round_radius: float = required(0.1, 1000.0)  # ... on a circle about the origin, m
    waypoint_ahead: float = required(0.0, 100.0)  # where it is unmoved: so far along the route, m
    waypoint_range: float = required(0.1, 100.0)  # how far the macro level may move it, m
    track_steps: int = required(0, 1000)  # for how long those out of view are remembered
    encoder: str = "spatio_temporal"  # a name in ENCODERS


class Gaussian(nn.Module):
    """A diagonal Gaussian whose standard deviation is a parameter of its own."""

    def __init__(self, inputs: int, hidden: int, mean: list[float], deviation: list[float]) -> None:
        super().__init__()
        size = len(mean)
        last = nn.Linear(hidden, size)
        self.body = nn.Sequential(nn.Linear(inputs, hidden), nn.Tanh(), last)
        self.log_deviation = nn.Parameter(torch.tensor(deviation).log())
        nn.init.orthogonal_(last.weight, gain=0.01)
        with torch.no_grad():
            last.bias.copy_(torch.tensor(mean))

    def forward(self, inputs: Tensor, robot: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation, [..., A]; it is the same for every robot."""
        mean = self.body(inputs)
        return mean, self.log_deviation.exp().expand_as(mean)

    @torch.no_grad()
    def cap_deviation(self, largest: float) -> None:
        """Bring the standard deviation down to `largest` where it is above."""
        self.log_deviation.clamp_(max=math.log(largest))

    def distribution(self, inputs: Tensor, robot: Tensor) -> Independent:
        """The distribution of the action, of inputs [..., F] of robots [...]."""
        return Independent(Normal(*self(inputs, robot)), 1)


class HierarchicalPolicy(nn.Module):
    """All networks of SAMARL: actors on one encoder, critics on another (Algorithm 1).

    The actors are given what the robot knows; the critics, which are needed in training alone, the
    true state.
    """

    def __init__(self, architecture: Architecture, action_size: int) -> None:
        super().__init__()
        a = architecture
        self.architecture = architecture
        self.action_size = action_size
        if a.encoder not in ENCODERS:
            raise ConfigurationError(
                f"architecture.encoder is {a.encoder!r}; it must be among {', '.join(ENCODERS)} "
                "(one's own becomes known by plugins=[its_module])"
            )
        sizes = (NETWORK_EGO_FEATURES, NETWORK_OTHER_FEATURES, a.width, a.heads)
        means, deviations = [0.3, 0.0, 0.0], [0.37, 0.1, 0.5]  # it sets out moving forward

        def encoder() -> Encoder:
            return ENCODERS[a.encoder](*sizes, a.history, a.features)

        def macro_actor() -> Gaussian:
            return Gaussian(a.features, a.hidden, [0.0, 0.0], [0.5, 0.5])

        def local_actor() -> Gaussian:
            inputs, n = a.features + WAYPOINT_FEATURES, action_size
            return Gaussian(inputs, a.hidden, means[:n], deviations[:n])

        if a.actors == 1:
            self.encoder: Encoder | PerRobotEncoder = encoder()
        else:
            self.encoder = PerRobotEncoder(encoder, a.actors)
        self.critic_encoder = CentralEncoder(a.width, a.heads, a.features)
        self.macro_actor, self.local_actor = (
            make() if a.actors == 1 else PerRobotGaussian(make, a.actors)
            for make in (macro_actor, local_actor)
        )
        self.low_precision = False  # encode with bfloat16 where that is safe
        self.macro_critic = Critic(a.features, a.hidden)
        self.local_critic = Critic(a.features + WAYPOINT_FEATURES, a.hidden)

    @property
    def device(self) -> torch.device:
        """Where the networks are."""
        return next(self.parameters()).device

    def encode(self, frames: Frames, begins: Tensor) -> Tensor:
        """Features [B, T - H + 1, F] of the actors, on the device of the networks.

        Args:
            frames: [B, T, ...] on any device.
            begins: [B, T].
        """
        device = self.device
        with self._precision():
            return self.encoder(frames.to(device), begins.to(device)).float()

    def encode_state(self, state: Frames) -> Tensor:
        """Features [B, T, F] of the critics from `state_of`, on the device of the networks."""
        with self._precision():
            return self.critic_encoder(state.to(self.device)).float()

    def _precision(self) -> torch.autocast:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.low_precision)

    def check(self, scenario: Scenario) -> None:
        """Refuse a scenario whose robots it cannot drive.

        Raises:
            ConfigurationError: their kinematics or their number is another.
        """
        if self.action_size != scenario.action_size:
            raise ConfigurationError(
                f"scenario.kinematics is {scenario.kinematics.name} with {scenario.action_size} "
                f"numbers per action; this policy has {self.action_size}"
            )
        actors = self.architecture.actors
        if actors not in (1, scenario.robots):
            raise ConfigurationError(
                f"scenario.robots is {scenario.robots}; it must be {actors} for a policy with "
                "parameters of their own for so many robots"
            )


class Waypoints:
    """The waypoint each robot is driving to, kept in the world frame."""

    def __init__(self, worlds: int, scenario: Scenario, architecture: Architecture) -> None:
        """Waypoints of all robots of `worlds` worlds, renewed after K steps."""
        self.position = np.zeros((worlds, scenario.robots, 2), np.float32)
        self.clock = np.zeros((worlds, scenario.robots), np.int32)
        self.architecture = architecture
        self.round = scenario.fov_degrees < architecture.round_below

    def due(self, ego: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Which robots need a new waypoint, [E, N]; of a flat agent none ever does."""
        if self.architecture.levels == 1:
            return np.zeros(ego.shape[:2], np.bool_)
        distance = np.linalg.norm(self.seen_from(ego), axis=-1)
        return (self.clock <= 0) | (distance < WAYPOINT_REACHED)

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Ask for new waypoints in the worlds [E] in which an episode begins."""
        self.clock[worlds] = 0

    def set(
        self, ego: NDArray[np.float32], due: NDArray[np.bool_], macro: NDArray[np.float32]
    ) -> None:
        """Take up macro actions [E, N, 2] where they are due.

        The waypoint is a point on the route, as far ahead as `waypoint_ahead`, moved by the macro
        action in [-1, 1] times `waypoint_range`: zero means "along the route".
        """
        a, aim = self.architecture, self.aim(ego)
        distance = np.maximum(np.linalg.norm(aim, axis=-1, keepdims=True), np.float32(1e-6))
        ahead = aim * np.minimum(np.float32(a.waypoint_ahead) / distance, 1)
        target = ahead + np.float32(a.waypoint_range) * np.clip(macro, -1, 1)
        self.position[due] = to_world(target, ego)[due]
        self.clock[due] = a.macro_steps

    def aim(self, ego: NDArray[np.float32]) -> NDArray[np.float32]:
        """Where the route leads next in the body frames, [E, N, 2] in m.

        Straight to the goal, or with a narrow view counter-clockwise round the crowd.
        """
        if self.round:
            return way_round(ego, self.architecture.round_radius, 0.3, 0.15)
        return ego[..., 0:2]

    def tick(self) -> None:
        """One step has passed."""
        self.clock -= 1

    def seen_from(self, ego: NDArray[np.float32]) -> NDArray[np.float32]:
        """The waypoints in the body frames, [E, N, 2] in m."""
        return to_body(self.position, ego)

    def features(self, ego: NDArray[np.float32]) -> Tensor:
        """What the local level is told of its waypoint, [E, N, 3]; in a flat agent nothing."""
        if self.architecture.levels == 1:
            return torch.zeros(*ego.shape[:2], WAYPOINT_FEATURES)
        seen = torch.from_numpy(self.seen_from(ego))
        return torch.cat([seen / 2.0, torch.exp(-seen.norm(dim=-1, keepdim=True))], -1)


class Decision(NamedTuple):
    """What both levels decided, for all robots; on the CPU."""

    macro: Tensor  # [E, N, 2], meaningful where due
    macro_log_prob: Tensor  # [E, N]
    due: NDArray[np.bool_]  # [E, N]
    waypoint: Tensor  # [E, N, 3] features
    action: Tensor  # [E, N, A] before clipping to [-1, 1]
    action_log_prob: Tensor  # [E, N]


def decide(
    policy: HierarchicalPolicy,
    y: Tensor,
    ego: NDArray[np.float32],
    waypoints: Waypoints,
    noise: Tensor | None = None,
) -> Decision:
    """Let the macro level choose waypoints where they are due and the local level act.

    Args:
        policy: the networks.
        y: [E, N, F] features of the actors' encoder.
        ego: [E, N, 11] own states.
        waypoints: updated in place.
        noise: [E, N, A] of unit variance, with which the local level explores; None: both levels
            take their means.
    """
    due = waypoints.due(ego)
    robot = torch.arange(y.shape[1], device=y.device).expand(y.shape[:2])
    macro_distribution = policy.macro_actor.distribution(y, robot)
    macro = macro_distribution.mean if noise is None else macro_distribution.sample()
    waypoints.set(ego, due, macro.cpu().numpy())
    told = waypoints.features(ego).to(y.device)
    distribution = policy.local_actor.distribution(torch.cat([y, told], -1), robot)
    action = distribution.mean
    if noise is not None:
        action = action + distribution.stddev * noise.to(y.device)
    waypoints.tick()
    return Decision(
        macro.cpu(),
        macro_distribution.log_prob(macro).cpu(),
        due,
        told.cpu(),
        action.cpu(),
        distribution.log_prob(action).cpu(),
    )
