"""The families of places with walls, drawn per episode; their numbers are `mrsan.place.Place`.

Each family writes its walls and the zones in which starts and goals are drawn. All places are
centred on the origin.
"""

import math

import numpy as np

from mrsan.kernels import function, rng, separate
from mrsan.kernels.layout import CORNER, CORRIDOR, DOORWAY, INTERSECTION, PILLARS, ROOMS
from mrsan.kernels.walls import (
    CLEARANCE,
    CROSSING_SHARE,
    FAMILY,
    START_X,
    START_Y,
    WALLS,
    WINDING,
    ZONES,
    close_polygon,
    nearest_point,
)
from mrsan.se2 import rotate

MOST_ZONES = 9

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_PI = np.float32(math.pi)
_ZONE_SHARE = np.float32(0.625)  # of an arm, at its end
_DOOR_POST = np.float32(0.3)  # shortest wall beside a door, m
_SIDES = 16  # of a round pillar
_PILLAR_TRIES = 32
_DOORS, _LOOPS, _DOOR_PLACES, _OBSTACLES = 64, 96, 128, 256  # `agent` numbers of random draws


@separate
def draw_place(walls, place, zones, key, family, attempt, q):
    """Draw the walls and zones of a place.

    Args:
        walls: [12, W], written.
        place: [9], written except for the corners and the clearance.
        zones: [9, 4], written: left, bottom, right and top, m.
        key: of the episode.
        family: the layout.
        attempt: number of this attempt.
        q: the numbers of the families, `mrsan.place.Place`.
    """
    place[FAMILY], place[WINDING], place[CROSSING_SHARE] = np.float32(family), -_ONE, _ONE
    count = zone_count = 0
    if family == DOORWAY:
        length = _draw(q.wall_thickness_min, q.wall_thickness_max, key, 0, attempt)
        width = _draw(q.door_width_min, q.door_width_max, key, 1, attempt)
        count, zone_count = _two_rooms(
            walls, place, zones, key, attempt, length, width, q.room_length, q.room_width
        )
        place[CROSSING_SHARE] = q.crossing_share
    elif family == CORRIDOR:
        length = _draw(q.corridor_length_min, q.corridor_length_max, key, 0, attempt)
        width = _draw(q.corridor_width_min, q.corridor_width_max, key, 1, attempt)
        count, zone_count = _two_rooms(
            walls, place, zones, key, attempt, length, width, q.end_room_length, q.end_room_width
        )
    elif family == INTERSECTION:
        width = _draw(q.intersection_width_min, q.intersection_width_max, key, 0, attempt)
        count, zone_count = _intersection(walls, place, zones, width, q.intersection_length)
    elif family == CORNER:
        width = _draw(q.corner_width_min, q.corner_width_max, key, 0, attempt)
        count, zone_count = _corner(walls, place, zones, width, q.corner_length)
    elif family == ROOMS:
        count, zone_count = _rooms(walls, place, zones, key, attempt, q)
        place[CROSSING_SHARE] = q.crossing_share
    elif family == PILLARS:
        count, zone_count = _pillars(walls, place, zones, key, attempt, q)
    place[WALLS], place[ZONES] = np.float32(count), np.float32(zone_count)


@function
def _draw(low, high, key, number, attempt):
    return rng.uniform_between(low, high, key, rng.PLACE, number, attempt, 0)


@function
def _vertex(walls, k, x, y):
    walls[START_X, k], walls[START_Y, k] = x, y
    return k + 1


@function
def _zone(zones, number, left, bottom, right, top, margin):
    """Write a zone that keeps `margin` from the sides of a rectangle; return the next number."""
    zones[number, 0], zones[number, 1] = left + margin, bottom + margin
    zones[number, 2], zones[number, 3] = right - margin, top - margin
    return number + 1


@function
def _two_rooms(walls, place, zones, key, attempt, passage, opening, length, width):
    """Write two rooms joined by a passage along x; `opening` is its width."""
    opening = max(opening, _TWO * place[CLEARANCE])
    a, half, out = _HALF * passage, _HALF * width, _HALF * passage + length
    free = half - _HALF * opening - _DOOR_POST
    middle = free * rng.uniform_between(-_ONE, _ONE, key, rng.PLACE, 2, attempt, 0)
    low, high = middle - _HALF * opening, middle + _HALF * opening
    k = _vertex(walls, 0, -out, -half)
    k = _vertex(walls, k, -out, half)
    k = _vertex(walls, k, -a, half)
    k = _vertex(walls, k, -a, high)
    k = _vertex(walls, k, a, high)
    k = _vertex(walls, k, a, half)
    k = _vertex(walls, k, out, half)
    k = _vertex(walls, k, out, -half)
    k = _vertex(walls, k, a, -half)
    k = _vertex(walls, k, a, low)
    k = _vertex(walls, k, -a, low)
    k = _vertex(walls, k, -a, -half)
    close_polygon(walls, 0, k)
    z = _zone(zones, 0, -out, -half, -a, half, place[CLEARANCE])
    z = _zone(zones, z, a, -half, out, half, place[CLEARANCE])
    return k, z


