"""The interface of all encoders, and their registry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from samarl.observations.frames import FeatureSizes, Frames
from samarl.registry import Registry

ENCODERS: Registry[Encoder] = Registry("encoder")

EncoderState = dict[str, Tensor]  # of an encoder, each [B, ...]


class Encoder(nn.Module, ABC):
    """Encode what a robot has perceived so far into a feature vector Y.

    An encoder works in two parts. `observe` encodes the agents around the robot over time into a
    scene. `read` extracts Y from the scene for a query: the robot's own state with its target. Both
    levels of a policy read the same scene, each with its own query.

    Shapes: B robots (of all worlds), T frames, h frames of history before them (`history`), P
    samples, each one frame of one robot. All encoders accept any number of humans and robots, are
    finite with nobody in view, and ignore the contents of slots that are masked out.
    """

    history = 0  # number of frames before the first that `observe` needs, h
    features: int  # length of Y
    skips_empty_slots = False  # slots of groups in which nobody is known cost next to nothing

    def __init__(self, config: object, sizes: FeatureSizes) -> None:
        """Create the layers.

        Args:
            config: an instance of the dataclass that the encoder is registered with.
            sizes: the number of features: `sizes.ego` of the robot's own state and of a query, F_e;
                `sizes.entities[group]` of each group of entities; and `sizes.sensors[name]`, the
                shape of each sensor's values. Groups and sensors that the encoder does not know
                are ignored.
        """
        super().__init__()

    @abstractmethod
    def observe(
        self, frames: Frames, is_init: Tensor, state: EncoderState, samples: Tensor | None = None
    ) -> Any:
        """Return the scene of P samples, a (nested) tuple or dict of tensors [P, ...].

        Args:
            frames: [B, h + T, ...]; those before the first of an episode are ignored.
            is_init: [B, h + T] bool, whether an episode begins with this frame.
            state: the memory before the first frame that is not history.
            samples: [P] which of the B T frames, as b T + t; None: all, in this order.
        """

    @abstractmethod
    def read(self, scene: Any, query: Tensor) -> Tensor:
        """Return Y [P, features] of a scene for queries [P, F_e]."""

    def initial_state(self, frame: Frames) -> EncoderState:
        """Return the memory before the first frame; `frame` is an example of one, [B, 1, ...]."""
        return {}

    def step(self, frame: Frames, is_init: Tensor, state: EncoderState) -> Any:
        """Return the scene [B, ...] of one more frame.

        Args:
            frame: [B, 1, ...] the present frame of all robots.
            is_init: [B] bool, whether an episode begins with it.
            state: updated in place.
        """
        return self.observe(frame, is_init.unsqueeze(1), state)

    def resume(self, frames: Frames, is_init: Tensor, state: EncoderState, rows: Tensor) -> None:
        """Recompute the memory of some robots from their last frames.

        This is called when the weights have changed, or when worlds were restored to an earlier
        state. Whatever depends only on the weights and on the last `history` frames is recomputed
        here; whatever goes back further must be part of `memory`.

        Args:
            frames: [R, h, ...] the last frames.
            is_init: [R, h] bool.
            state: of all B robots, updated in place.
            rows: [R] which robots.
        """

    def memory(self, state: EncoderState) -> EncoderState:
        """Return the part of the memory that `resume` cannot recompute."""
        return state

    def attention(self, scene: Any, query: Tensor) -> tuple[Tensor, Tensor] | None:
        """Return the attention of each robot, for replays.

        Returns:
            Shares of the other robots [P, N - 1] and of the humans [P, M]; None without attention.
        """
        return None


def samples_of(scene: Any, index: Tensor | slice) -> Any:
    """Return some samples of a scene."""
    if isinstance(index, slice) and index == slice(None):  # all of them
        return scene
    return tree_map(lambda tensor: tensor[index], scene)


def single_frames(frames: Frames, samples: Tensor | None) -> Frames:
    """Return the frame of each sample, [P, ...], for encoders without history."""
    flat = frames.apply(lambda tensor: tensor.flatten(0, 1))
    return flat if samples is None else flat.select(samples)


def frame_numbers(frames: Frames, history: int, samples: Tensor | None) -> Tensor:
    """Return the number b (h + T) + h + t of each sample's frame, [P]."""
    b, t = frames.ego.shape[:2]
    steps = t - history
    if samples is None:
        samples = torch.arange(b * steps, device=frames.ego.device)
    return samples // steps * t + history + samples % steps
