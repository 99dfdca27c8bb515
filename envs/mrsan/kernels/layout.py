"""Starts and goals, for each layout of the place."""

import math

import numpy as np

from mrsan.kernels import function, rng
from mrsan.se2 import rotate

CIRCLE = 0  # all agents cross to the opposite point: SAMARL
CROSSING = 1  # two streams of people at right angles
OPPOSITE = 2  # two streams along one band
SQUARE = 3  # anywhere on the floor
MIXED = 4  # one of these, drawn per episode
# With walls, see `mrsan.kernels.places`:
DOORWAY = 5  # two rooms with an opening in the wall between them
CORRIDOR = 6  # two rooms joined by a corridor
INTERSECTION = 7  # four arms
CORNER = 8  # two arms with a blind corner
ROOMS = 9  # a grid of rooms with doors
PILLARS = 10  # a floor with boxes and round pillars
PLACES = 11  # one of these six, drawn per episode
MAP = 12  # the floor of a map file

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_QUARTER = np.float32(0.25)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_TINY = np.float32(1e-6)
_FAR = np.float32(np.inf)
_TWO_PI = np.float32(2.0 * math.pi)
_SQRT_2 = np.float32(math.sqrt(2.0))
_GROWTH = np.float32(0.05)
_ROUNDING = np.float32(1.0001)
_TRIES = 64  # attempts before the place is widened for an agent without room
_OFF_FLOOR = 1024  # attempts after which people may start outside a walled floor
IMPATIENT = 8192  # attempts after which the place is widened exponentially
_GOAL_TRIES = 32


@function
def layout_of(key, p):
    """Return the layout of an episode."""
    if p.layout == MIXED:
        return int(rng.uniform(key, rng.LAYOUT, 0, 0, 0) * np.float32(MIXED))
    if p.layout == PLACES:
        families = np.float32(PLACES - DOORWAY)
        return DOORWAY + int(rng.uniform(key, rng.LAYOUT, 0, 0, 0) * families)
    return p.layout


@function
def draw_robot_route(start, goal, key, i, attempt, layout, p):
    """Draw start and goal of robot `i`; return whether this attempt is permitted."""
    if layout == CIRCLE:
        room = p.arena_radius - p.robot_radius - _SQRT_2 * p.spawn_jitter * p.robot_speed
        x, y = _on_circle(key, i, attempt, room, p)
        _jitter(start, x, y, key, i, attempt, 1, p.spawn_jitter * p.robot_speed)
        _jitter(goal, -x, -y, key, i, attempt, 3, p.spawn_jitter * p.robot_speed)
        if p.goal_turn != _ZERO or p.goal_turn_spread != _ZERO:
            angle = p.goal_turn + rng.uniform_between(
                -p.goal_turn_spread, p.goal_turn_spread, key, rng.START, i, attempt, 6
            )
            goal[0], goal[1] = rotate(math.cos(angle), math.sin(angle), goal[0], goal[1])
            if (
                p.goal_turn_spread != _ZERO and attempt < _TRIES
            ):  # a goal may not coincide with the start
                dx, dy = goal[0] - start[0], goal[1] - start[1]
                apart = p.robot_radius + p.robot_radius + p.spawn_clearance
                return dx * dx + dy * dy >= apart * apart
        return True
    direct = attempt >= _TRIES
    half = _floor(attempt - _TRIES if direct else attempt, p)
    return draw_route_on_floor(start, goal, key, i, attempt, half, half, direct, p)


@function
def draw_route_on_floor(start, goal, key, i, attempt, half_x, half_y, direct, p):
    """Draw a start and a goal of robot `i` on a floor; return whether its length is permitted.

    Both are uniform on the floor, and an attempt of another length fails. Where hardly any two
    points are that far apart nearly all would fail: with `direct` the length is drawn first.
    """
    if direct:
        _draw_route_of_permitted_length(start, goal, key, i, attempt, half_x, half_y, p)
        return True
    start[0] = rng.uniform_between(-half_x, half_x, key, rng.START, i, attempt, 0)
    start[1] = rng.uniform_between(-half_y, half_y, key, rng.START, i, attempt, 1)
    goal[0] = rng.uniform_between(-half_x, half_x, key, rng.START, i, attempt, 2)
    goal[1] = rng.uniform_between(-half_y, half_y, key, rng.START, i, attempt, 3)
    dx, dy = goal[0] - start[0], goal[1] - start[1]
    squared = dx * dx + dy * dy
    shortest, longest = p.route_length_min, p.route_length_max
    return shortest * shortest <= squared and squared <= longest * longest


