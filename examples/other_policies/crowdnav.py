"""CrowdNav's SARL and CADRL: one step of lookahead with a learned value.

Sources: Chen et al., Crowd-robot interaction (2019), whose code and configuration are
github.com/vita-epfl/CrowdNav; CADRL is Chen et al., Decentralized non-communicating multiagent
collision avoidance with deep reinforcement learning (2017), as that repository trains it.
"""

from __future__ import annotations

import hashlib
import io
import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mrsan import ConfigurationError, Kinematics, Observation
from mrsan.features import GOAL, OTHER_POSITION, OTHER_RADIUS, OTHER_VELOCITY, RADIUS, VELOCITY
from mrsan.fields import setting
from mrsan.parameters import kernel_parameters
from mrsan.se2 import unrotate
from samarl.agents import Agent
from samarl.planning.velocity_control import retarget_actions
from samarl.registry import needed

# The robots and the clock of the training.
TIME_STEP = 0.25  # s
PREFERRED_SPEED = 1.0  # m/s
ROBOT_RADIUS = 0.3  # m

OWN_FEATURES = 6
JOINT_FEATURES = 13
DISCOUNT = 0.9
SUCCESS, COLLISION = 1.0, -0.25
DISCOMFORT_DISTANCE, DISCOMFORT_FACTOR = 0.2, 0.5  # m, 1/(m s)
SPEEDS = 5
HOLONOMIC_DIRECTIONS = 16
UNICYCLE_TURNS = 16  # from -45 to 45 degrees
CHUNK_SIZE = 16  # robots that are evaluated together


class Others(NamedTuple):
    """The people and robots around B robots, in the body frames; one slot each for an episode."""

    position: Tensor  # [B, S, 2] relative to the robot, m
    velocity: Tensor  # [B, S, 2] over ground, m/s
    radius: Tensor  # [B, S], m
    visible: Tensor  # [B, S] bool: perceived; the other values are arbitrary where it is False


def others_of(observation: Observation) -> Others:
    """Return everybody a robot perceives; other robots count as people."""
    features = np.concatenate([observation.humans, observation.robots], 2)
    visible = np.concatenate([observation.humans_visible, observation.robots_visible], 2)
    features[..., OTHER_VELOCITY] += observation.ego[..., None, VELOCITY]
    rows = torch.from_numpy(features).flatten(0, 1)
    return Others(
        rows[..., OTHER_POSITION],
        rows[..., OTHER_VELOCITY],
        rows[..., OTHER_RADIUS],
        torch.from_numpy(visible).flatten(0, 1),
    )


def joint_state(
    goal: Tensor,
    velocity: Tensor,
    heading: Tensor | None,
    radius: Tensor,
    preferred_speed: float,
    others: Others,
) -> Tensor:
    """Return the input of the networks, [..., S, 13]: x points to the goal in its axes.

    The features are the distance to the goal, preferred speed, heading, radius and velocity of the
    robot; the position, velocity and radius of the other; their distance; and the sum of the radii.

    Args:
        goal: [..., 2] position of the goal relative to the robot, in any axes.
        velocity: [..., 2] velocity of the robot in the same axes.
        heading: [...] heading of a unicycle in the same axes, rad; None for a holonomic robot.
        radius: [...] of the robot.
        preferred_speed: of the robot, m/s.
        others: [..., S] everybody around, in the same axes.
    """
    angle = torch.atan2(goal[..., 1], goal[..., 0])
    cos, sin = torch.cos(angle), torch.sin(angle)
    theta = torch.zeros_like(angle)
    if heading is not None:
        theta = torch.remainder(heading - angle + math.pi, 2 * math.pi) - math.pi
    own = [goal.norm(dim=-1), torch.full_like(angle, preferred_speed), theta, radius]
    own += unrotate(cos, sin, velocity[..., 0], velocity[..., 1])
    cos, sin = cos.unsqueeze(-1), sin.unsqueeze(-1)
    features = [value.unsqueeze(-1).expand_as(others.radius) for value in own]
    features += unrotate(cos, sin, others.position[..., 0], others.position[..., 1])
    features += unrotate(cos, sin, others.velocity[..., 0], others.velocity[..., 1])
    features += [others.radius, others.position.norm(dim=-1), others.radius + radius.unsqueeze(-1)]
    return torch.stack(features, -1)