@function
def _intersection(walls, place, zones, width, length):
    """Write four arms that meet in a square."""
    a, out = _HALF * width, _HALF * width + length
    k = _vertex(walls, 0, -a, -out)
    k = _vertex(walls, k, -a, -a)
    k = _vertex(walls, k, -out, -a)
    k = _vertex(walls, k, -out, a)
    k = _vertex(walls, k, -a, a)
    k = _vertex(walls, k, -a, out)
    k = _vertex(walls, k, a, out)
    k = _vertex(walls, k, a, a)
    k = _vertex(walls, k, out, a)
    k = _vertex(walls, k, out, -a)
    k = _vertex(walls, k, a, -a)
    k = _vertex(walls, k, a, -out)
    close_polygon(walls, 0, k)
    margin, near = place[CLEARANCE], out - _ZONE_SHARE * length
    z = _zone(zones, 0, -out, -a, -near, a, margin)
    z = _zone(zones, z, near, -a, out, a, margin)
    z = _zone(zones, z, -a, -out, a, -near, margin)
    z = _zone(zones, z, -a, near, a, out, margin)
    return k, z


@function
def _corner(walls, place, zones, width, length):
    """Write an arm to the left and one downwards, which meet in a blind corner."""
    # Centred: the arms reach from -length / 2 to the outer corner at length / 2.
    out = _HALF * length
    inner = out - width
    k = _vertex(walls, 0, -out, inner)
    k = _vertex(walls, k, -out, out)
    k = _vertex(walls, k, out, out)
    k = _vertex(walls, k, out, -out)
    k = _vertex(walls, k, inner, -out)
    k = _vertex(walls, k, inner, inner)
    close_polygon(walls, 0, k)
    margin, near = place[CLEARANCE], -out + _ZONE_SHARE * (length - width)
    z = _zone(zones, 0, -out, inner, near, out, margin)
    z = _zone(zones, z, inner, -out, out, near, margin)
    return k, z


@function
def _rectangle(walls, k, left, bottom, right, top):
    """Write a clockwise rectangle, which bounds the floor."""
    first = k
    k = _vertex(walls, k, left, bottom)
    k = _vertex(walls, k, left, top)
    k = _vertex(walls, k, right, top)
    k = _vertex(walls, k, right, bottom)
    close_polygon(walls, first, k)
    return k


@function
def _thin_wall(walls, k, x0, y0, x1, y1):
    first = k
    k = _vertex(walls, k, x0, y0)
    k = _vertex(walls, k, x1, y1)
    close_polygon(walls, first, k)
    return k


@function
def _size(index, key, attempt, number, q):
    """Return the size of a column (numbers 10 to 12) or of a row (13 to 15) of rooms."""
    return _draw(q.rooms_size_min, q.rooms_size_max, key, number + index, attempt)


@function
def _rooms(walls, place, zones, key, attempt, q):
    """Write a grid of 2 x 2 to 3 x 3 rooms; thin walls part them, and doors join them.

    The doors are a random spanning tree and some others, which close loops.
    """
    columns = 2 + (rng.uniform(key, rng.PLACE, 3, attempt, 0) >= _HALF)
    rows = 2 + (rng.uniform(key, rng.PLACE, 4, attempt, 0) >= _HALF)
    width = height = _ZERO
    for c in range(columns):
        width += _size(c, key, attempt, 10, q)
    for r in range(rows):
        height += _size(r, key, attempt, 13, q)
    k = _rectangle(walls, 0, -_HALF * width, -_HALF * height, _HALF * width, _HALF * height)
    doors = _draw_doors(columns, rows, key, attempt, q)
    z, bottom = 0, -_HALF * height
    for r in range(rows):
        left, top = -_HALF * width, bottom + _size(r, key, attempt, 13, q)
        for c in range(columns):
            right = left + _size(c, key, attempt, 10, q)
            z = _zone(zones, z, left, bottom, right, top, place[CLEARANCE])
            for side in range(2):  # the walls to the right and above
                if (c + 1 == columns) if side == 0 else (r + 1 == rows):
                    continue
                wall = 2 * (3 * r + c) + side
                start, end = (bottom, top) if side == 0 else (left, right)
                low, high = _door(start, end, wall, (doors >> wall) & 1, place, key, attempt, q)
                for piece in range(2):
                    begin, stop = (start, low) if piece == 0 else (high, end)
                    if stop <= begin:
                        continue
                    if side == 0:
                        k = _thin_wall(walls, k, right, begin, right, stop)
                    else:
                        k = _thin_wall(walls, k, begin, top, stop, top)
            left = right
        bottom = top
    return k, z