@function
def _draw_route_of_permitted_length(start, goal, key, i, attempt, half_x, half_y, p):
    """Draw the length of a route, then a direction in which it fits on the floor, then its start.

    The floor's diagonal must be at least `route_length_min` long.
    """
    diagonal = _TWO * math.sqrt(half_x * half_x + half_y * half_y)
    longest = min(p.route_length_max, diagonal)
    length = rng.uniform_between(p.route_length_min, longest, key, rng.START, i, attempt, 0)
    length = max(length, _TINY)
    flattest = math.acos(min(_TWO * half_x / length, _ONE))
    steepest = math.asin(min(_TWO * half_y / length, _ONE))
    angle = rng.uniform_between(flattest, steepest, key, rng.START, i, attempt, 1)
    quadrant = int(rng.uniform(key, rng.START, i, attempt, 2) * np.float32(4.0))
    dx = length * math.cos(angle) * (_ONE if quadrant % 2 == 0 else -_ONE)
    dy = length * math.sin(angle) * (_ONE if quadrant < 2 else -_ONE)
    left, right = max(-half_x, -half_x - dx), min(half_x, half_x - dx)
    bottom, top = max(-half_y, -half_y - dy), min(half_y, half_y - dy)
    start[0] = rng.uniform_between(left, right, key, rng.START, i, attempt, 3)
    start[1] = rng.uniform_between(bottom, top, key, rng.START, i, attempt, 4)
    goal[0], goal[1] = start[0] + dx, start[1] + dy


@function
def draw_human_start(start, key, j, agent, attempt, speed, layout, p):
    """Draw the start of human `j`, which is agent `agent` of the world."""
    if layout == CIRCLE:
        x, y = _on_circle(key, agent, attempt, _FAR, p)
        _jitter(start, x, y, key, agent, attempt, 1, p.spawn_jitter * speed)
        return
    half = _human_floor(attempt, p)
    first = rng.uniform_between(-half, half, key, rng.START, agent, attempt, 0)
    second = rng.uniform_between(-_ONE, _ONE, key, rng.START, agent, attempt, 1)
    if layout == SQUARE:
        start[0], start[1] = first, second * half
    else:  # `first` along the stream, `second` across
        across = second * _HALF * (p.crossing_width if layout == CROSSING else p.opposite_width)
        along_y = _walks_along_y(key, j, layout)
        start[0], start[1] = (across, first) if along_y else (first, across)


@function
def approximate_human_start(start, key, agent, attempt, speed, p):
    """Approximate `draw_human_start` on a circle of up to 15 m to 0.1 mm, up to `IMPATIENT`.

    It has no calls or branches, so that many attempts are computed at once.
    """
    circle = _widened_linearly(p.circle_radius, attempt)
    turn = rng.uniform(key, rng.START, agent, attempt, 0)
    shifted = turn + (_ONE - _QUARTER if turn < _QUARTER else -_QUARTER)
    x, y = circle * _cos_of_turn(turn), circle * _cos_of_turn(shifted)
    _jitter(start, x, y, key, agent, attempt, 1, p.spawn_jitter * speed)


@function
def _cos_of_turn(turn):
    """Approximate the cosine of 2 pi `turn`, in [0, 1), by a series with an error below 4e-6."""
    angle = _TWO_PI * (abs(turn - _HALF) - _QUARTER)
    squared = angle * angle
    series = _ONE - squared / np.float32(72.0)
    series = _ONE - squared / np.float32(42.0) * series
    series = _ONE - squared / np.float32(20.0) * series
    return angle * (_ONE - squared / np.float32(6.0) * series)


@function
def draw_human_goal(start, goal, key, j, agent, attempt, speed, layout, p):
    """Draw the first goal of human `j`, whose `start` was drawn in the same attempt."""
    if layout == CIRCLE:
        x, y = _on_circle(key, agent, attempt, _FAR, p)
        _jitter(goal, -x, -y, key, agent, attempt, 3, p.spawn_jitter * speed)
        return
    goal[0] = goal[1] = _ZERO
    if layout != SQUARE:
        half = _human_floor(attempt, p)
        end = half if rng.uniform(key, rng.LAYOUT, j, 0, 2) < _HALF else -half
        goal[0], goal[1] = (_ZERO, end) if _walks_along_y(key, j, layout) else (end, _ZERO)
    goal[0], goal[1] = draw_goal(start[0], start[1], goal[0], goal[1], key, j, 0, speed, layout, p)