def step_reward(
    goal_after: Tensor, radius: Tensor, before: Others, position_after: Tensor
) -> Tensor:
    """Return CrowdNav's reward of one step, [...].

    Args:
        goal_after: [..., 2] position of the goal relative to the robot after the step, m.
        radius: [...] of the robot.
        before: [..., S] everybody around before the step.
        position_after: [..., S, 2] their relative positions after the step, m.
    """
    motion = position_after - before.position
    closing = -(before.position * motion).sum(-1)
    share = (closing / motion.square().sum(-1).clamp_min(1e-12)).clamp(0.0, 1.0)
    closest = (before.position + share.unsqueeze(-1) * motion).norm(dim=-1)
    gap = closest - before.radius - radius.unsqueeze(-1)
    gap = gap.masked_fill(~before.visible, torch.inf).amin(-1)
    discomfort = (gap - DISCOMFORT_DISTANCE).clamp_max(0.0) * DISCOMFORT_FACTOR * TIME_STEP
    reward = torch.where(goal_after.norm(dim=-1) < radius, SUCCESS, discomfort)
    return torch.where(gap < 0.0, COLLISION, reward)


@dataclass
class ValueLookahead(Agent):
    """Chooses the velocity with the largest reward plus discounted value after one step.

    Everybody else is predicted to keep the velocity: CrowdNav asks its simulator for the true next
    state, which no robot knows. With nobody in view it drives straight to the goal. Robots track
    the velocity within their limits, whatever their kinematics.
    """

    file: str = needed(help="file of weights that CrowdNav wrote")
    unicycle: bool = setting(False, help="trained with kinematics = unicycle in policy.config")

    def __post_init__(self) -> None:
        """Load the weights.

        Raises:
            ConfigurationError: the file cannot be read or holds the weights of another network.
        """
        super().__post_init__()
        self.network = self.make_network()
        self._digest = load_weights(self.network, self.file)
        source = replace(self.scenario, kinematics=Kinematics.holonomic)
        self._parameters = kernel_parameters(source), kernel_parameters(self.scenario)

    @abstractmethod
    def make_network(self) -> nn.Module:
        """Return the network, whose entries have the names and shapes of the published file."""

    @torch.no_grad()
    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Return the actions that track the desired velocities, [E, N, A]."""
        share = self.velocity(observation).numpy() / np.float32(self.scenario.robot_speed)
        share = share.reshape(*observation.ego.shape[:2], 2)
        return retarget_actions(observation.ego, share, *self._parameters)

    def version(self) -> str:
        """Return a digest of the code and of the weights."""
        return f"{super().version()}.{self._digest}"

    def scope_warning(self) -> str | None:
        """Return one line about how the scenario differs from those of the training, or None."""
        trained = {
            "time_step": TIME_STEP,
            "robot_speed": PREFERRED_SPEED,
            "robot_radius": ROBOT_RADIUS,
            "fov_degrees": 360.0,
        }
        actual = {name: getattr(self.scenario, name) for name in trained}
        differences = [
            f"scenario.{name} is {actual[name]:g} instead of {value:g}"
            for name, value in trained.items()
            if actual[name] != value
        ]
        if not differences:
            return None
        return f"{self.file} was trained in CrowdNav, but {' and '.join(differences)}"

    def velocity(self, observation: Observation) -> Tensor:
        """Return the desired velocity of every robot in its body frame, [E * N, 2] in m/s."""
        ego, others = torch.from_numpy(observation.ego).flatten(0, 1), others_of(observation)
        goal = ego[:, GOAL]
        velocity = goal / goal.norm(dim=-1, keepdim=True).clamp_min(1e-6) * self.preferred_speed
        rows = torch.arange(len(ego))[others.visible.any(-1)]
        for start in range(0, len(rows), CHUNK_SIZE):
            chunk = rows[start : start + CHUNK_SIZE]
            around = Others(*(values[chunk] for values in others))
            candidates, value = self.candidates(goal[chunk], ego[chunk, RADIUS], around)
            velocity[chunk] = candidates[torch.arange(len(chunk)), value.argmax(-1)]
        return velocity

    @property
    def preferred_speed(self) -> float:
        """Return the speed of the fastest candidates, m/s."""
        return min(PREFERRED_SPEED, self.scenario.robot_speed)

    def candidates(self, goal: Tensor, radius: Tensor, others: Others) -> tuple[Tensor, Tensor]:
        """Return all C velocities in the body frames, [B, C, 2] in m/s, and their values, [B, C].

        The directions of holonomic robots are relative to that of the goal.

        Args:
            goal: [B, 2] relative positions of the goals, m.
            radius: [B] of the robots.
            others: [B, S] everybody around, of whom at least one is visible.
        """
        speed, turn = self._commands()
        heading = None if self.unicycle else torch.atan2(goal[:, 1], goal[:, 0])
        direction = turn.expand(len(goal), -1) + (0.0 if heading is None else heading[:, None])
        velocity = speed[:, None] * torch.stack([torch.cos(direction), torch.sin(direction)], -1)
        radius = radius[:, None].expand_as(direction)
        before = Others(*(values.unsqueeze(1) for values in others))
        moved = velocity * TIME_STEP
        goal_after = goal[:, None] - moved
        position_after = before.position + before.velocity * TIME_STEP - moved.unsqueeze(2)
        shape = position_after.shape[:-1]
        after = Others(
            position_after,
            before.velocity.expand_as(position_after),
            before.radius.expand(shape),
            before.visible.expand(shape),
        )
        state = joint_state(
            goal_after,
            velocity,
            direction if self.unicycle else None,
            radius,
            self.preferred_speed,
            after,
        )
        reward = step_reward(goal_after, radius, before, position_after)
        discount = DISCOUNT ** (TIME_STEP * self.preferred_speed)
        return velocity, reward + discount * self.network(state, after.visible)

    def _commands(self) -> tuple[Tensor, Tensor]:
        """Return the speeds (m/s) and turns (rad) of all commands, [C] each; the first is to stop.

        Speeds are spaced exponentially.
        """
        speed = (torch.arange(1, SPEEDS + 1) / SPEEDS).expm1() / math.expm1(1.0)
        if self.unicycle:
            turn = torch.linspace(-math.pi / 4, math.pi / 4, UNICYCLE_TURNS)
        else:
            turn = torch.arange(HOLONOMIC_DIRECTIONS) * (2 * math.pi / HOLONOMIC_DIRECTIONS)
        pairs = torch.cartesian_prod(turn, speed * self.preferred_speed)
        turn, speed = torch.cat([torch.zeros(1, 2), pairs]).unbind(-1)
        return speed, turn


def mlp(*sizes: int) -> nn.Sequential:
    """Return linear layers with ReLU between them."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers[:-1])


