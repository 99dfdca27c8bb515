"""The mouths of passages, and geometry of points and ways relative to them."""

import math
from typing import NamedTuple

import numpy as np

from mrsan.kernels import function


class Mouths(NamedTuple):
    """The mouths of the passages of a world, or of all worlds, one world after the other.

    Numbers of mouths and passages are those in their world.
    """

    position: np.ndarray  # [K, 2] m
    outward: np.ndarray  # [K, 2]
    width: np.ndarray  # [K] m
    passage: np.ndarray  # [K] its number in the world
    length: np.ndarray  # [K] of its passage, m
    first_place: np.ndarray  # [K] the first of its queue places ...
    last_place: np.ndarray  # [K] ... and the one after the last
    places: np.ndarray  # [Q, 2] queue places, m


@function
def mouths_of_world(mouths, first_mouth, e):
    """Return the mouths of world `e`, which are those from `first_mouth[e]` on."""
    first, last = first_mouth[e], first_mouth[e + 1]
    return Mouths(
        mouths.position[first:last],
        mouths.outward[first:last],
        mouths.width[first:last],
        mouths.passage[first:last],
        mouths.length[first:last],
        mouths.first_place[first:last],
        mouths.last_place[first:last],
        mouths.places,
    )


@function
def distance_to(mouths, k, x, y):
    """Return the distance of (x, y) from mouth `k`, m."""
    return math.hypot(x - mouths.position[k, 0], y - mouths.position[k, 1])


@function
def ahead_of(mouths, k, x, y):
    """Return how far (x, y) is before mouth `k`, m; negative inside."""
    dx, dy = x - mouths.position[k, 0], y - mouths.position[k, 1]
    return dx * mouths.outward[k, 0] + dy * mouths.outward[k, 1]


@function
def aside_of(mouths, k, x, y):
    """Return how far (x, y) is beside the axis of mouth `k`, m."""
    dx, dy = x - mouths.position[k, 0], y - mouths.position[k, 1]
    return abs(dy * mouths.outward[k, 0] - dx * mouths.outward[k, 1])


@function
def crossing(mouths, k, ax, ay, bx, by):
    """Return at which share of the way from a to b it crosses mouth `k`, outwards or inwards.

    Returns the share, above 1 if it does not, and whether it leads outwards.
    """
    before, after = ahead_of(mouths, k, ax, ay), ahead_of(mouths, k, bx, by)
    if before * after > 0.0 or before == after:
        return 2.0, False
    share = before / (before - after)
    x, y = ax + share * (bx - ax), ay + share * (by - ay)
    if aside_of(mouths, k, x, y) > 0.5 * mouths.width[k]:
        return 2.0, False
    return share, after > before


@function
def distance_from_way(x, y, ax, ay, bx, by):
    """Return the distance of (x, y) from the way from a to b, m."""
    dx, dy = bx - ax, by - ay
    share = ((x - ax) * dx + (y - ay) * dy) / max(dx * dx + dy * dy, 1e-9)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(x - ax - share * dx, y - ay - share * dy)
