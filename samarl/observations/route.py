"""Where robots head for next: the next corner of their route, or a way round the crowd."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.features import GOAL, GOAL_X, GOAL_Y, ORIGIN, ORIGIN_X, ORIGIN_Y

if TYPE_CHECKING:
    from samarl.observations.tracker import Tracks

LOOKAHEAD = 0.3  # of policies that go round the crowd, rad
ENTRY_ANGLE = 0.15  # rad


def next_point(tracks: Observation | Tracks) -> NDArray[np.float32]:
    """Return the next corner of every robot's route, or its goal, in the body frame, [E, N, 2], m.

    Without walls that is always the goal.
    """
    return tracks.sensors.get("route", tracks.ego[..., GOAL])


def heading_for_route(tracks: Observation | Tracks) -> NDArray[np.float32]:
    """Return the robots' own states [E, N, 11] with the next point of the route as the goal."""
    ego = tracks.ego.copy()
    ego[..., GOAL] = next_point(tracks)
    return ego


def route(
    tracks: Observation | Tracks, fov_degrees: float, round_below: float, round_radius: float
) -> NDArray[np.float32]:
    """Return where the route of a policy leads next in the body frames, [E, N, 2] in m.

    To the next corner or the goal; or, without walls and with a view narrower than `round_below`,
    counter-clockwise round the crowd, on a circle of `round_radius` metres.
    """
    if fov_degrees < round_below and "route" not in tracks.sensors:
        return perimeter_route(tracks.ego, round_radius, LOOKAHEAD, ENTRY_ANGLE)
    return next_point(tracks)


def perimeter_route(
    ego: NDArray[np.float32], radius: float, lookahead: float, entry_angle: float
) -> NDArray[np.float32]:
    """Return the next point on the way round the crowd in the body frame, [E, N, 2] in m.

    It is counter-clockwise, but for a robot that has passed its goal, which turns back.

    Args:
        ego: [E, N, 11] own states.
        radius: of the circle round the crowd, m.
        lookahead: how far ahead on the circle it is, rad.
        entry_angle: it is the goal when that is so near in bearing, rad.
    """
    goal = np.arctan2(ego[..., GOAL_Y] - ego[..., ORIGIN_Y], ego[..., GOAL_X] - ego[..., ORIGIN_X])
    here = np.arctan2(
        -ego[..., ORIGIN_Y], -ego[..., ORIGIN_X]
    )  # bearings from the origin, body frame
    remaining = (goal - here + np.pi) % (2 * np.pi) - np.pi
    passed = (remaining < -entry_angle) & (remaining > -np.pi / 2)
    onward = here + np.float32(lookahead) * np.where(passed, -1, 1)
    circle = np.float32(radius) * np.stack([np.cos(onward), np.sin(onward)], -1)
    turn_in = (np.abs(remaining) < entry_angle)[..., None]
    return np.where(turn_in, ego[..., GOAL], circle + ego[..., ORIGIN]).astype(np.float32)