class SARLNetwork(nn.Module):
    """Value of a robot among people, who are pooled with attention."""

    def __init__(self) -> None:
        super().__init__()
        self.mlp1 = nn.Sequential(*mlp(JOINT_FEATURES, 150, 100), nn.ReLU())
        self.mlp2 = mlp(100, 100, 50)
        self.attention = mlp(2 * 100, 100, 100, 1)
        self.mlp3 = mlp(OWN_FEATURES + 50, 150, 100, 100, 1)

    def forward(self, state: Tensor, visible: Tensor) -> Tensor:
        """Return values [...] of joint states [..., S, 13], of which some are visible [..., S]."""
        embedded = self.mlp1(state)
        seen = visible.unsqueeze(-1)
        mean = (embedded * seen).sum(-2, keepdim=True) / seen.sum(-2, keepdim=True)
        score = self.attention(torch.cat([embedded, mean.expand_as(embedded)], -1)).squeeze(-1)
        weight = score.masked_fill(~visible, -torch.inf).softmax(-1).unsqueeze(-1)
        crowd = (weight * self.mlp2(embedded)).sum(-2)
        return self.mlp3(torch.cat([state[..., 0, :OWN_FEATURES], crowd], -1)).squeeze(-1)


class CADRLNetwork(nn.Module):
    """Value of a robot near one person; among several, the smallest counts."""

    def __init__(self) -> None:
        super().__init__()
        self.value_network = mlp(JOINT_FEATURES, 150, 100, 100, 1)

    def forward(self, state: Tensor, visible: Tensor) -> Tensor:
        """Return values [...] of joint states [..., S, 13], of which some are visible [..., S]."""
        value = self.value_network(state).squeeze(-1)
        return value.masked_fill(~visible, torch.inf).amin(-1)


@dataclass
class SARL(ValueLookahead):
    """SARL without an occupancy map."""

    def make_network(self) -> nn.Module:
        """Return SARL's value network."""
        return SARLNetwork()


@dataclass
class CADRL(ValueLookahead):
    """CADRL as CrowdNav trains it."""

    def make_network(self) -> nn.Module:
        """Return CADRL's value network."""
        return CADRLNetwork()


def load_weights(network: nn.Module, file: str) -> str:
    """Load a file of PyTorch weights into a network and return the digest of the file.

    Loading never executes code from the file.

    Raises:
        ConfigurationError: the file cannot be read, or an entry is missing, unknown or of another
            shape.
    """
    try:
        content = Path(file).read_bytes()
        weights = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except OSError as error:
        raise ConfigurationError(
            f"agent.file is {file!r}; it must be a readable file ({error.strerror})"
        ) from None
    except Exception:  # torch.load raises errors of many types
        weights = None
    if not isinstance(weights, Mapping) or not all(map(torch.is_tensor, weights.values())):
        raise ConfigurationError(
            f"agent.file is {file!r}; it must be a state_dict saved by PyTorch"
        )
    expected = network.state_dict()
    for name in [*expected, *weights]:
        difference = None
        if name not in weights:
            difference = "is missing"
        elif name not in expected:
            difference = f"is not an entry of {type(network).__name__}"
        elif weights[name].shape != expected[name].shape:
            shapes = tuple(weights[name].shape), tuple(expected[name].shape)
            difference = "has the shape {}; it must be {}".format(*shapes)
        if difference:
            raise ConfigurationError(f"agent.file is {file!r}, in which {name} {difference}")
    network.load_state_dict(weights)
    return hashlib.sha256(content).hexdigest()[:16]