@function
def _door(start, end, wall, open, place, key, attempt, q):
    """Return where the door of a wall begins and stops; without one, the end of the wall."""
    if open == 0:
        return end, end
    width = _draw(q.rooms_door_min, q.rooms_door_max, key, _DOORS + wall, attempt)
    width = max(width, _TWO * place[CLEARANCE])
    share = rng.uniform(key, rng.PLACE, _DOOR_PLACES + wall, attempt, 0)
    low = start + _DOOR_POST + share * (end - start - width - _TWO * _DOOR_POST)
    return low, low + width


@function
def _draw_doors(columns, rows, key, attempt, q):
    """Return the walls with doors as bits: wall 2 (3 row + column) + side; 0: right, 1: above."""
    doors, reached = 0, 1  # rooms are bits 3 row + column
    for _ in range(columns * rows - 1):  # Prim's algorithm with random weights
        best, least, room = 0, _TWO, 0
        for wall in range(18):
            cell, step = wall // 2, 1 if wall % 2 == 0 else 3
            c, r = cell % 3, cell // 3
            if c + (step == 1) >= columns or r + (step == 3) >= rows:
                continue  # there is no such wall
            here, there = (reached >> cell) & 1, (reached >> (cell + step)) & 1
            weight = rng.uniform(key, rng.PLACE, _LOOPS + wall, attempt, 0)
            if here != there and weight < least:
                best, least, room = wall, weight, cell + step if here else cell
        doors |= 1 << best
        reached |= 1 << room
    for wall in range(18):
        if rng.uniform(key, rng.PLACE, _LOOPS + wall, attempt, 1) < q.rooms_loop_share:
            doors |= 1 << wall
    return doors


@function
def _pillars(walls, place, zones, key, attempt, q):
    """Write a square floor with boxes and round pillars."""
    half = _HALF * q.pillars_floor
    k = _rectangle(walls, 0, -half, -half, half, half)
    z = _zone(zones, 0, -half, -half, half, half, place[CLEARANCE])
    low, high = q.pillars_min, q.pillars_max
    number = low + int(rng.uniform(key, rng.PLACE, 3, attempt, 0) * np.float32(high - low + 1))
    for i in range(min(number, high)):
        k = _pillar(walls, k, _OBSTACLES + i, key, attempt, half, place, q)
    return k, z


@function
def _pillar(walls, k, number, key, attempt, half, place, q):
    """Write a pillar where there is room for it; return the number of walls."""
    a = _HALF * _draw(q.pillars_size_min, q.pillars_size_max, key, number, attempt)
    b = _HALF * rng.uniform_between(
        q.pillars_size_min, q.pillars_size_max, key, rng.PLACE, number, attempt, 1
    )
    round_ = rng.uniform(key, rng.PLACE, number, attempt, 2) < q.pillars_round_share
    radius = a if round_ else math.sqrt(a * a + b * b)
    gap = max(q.pillars_gap, _TWO * place[CLEARANCE])
    room = half - gap - radius
    for trial in range(_PILLAR_TRIES):
        x = rng.uniform_between(-room, room, key, rng.PLACE, number, attempt, 4 + 2 * trial)
        y = rng.uniform_between(-room, room, key, rng.PLACE, number, attempt, 5 + 2 * trial)
        if not _has_gap(walls, k, x, y, radius + gap):
            continue
        first, turn = k, _PI * rng.uniform(key, rng.PLACE, number, attempt, 3)
        cos, sin = math.cos(turn), math.sin(turn)
        for side in range(_SIDES if round_ else 4):
            if round_:
                angle = _TWO * _PI * np.float32(side) / np.float32(_SIDES)
                dx, dy = a * math.cos(angle), a * math.sin(angle)
            else:
                dx = a if side == 0 or side == 3 else -a
                dy = b if side < 2 else -b
            dx, dy = rotate(cos, sin, dx, dy)
            k = _vertex(walls, k, x + dx, y + dy)
        close_polygon(walls, first, k)
        return k
    return k


@function
def _has_gap(walls, count, x, y, reach):
    """Return whether the pillars written so far are farther away than `reach`."""
    for k in range(4, count):
        px, py = nearest_point(walls, k, x, y)
        if (px - x) * (px - x) + (py - y) * (py - y) < reach * reach:
            return False
    return True
