"""Round the crowd, blind: out to a circle, along it, and in to the goal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.features import GOAL, GOAL_X, GOAL_Y, ORIGIN, ORIGIN_X, ORIGIN_Y
from mrsan.scenario import required
from samarl.agents.agent import Agent
from samarl.agents.planners.straight import drive_towards


@dataclass
class Perimeter(Agent):
    """Uses nothing but the robot's own position and goal; all robots go round the same way."""

    radius: float = required(0.5, 1000.0)  # of the circle round the crowd, m
    lookahead: float = required(0.01, 3.0)  # how far ahead on the circle it aims, rad
    entry_angle: float = required(0.01, 3.0)  # it turns in when so near the goal's bearing, rad

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """Towards the next point of the way round."""
        targets = way_round(observation.ego, self.radius, self.lookahead, self.entry_angle)
        return drive_towards(observation, targets, self.scenario)


def way_round(
    ego: NDArray[np.float32], radius: float, lookahead: float, entry_angle: float
) -> NDArray[np.float32]:
    """The next point on the way round the crowd in the body frame, [E, N, 2] in m.

    It is counter-clockwise, but for a robot that has passed its goal, which turns back.

    Args:
        ego: [E, N, 11] own states.
        radius: of the circle round the crowd, m.
        lookahead: how far ahead on the circle it is, rad.
        entry_angle: it is the goal when that is so near in bearing, rad.
    """
    # Bearings from the origin, in the body frame.
    goal = np.arctan2(ego[..., GOAL_Y] - ego[..., ORIGIN_Y], ego[..., GOAL_X] - ego[..., ORIGIN_X])
    here = np.arctan2(-ego[..., ORIGIN_Y], -ego[..., ORIGIN_X])
    remaining = (goal - here + np.pi) % (2 * np.pi) - np.pi
    passed = (remaining < -entry_angle) & (remaining > -np.pi / 2)
    onward = here + np.float32(lookahead) * np.where(passed, -1, 1)
    circle = np.float32(radius) * np.stack([np.cos(onward), np.sin(onward)], -1)
    turn_in = (np.abs(remaining) < entry_angle)[..., None]
    return np.where(turn_in, ego[..., GOAL], circle + ego[..., ORIGIN]).astype(np.float32)
