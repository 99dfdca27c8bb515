"""What every encoder is given and gives, and the names they are known by."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from samarl.observations.frames import Frames
from samarl.registry import Registry

ENCODERS: Registry[Encoder] = Registry("encoder")

State = dict[str, Tensor]  # of an encoder, each [B, ...]


class Encoder(nn.Module, ABC):
    """From what a robot knew until now, and what it wants to know it for, to a feature Y.

    An encoder works in two parts. `observe` looks at the agents around the robot, over time: the
    scene. `read` answers a query, the robot's own state with where it is heading, from that scene.
    So both levels of a policy ask the same scene, each with its own target.

    Shapes: B robots (of all worlds), T frames, h frames of history before them (`history`), P
    samples, each one frame of one robot. What holds for all encoders: any number of humans and
    robots, finite with nobody known, and no difference whatever stands in the slots of those who
    are not known.
    """

    history = 0  # so many frames before the first are needed to observe it
    features: int  # length of Y

    def __init__(self, config: Any, ego_features: int, other_features: int) -> None:
        """Make the encoder.

        Args:
            config: its numbers, an instance of the dataclass it is registered with.
            ego_features: F_e, length of the robot's own state and of a query.
            other_features: F_o, length of what is known of another agent.
        """
        super().__init__()

    @abstractmethod
    def observe(
        self, frames: Frames, is_init: Tensor, state: State, samples: Tensor | None = None
    ) -> Any:
        """The scene, a (nested) tuple or dict of tensors [P, ...].

        Args:
            frames: [B, h + T, ...]; those before the first of an episode are ignored.
            is_init: [B, h + T] bool, whether an episode begins with this frame.
            state: before the first frame that is not history.
            samples: [P] which of the B T frames, as b T + t; None: all, in this order.
        """

    @abstractmethod
    def read(self, scene: Any, query: Tensor) -> Tensor:
        """Y [P, features] of a scene for queries [P, F_e]."""

    def initial_state(self, frame: Frames) -> State:
        """What is remembered before the first frame; `frame` is an example of one, [B, 1, ...]."""
        return {}

    def step(self, frame: Frames, is_init: Tensor, state: State, rows: Tensor | None = None) -> Any:
        """The scene [R, ...] of one more frame.

        Args:
            frame: [R, 1, ...] what R of the B robots know now.
            is_init: [R] bool.
            state: of all B robots, updated in place.
            rows: [R] which robots; None: all of them.
        """
        return self.observe(frame, is_init.unsqueeze(1), state)

    def resume(self, frames: Frames, is_init: Tensor, state: State, rows: Tensor) -> None:
        """Bring `state` of some robots to what it is after their last frames.

        It is called where the weights have changed, or where robots are taken back in time. What
        only depends on the weights and on the last `history` frames is computed anew here; what
        goes back further must be in `memory`.

        Args:
            frames: [R, h, ...] the last frames.
            is_init: [R, h] bool.
            state: of all B robots, updated in place.
            rows: [R] which robots.
        """

    def memory(self, state: State) -> State:
        """The part of the state that `resume` cannot compute."""
        return state

    def attention(self, scene: Any, query: Tensor) -> tuple[Tensor, Tensor] | None:
        """How each robot's attention is shared out, for replays.

        Returns:
            Shares of the other robots [P, N - 1] and of the humans [P, M]; None: it has none.
        """
        return None


def samples_of(scene: Any, index: Tensor | slice) -> Any:
    """Some samples of a scene."""
    return tree_map(lambda tensor: tensor[index], scene)


def single_frames(frames: Frames, samples: Tensor | None) -> Frames:
    """The frame of each sample alone, [P, ...], for encoders without history."""
    every = (tensor.flatten(0, 1) for tensor in frames)
    return Frames(*(tensor if samples is None else tensor[samples] for tensor in every))


def frame_numbers(frames: Frames, history: int, samples: Tensor | None) -> Tensor:
    """The number b (h + T) + h + t of each sample's frame, [P]."""
    b, t = frames.ego.shape[:2]
    steps = t - history
    if samples is None:
        samples = torch.arange(b * steps, device=frames.ego.device)
    return samples // steps * t + history + samples % steps
