"""Small scenes, and what robots know in them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from mrsan import Entities, Observation, Scenario
from mrsan.features import GOAL, HEADING_COS, PREFERRED_SPEED, RADIUS, VELOCITY_X
from samarl.observations.frames import Frames
from samarl.observations.tracker import Tracker
from samarl.planning.one_step import Commands

KNOWN = ("humans_known", "robots_known")
COMMANDS = Commands(turns=5, speeds=5, directions=16)


def known(observation: Observation, scenario: Scenario) -> Observation:
    e, n, m = observation.humans_visible.shape
    tracker = Tracker(8 * scenario.time_step, scenario.time_step)
    return tracker.update(observation, tracker.initial(e, n, m), np.ones(e, np.bool_))


def scene_of(
    humans: list[list[float]], goal: tuple[float, float], speed: float, scenario: Scenario
) -> Observation:
    """A robot at the origin that looks and moves along x; people relative to it."""
    ego = np.zeros((1, 1, 11), np.float32)
    ego[..., GOAL], ego[..., VELOCITY_X], ego[..., HEADING_COS] = goal, speed, 1.0
    ego[..., RADIUS], ego[..., PREFERRED_SPEED] = scenario.robot_radius, scenario.robot_speed
    people = np.zeros((1, 1, len(humans), 6), np.float32)
    for j, row in enumerate(humans):
        people[0, 0, j, : len(row)] = row
    entities = {
        "humans": Entities(people, np.ones((1, 1, len(humans)), np.bool_)),
        "robots": Entities(np.zeros((1, 1, 0, 6), np.float32), np.zeros((1, 1, 0), np.bool_)),
    }
    return Observation(ego, entities, {})


def changed(frames: Frames, **tensors: Tensor) -> Frames:
    """The same frames with some of their `named` tensors replaced."""
    return Observation.from_arrays(frames.arrays("known") | tensors)


def blind(frames: Frames) -> Frames:
    """The same with nobody known."""
    unknown = {name: torch.zeros_like(frames.arrays("known")[name]) for name in KNOWN}
    return changed(frames, **unknown)
