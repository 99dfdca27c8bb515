"""Mirror images of what robots know and do: left and right change places."""

from __future__ import annotations

import torch
from torch import Tensor

from samarl.observations.frames import EntityFeatures, Frames

LATERAL_OF_EGO = (1, 3, 6, 8)  # features whose sign changes: the target, its direction, ...
LATERAL_OF_AGENT = (1, 3)  # position and velocity
LATERAL_GOAL = 10  # in the true state
TURNED = (1.0, -1.0, -1.0)  # of an action: forward and lateral acceleration, heading change


def mirrored(frames: Frames) -> Frames:
    """Return the mirror image of frames of an actor or a critic, without walls."""
    entities = {}
    for name, (features, mask) in frames.entities.items():
        lateral: tuple[int, ...] = LATERAL_OF_AGENT
        if features.shape[-1] > LATERAL_GOAL:
            lateral = (*lateral, LATERAL_GOAL)
        entities[name] = EntityFeatures(_with_other_sign(features, lateral), mask)
    return Frames(_with_other_sign(frames.ego, LATERAL_OF_EGO), entities, {})


def _with_other_sign(features: Tensor, lateral: tuple[int, ...]) -> Tensor:
    sign = torch.ones(features.shape[-1])
    sign[list(lateral)] = -1.0
    return features * sign
