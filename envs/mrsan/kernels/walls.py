"""Walls: directed segments whose solid side is on their left, and the geometry they need.

The walls of a world are the columns of an array [12, W] that `close_polygon` writes: a segment, its
unit direction, those of the segments before and after it in its polygon, and whether its ends are
convex corners. Counter-clockwise polygons are solid, clockwise ones bound the floor, and two
vertices make a thin wall with a front and a back, as in the RVO2 library.

Loops over segments have no branches, so that the compiler can use vector instructions. So that
these loops have no remainder, walls too far away to matter fill the columns up to a multiple of
`LANES`, see `wall_count`.
"""

import math

import numpy as np

from mrsan.kernels import function, separate

WALL_ROWS = 12
MOST_SEGMENTS = 256  # of a world
LANES = 16  # walls examined together
START_X, START_Y, END_X, END_Y = range(4)
ALONG_X, ALONG_Y = 4, 5  # direction of the segment
BEFORE_X, BEFORE_Y, AFTER_X, AFTER_Y = range(6, 10)  # directions of its neighbours
START_CONVEX, END_CONVEX = 10, 11  # 1 or 0

# Columns of `State.place`, which describes the place of an episode.
PLACE_COLUMNS = 9
WALLS = 0  # number of wall segments
CORNERS = 1  # number of corners of the route graph
ZONES = 2  # number of zones in which starts and goals are drawn
WINDING = 3  # winding number of the free floor
FAMILY = 4  # the layout that was drawn
CROSSING_SHARE = 5  # probability that a person's goal lies in another zone
REDRAWS = 6  # starts and goals that were drawn again because they had no route
CLEARANCE = 7  # distance that routes keep from walls, m
DISCARDED = 8  # places drawn before this one in which the agents had no room

_NONE = np.int32(0)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_TINY = np.float32(1e-12)
_FAR_AWAY = np.float32(1e6)  # m
_FAR = np.float32(np.inf)