@function
def draw_goal(x, y, old_x, old_y, key, j, step, speed, layout, p):
    """Draw a new goal for human `j` at (x, y), at least `goal_distance` away.

    In a stream it lies at the same end as the old goal, or at the other end if that is too close.
    """
    goal_x, goal_y = _ZERO, _ZERO
    half, jitter = _HALF * p.floor_size, p.spawn_jitter * speed
    for attempt in range(_GOAL_TRIES):
        draw = 3 * attempt
        if layout == CIRCLE:
            angle = _TWO_PI * rng.uniform(key, rng.HUMAN_GOAL, j, step, draw)
            goal_x = p.circle_radius * math.cos(angle) + rng.uniform_between(
                -jitter, jitter, key, rng.HUMAN_GOAL, j, step, draw + 1
            )
            goal_y = p.circle_radius * math.sin(angle) + rng.uniform_between(
                -jitter, jitter, key, rng.HUMAN_GOAL, j, step, draw + 2
            )
        elif layout == SQUARE:
            goal_x = rng.uniform_between(-half, half, key, rng.HUMAN_GOAL, j, step, draw)
            goal_y = rng.uniform_between(-half, half, key, rng.HUMAN_GOAL, j, step, draw + 1)
        else:
            width = _HALF * (p.crossing_width if layout == CROSSING else p.opposite_width)
            across = rng.uniform_between(-width, width, key, rng.HUMAN_GOAL, j, step, draw)
            along_y = _walks_along_y(key, j, layout)
            end = half if (old_y if along_y else old_x) > _ZERO else -half
            if abs(end - (y if along_y else x)) < p.goal_distance:
                end = -end
            goal_x, goal_y = (across, end) if along_y else (end, across)
        dx, dy = goal_x - x, goal_y - y
        if dx * dx + dy * dy >= p.goal_distance * p.goal_distance:
            break
    return goal_x, goal_y


@function
def _walks_along_y(key, j, layout):
    """Return whether the stream of human `j` runs along y."""
    return layout == CROSSING and rng.uniform(key, rng.LAYOUT, j, 0, 1) < _HALF


@function
def _floor(attempt, p):
    """Return half the side of the floor, m; without a wall it grows after failed attempts."""
    if p.arena_radius < np.inf:
        return _HALF * p.floor_size
    return widened(_HALF * p.floor_size, attempt)


@function
def _human_floor(attempt, p):
    """Return the same for people, who may start outside a wall after many failed attempts."""
    if attempt < _OFF_FLOOR:
        return _floor(attempt, p)
    return widened(_HALF * p.floor_size, attempt)


@function
def widened(length, attempt):
    """Return a length of the place, which grows after failed attempts."""
    length = _widened_linearly(length, min(attempt, IMPATIENT))
    if attempt > IMPATIENT:
        length *= np.float32((_ONE + _GROWTH) ** np.float32((attempt - IMPATIENT) // _TRIES))
    return length


@function
def _widened_linearly(length, attempt):
    return length * (_ONE + _GROWTH * np.float32(attempt // _TRIES))


@function
def _on_circle(key, agent, attempt, room, p):
    """Draw the point of the circle near which an agent starts; its goal lies opposite."""
    circle = widened(p.circle_radius, attempt)
    if circle > room * _ROUNDING:  # the circle crosses the wall: anywhere inside
        circle = room * math.sqrt(rng.uniform(key, rng.START, agent, attempt, 5))
    angle = _TWO_PI * rng.uniform(key, rng.START, agent, attempt, 0)
    return circle * math.cos(angle), circle * math.sin(angle)


@function
def _jitter(point, x, y, key, agent, attempt, draw, jitter):
    """Write a point near (x, y), displaced by up to `jitter` along each axis."""
    point[0] = x + rng.uniform_between(-jitter, jitter, key, rng.START, agent, attempt, draw)
    point[1] = y + rng.uniform_between(-jitter, jitter, key, rng.START, agent, attempt, draw + 1)
