"""Where robots head for next: the next corner of their route, or a way round the crowd."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation
from mrsan.features import GOAL, GOAL_X, GOAL_Y, ORIGIN_X, ORIGIN_Y
from mrsan.kernels import function, kernel

LOOKAHEAD = 0.3  # of policies that go round the crowd, rad
ENTRY_ANGLE = 0.15  # rad


def next_point(tracks: Observation) -> NDArray[np.float32]:
    """Return the next corner of every robot's route, or its goal, in the body frame, [E, N, 2], m.

    Without walls that is always the goal.
    """
    return tracks.sensors.get("route", tracks.ego[..., GOAL])


def heading_for_route(tracks: Observation) -> NDArray[np.float32]:
    """Return the robots' own states [E, N, 11] with the next point of the route as the goal."""
    ego = tracks.ego.copy()
    ego[..., GOAL] = next_point(tracks)
    return ego


def route(
    tracks: Observation,
    fov_degrees: float,
    has_walls: bool,
    perimeter_below_fov: float,
    round_radius: float,
) -> NDArray[np.float32]:
    """Return where the route of a policy leads next in the body frames, [E, N, 2] in m.

    To the next corner or the goal; or, without walls and with a view narrower than
    `perimeter_below_fov`, counter-clockwise round the crowd, on a circle of `round_radius` metres.
    """
    if fov_degrees < perimeter_below_fov and not has_walls:
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
    target = np.empty((*ego.shape[:2], 2), np.float32)
    limits = (float(number) for number in (radius, lookahead, entry_angle))
    _perimeter_route(ego.shape[0], np.ascontiguousarray(ego), *limits, target)
    return target


@kernel
def _perimeter_route(first, last, ego, radius, lookahead, entry_angle, target):
    for e in range(first, last):
        for i in range(ego.shape[1]):
            x, y = _next_on_perimeter(ego[e, i], radius, lookahead, entry_angle)
            target[e, i, 0], target[e, i, 1] = x, y


@function
def _next_on_perimeter(own, radius, lookahead, entry_angle):
    """Return the next point on the way round the crowd of one robot; float64, see `mrsan.se2`."""
    centre_x, centre_y = np.float64(own[ORIGIN_X]), np.float64(own[ORIGIN_Y])
    goal = math.atan2(own[GOAL_Y] - centre_y, own[GOAL_X] - centre_x)
    here = math.atan2(-centre_y, -centre_x)  # bearings from the origin, body frame
    remaining = (goal - here + math.pi) % (2.0 * math.pi) - math.pi
    if abs(remaining) < entry_angle:
        return np.float64(own[GOAL_X]), np.float64(own[GOAL_Y])
    passed = -0.5 * math.pi < remaining < -entry_angle
    onward = here - lookahead if passed else here + lookahead
    return centre_x + radius * math.cos(onward), centre_y + radius * math.sin(onward)