def with_room_for_lanes(count: int) -> int:
    """Return the number of columns that `count` walls need."""
    return -(-count // LANES) * LANES


@function
def wall_count(place):
    """Return the number of columns of the walls of a place, with those that are far away."""
    return (int(place[WALLS]) + (LANES - 1)) // LANES * LANES


@function
def fill_up(walls, place):
    """Write the far walls behind those of a place."""
    for k in range(int(place[WALLS]), wall_count(place)):
        walls[START_X, k], walls[END_X, k] = _ZERO, _ONE
        walls[START_Y, k] = walls[END_Y, k] = _FAR_AWAY
        walls[ALONG_X, k] = walls[BEFORE_X, k] = walls[AFTER_X, k] = _ONE
        walls[ALONG_Y, k] = walls[BEFORE_Y, k] = walls[AFTER_Y, k] = _ZERO


@separate
def close_polygon(walls, first, last):
    """Complete a polygon whose vertices are the starts of segments `first` to `last` (excluded)."""
    for k in range(first, last):
        following = k + 1 if k + 1 < last else first
        walls[END_X, k], walls[END_Y, k] = walls[START_X, following], walls[START_Y, following]
        dx, dy = walls[END_X, k] - walls[START_X, k], walls[END_Y, k] - walls[START_Y, k]
        length = math.sqrt(dx * dx + dy * dy)
        walls[ALONG_X, k], walls[ALONG_Y, k] = dx / length, dy / length
    for k in range(first, last):
        before = k - 1 if k > first else last - 1
        walls[BEFORE_X, k], walls[BEFORE_Y, k] = walls[ALONG_X, before], walls[ALONG_Y, before]
        convex = last - first == 2 or _turns_left(walls, before, k)
        walls[START_CONVEX, k] = walls[END_CONVEX, before] = _ONE if convex else _ZERO
        walls[AFTER_X, before], walls[AFTER_Y, before] = walls[ALONG_X, k], walls[ALONG_Y, k]


@function
def _turns_left(walls, before, k):
    return (
        walls[ALONG_X, before] * walls[ALONG_Y, k] - walls[ALONG_Y, before] * walls[ALONG_X, k]
        >= _ZERO
    )


@function
def _squared(x, y):
    return x * x + y * y


@function
def _sides(ax, ay, bx, by, dx, dy):
    """Return two products that are negative if a wall from a to b and a way (dx, dy) cross.

    The first is negative if the way's line separates the ends of the wall, the second if the wall's
    line separates those of the way, which starts at the origin; 0 means that an end is on the line.
    """
    ux, uy = bx - ax, by - ay
    of_wall = (dx * ay - dy * ax) * (dx * by - dy * bx)
    return of_wall, (uy * ax - ux * ay) * (uy * (ax - dx) - ux * (ay - dy))


@function
def _from_way(px, py, dx, dy, by_length):
    """Return the squared distance of a point from a way (dx, dy) that starts at the origin, m^2."""
    t = min(max((px * dx + py * dy) * by_length, _ZERO), _ONE)
    return _squared(px - t * dx, py - t * dy)


@separate
def sees(walls, count, x, y, dx, dy):
    """Return whether no wall crosses or touches the way from (x, y) to (x + dx, y + dy)."""
    crossed = False
    for k in range(count):
        ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
        bx, by = walls[END_X, k] - x, walls[END_Y, k] - y
        wall_sides, way_sides = _sides(ax, ay, bx, by, dx, dy)
        crossed |= (wall_sides <= _ZERO) & (way_sides <= _ZERO)
    return not crossed


@separate
def is_clear(walls, count, x, y, dx, dy, radius):
    """Return whether a disc that moves from (x, y) by (dx, dy) keeps clear of all walls."""
    touched = False
    squared = radius * radius
    by_length = _ONE / max(dx * dx + dy * dy, _TINY)
    for k in range(count):
        ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
        bx, by = walls[END_X, k] - x, walls[END_Y, k] - y
        wall_sides, way_sides = _sides(ax, ay, bx, by, dx, dy)
        crossed = (wall_sides < _ZERO) & (way_sides < _ZERO)
        # The ends of the wall from the way, and the ends of the way from the wall.
        near = _from_way(ax, ay, dx, dy, by_length) < squared
        near |= _from_way(bx, by, dx, dy, by_length) < squared
        along_x, along_y = walls[ALONG_X, k], walls[ALONG_Y, k]
        length = (bx - ax) * along_x + (by - ay) * along_y
        t = min(max(-(ax * along_x + ay * along_y), _ZERO), length)
        px, py = ax + t * along_x, ay + t * along_y
        near |= px * px + py * py < squared
        t = min(max((dx - ax) * along_x + (dy - ay) * along_y, _ZERO), length)
        px, py = ax + t * along_x - dx, ay + t * along_y - dy
        near |= px * px + py * py < squared
        touched |= near | crossed
    return not touched


@separate
def is_clear_between(walls, count, x, y, dx, dy, radius):
    """Return what `is_clear` does for a disc that is clear of all walls at both ends of its way.

    Then only walls that cross the way and their vertices, each the start of a wall, can be in it.
    """
    touched = False
    squared = radius * radius
    by_length = _ONE / max(dx * dx + dy * dy, _TINY)
    for k in range(count):
        ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
        bx, by = walls[END_X, k] - x, walls[END_Y, k] - y
        wall_sides, way_sides = _sides(ax, ay, bx, by, dx, dy)
        crossed = (wall_sides <= _ZERO) & (way_sides <= _ZERO)
        touched |= crossed | (_from_way(ax, ay, dx, dy, by_length) < squared)
    return not touched


@function
def way_distance(walls, count, x, y, dx, dy):
    """Return the smallest distance to a wall on the way from (x, y) by (dx, dy); inf without, m."""
    nearest = np.float32(np.inf)
    by_length = _ONE / max(dx * dx + dy * dy, _TINY)
    for k in range(count):
        ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
        bx, by = walls[END_X, k] - x, walls[END_Y, k] - y
        wall_sides, way_sides = _sides(ax, ay, bx, by, dx, dy)
        if wall_sides < _ZERO and way_sides < _ZERO:
            return _ZERO
        nearest = min(nearest, _from_way(ax, ay, dx, dy, by_length))
        nearest = min(nearest, _from_way(bx, by, dx, dy, by_length))
        ux, uy = bx - ax, by - ay
        by_wall = _ONE / max(ux * ux + uy * uy, _TINY)
        for qx, qy in ((_ZERO, _ZERO), (dx, dy)):
            t = min(max(((qx - ax) * ux + (qy - ay) * uy) * by_wall, _ZERO), _ONE)
            nearest = min(nearest, _squared(ax + t * ux - qx, ay + t * uy - qy))
    return math.sqrt(nearest)


@function
def nearest_point(walls, k, x, y):
    """Return the point of segment `k` that is nearest to (x, y)."""
    ax, ay = walls[START_X, k], walls[START_Y, k]
    ux, uy = walls[END_X, k] - ax, walls[END_Y, k] - ay
    length_squared = max(ux * ux + uy * uy, _TINY)
    t = min(max(((x - ax) * ux + (y - ay) * uy) / length_squared, _ZERO), _ONE)
    return ax + t * ux, ay + t * uy


@separate
def front_distances(walls, count, x, y, squared):
    """Write the squared distances of all walls to (x, y) into [W]; inf behind a wall, m^2."""
    for k in range(count):
        from_x, from_y = x - walls[START_X, k], y - walls[START_Y, k]
        along_x, along_y = walls[ALONG_X, k], walls[ALONG_Y, k]
        ux, uy = walls[END_X, k] - walls[START_X, k], walls[END_Y, k] - walls[START_Y, k]
        t = min(max(from_x * along_x + from_y * along_y, _ZERO), ux * along_x + uy * along_y)
        px, py = from_x - t * along_x, from_y - t * along_y
        is_behind = along_x * from_y - along_y * from_x >= _ZERO
        squared[k] = _FAR if is_behind else px * px + py * py


@function
def faces(walls, k, x, y):
    """Return whether (x, y) is on the free side of segment `k`."""
    return (
        walls[ALONG_X, k] * (y - walls[START_Y, k]) - walls[ALONG_Y, k] * (x - walls[START_X, k])
        < _ZERO
    )


@function
def wall_distance(walls, count, x, y):
    """Return the distance from (x, y) to the nearest wall; inf without walls, m."""
    nearest = np.float32(np.inf)
    for k in range(count):
        px, py = nearest_point(walls, k, x, y)
        nearest = min(nearest, (px - x) * (px - x) + (py - y) * (py - y))
    return math.sqrt(nearest)


@separate
def winding_number(walls, count, x, y):
    """Return how often the polygons go round (x, y) counter-clockwise, less clockwise."""
    winding = _NONE
    for k in range(count):
        ax, ay = walls[START_X, k] - x, walls[START_Y, k] - y
        bx, by = walls[END_X, k] - x, walls[END_Y, k] - y
        side = ax * by - ay * bx
        upwards = np.int32((ay <= _ZERO) & (by > _ZERO) & (side > _ZERO))
        downwards = np.int32((ay > _ZERO) & (by <= _ZERO) & (side < _ZERO))
        winding = np.int32(winding + upwards - downwards)
    return winding
