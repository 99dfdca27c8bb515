"""What all policies from other simulators share: their file, what they perceive, how they drive."""

from __future__ import annotations

import hashlib
import io
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from mrsan import ConfigurationError, Kinematics, Observation
from mrsan.features import OTHER_POSITION, OTHER_RADIUS, OTHER_VELOCITY, VELOCITY
from mrsan.parameters import kernel_parameters
from samarl.agents import Agent
from samarl.planning.velocity_control import retarget_actions
from samarl.registry import needed

# The robots and the clock of CrowdNav and of the simulators derived from it.
TIME_STEP = 0.25  # s
PREFERRED_SPEED = 1.0  # m/s
RADIUS = 0.3  # m


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


@dataclass
class TransferPolicy(Agent):
    """Base class of policies that were trained in another simulator.

    A subclass sets `trained_in` and implements `make_network` and `velocity`. The robots track the
    velocity within their limits, whatever their kinematics.
    """

    file: str = needed(help="file of the published weights")

    trained_in = ""

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

    @abstractmethod
    def velocity(self, observation: Observation) -> Tensor:
        """Return the desired velocity of every robot in its body frame, [E * N, 2] in m/s."""

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
            "robot_radius": RADIUS,
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
        return f"{self.file} was trained in {self.trained_in}, but {' and '.join(differences)}"


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
