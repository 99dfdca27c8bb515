"""Safety shield that replaces actions after which a collision can hardly be avoided.

It is minimally restrictive (Alshiekh et al., Safe Reinforcement Learning via Shielding, 2018): an
action passes if at least one continuation after it avoids everybody's predicted motion. Otherwise
the robot takes the continuation that stays collision-free the longest. Among those that do so for
the whole horizon, it prefers one that keeps some distance and leads towards the goal, around
whoever stands in between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.features import GOAL_X, GOAL_Y
from mrsan.fields import check_numbers, number
from mrsan.kernels import function, kernel
from mrsan.kernels.contact import closest_approach
from mrsan.kernels.walls import WALL_ROWS, way_distance
from mrsan.parameters import kernel_parameters
from samarl.observations.route import next_point
from samarl.planning.detour import remaining_path_length
from samarl.planning.velocity_control import (
    TURN_IN_PLACE_ANGLE,
    gather_rows,
    step_robot,
    track_rotated_velocity,
    track_velocity,
)
from samarl.planning.walls import gather_walls, seen_walls

DIRECTIONS = 16  # of continuations: at full speed, at half speed, and turning in place first
CONTINUATIONS = 1 + 3 * DIRECTIONS  # the first is standing still
SUFFICIENT_GAP = np.float32(0.3)  # a larger distance makes a continuation no better, m
ROUNDING = np.float32(1e-4)  # tolerance for rounding errors, m
TEAM_MATE_UNCERTAIN = 0.75  # s during which a team-mate may change its velocity unnoticed
PROGRESS_WEIGHT = np.float32(0.3)  # gap that one metre of progress towards the goal is worth, m

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_TWO_PI = np.float32(2.0 * math.pi)


@dataclass
class Shield:
    """Parameters of the shield, chosen on validation cases."""

    horizon: float = number(
        2.0, 0.0, 100.0, above=True, unit="s", help="time for which actions are checked"
    )
    human_margin: float = number(
        0.05, 0.0, 5.0, unit="m", help="margin added to the radius of people"
    )
    robot_margin: float = number(
        0.1, 0.0, 5.0, unit="m", help="margin added to the radius of robots"
    )
    track_time: float = number(
        6.0, 0.0, 1000.0, unit="s", help="time for which agents out of view are remembered"
    )

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: names the field, its value and its range.
        """
        check_numbers(self, "agent.shield")


def apply_shield(
    tracks: Observation,
    action: NDArray[np.float32],
    scenario: Scenario,
    shield: Shield,
) -> NDArray[np.float32]:
    """Return the actions [E, N, A], with unsafe ones replaced.

    Args:
        tracks: what every robot sees, or sees and remembers.
        action: [E, N, A] in [-1, 1].
        scenario: the dynamics.
        shield: its parameters.
    """
    checked = np.array(action, np.float32)
    settings = _Settings(
        max(1, scenario.steps(shield.horizon)),
        scenario.steps(TEAM_MATE_UNCERTAIN),
        np.float32(shield.human_margin),
        np.float32(shield.robot_margin),
    )
    _apply_shield(
        len(checked),
        *tracks.agents,
        *seen_walls(tracks),
        np.ascontiguousarray(next_point(tracks)),
        kernel_parameters(scenario),
        settings,
        checked,
    )
    return checked


class _Settings(NamedTuple):
    """`Shield` in the kernels' units: float32 and steps."""

    steps: int
    uncertain_steps: int
    human_margin: np.float32
    robot_margin: np.float32


class _Situation(NamedTuple):
    """What one robot knows, in its frame, and where it is heading."""

    rows: NDArray[np.float32]  # of `gather_rows`; the first is the robot
    row_count: int
    first_robot: int  # rows from here on are team-mates
    walls: NDArray[np.float32]
    target_x: np.float32
    target_y: np.float32
    target_is_goal: bool  # otherwise a corner of the route, behind which there may be a wall


@kernel
def _apply_shield(
    first,
    last,
    ego,
    humans,
    humans_known,
    robots,
    robots_known,
    segments,
    segments_seen,
    targets,
    p,
    settings,
    action,
):
    rows = np.empty((1 + humans.shape[2] + robots.shape[2], 5), np.float32)
    room = np.empty((WALL_ROWS, segments.shape[2] + 1), np.float32)
    first_action = np.empty(action.shape[2], np.float32)
    scratch_action = np.empty(action.shape[2], np.float32)
    for e in range(first, last):
        for i in range(ego.shape[1]):
            goal_x, goal_y = ego[e, i, GOAL_X], ego[e, i, GOAL_Y]
            if goal_x * goal_x + goal_y * goal_y < p.robot_radius * p.robot_radius:
                continue  # it has arrived
            count = gather_rows(
                ego[e, i],
                humans[e, i],
                humans_known[e, i],
                robots[e, i],
                robots_known[e, i],
                settings.human_margin,
                settings.robot_margin,
                rows,
            )
            walls = room[:, : gather_walls(segments[e, i], segments_seen[e, i], room)]
            _shrink_margins(rows, count, p)
            target_x, target_y = targets[e, i, 0], targets[e, i, 1]
            situation = _Situation(
                rows,
                count,
                1 + humans_known[e, i].sum(),
                walls,
                target_x,
                target_y,
                goal_x == target_x and goal_y == target_y,
            )
            if not _is_safe(situation, action[e, i], scratch_action, settings, p):
                _choose_continuation(
                    situation, action[e, i], first_action, scratch_action, settings, p
                )


@function
def _shrink_margins(rows, count, p):
    """Reduce the margins of agents within them, so that these only must not come closer."""
    for j in range(1, count):
        x, y = rows[j, 0], rows[j, 1]
        available = math.sqrt(x * x + y * y) - p.robot_radius - ROUNDING
        rows[j, 4] = min(rows[j, 4], max(available, _ZERO))


@function
def _is_safe(situation, action, scratch_action, settings, p):
    """Return whether some continuation after `action` is collision-free for the whole horizon."""
    for index in range(CONTINUATIONS):
        for k in range(action.shape[0]):
            scratch_action[k] = action[k]
        continuation = _continuation(index, situation, p)
        safe_steps, _, _ = _simulate(situation, scratch_action, continuation, False, settings, p)
        if safe_steps >= settings.steps:
            return True
    return False


@function
def _choose_continuation(situation, action, first_action, scratch_action, settings, p):
    """Write the first action of the best continuation."""
    vx, vy = situation.rows[0, 2], situation.rows[0, 3]
    speed = math.sqrt(vx * vx + vy * vy)
    longest, best_score = -_ONE, _ZERO
    for index in range(CONTINUATIONS):
        continuation = _continuation(index, situation, p)
        track_velocity(continuation[0], continuation[1], speed, first_action, p, continuation[2])
        for k in range(action.shape[0]):
            scratch_action[k] = first_action[k]
        safe_steps, gap, path_length = _simulate(
            situation, scratch_action, continuation, True, settings, p
        )
        score = min(gap, SUFFICIENT_GAP) - PROGRESS_WEIGHT * path_length
        if safe_steps > longest or (safe_steps == longest and score > best_score + ROUNDING):
            longest, best_score = safe_steps, score
            for k in range(action.shape[0]):
                action[k] = first_action[k]


@function
def _continuation(index, situation, p):
    """Return the velocity (x, y) of a continuation and its turn-in-place angle, rad.

    The first is standing still; the others drive in one of the directions. Directions are counted
    from the target's, so that a robot turning towards one chooses it again in the next step, and
    clockwise, so that two robots facing each other both keep to the right.
    """
    if index == 0:
        return _ZERO, _ZERO, TURN_IN_PLACE_ANGLE
    turn = _TWO_PI * np.float32((index - 1) % DIRECTIONS) / np.float32(DIRECTIONS)
    angle = math.atan2(situation.target_y, situation.target_x) - turn
    kind = (index - 1) // DIRECTIONS
    speed = p.robot_speed * (_HALF if kind == 1 else _ONE)
    turn_in_place_angle = p.max_turn if kind == 2 else TURN_IN_PLACE_ANGLE
    vx, vy = np.float32(speed * math.cos(angle)), np.float32(speed * math.sin(angle))
    return vx, vy, turn_in_place_angle


@function
def _simulate(situation, action, continuation, with_path_length, settings, p):
    """Simulate `action`, which is overwritten, followed by driving as the continuation does.

    Returns:
        The number of collision-free steps, the smallest gap in them (m), and if `with_path_length`
        the shortest remaining path to the target after any of them (m).
    """
    rows, count = situation.rows, situation.row_count
    target_x, target_y = situation.target_x, situation.target_y
    desired_x, desired_y, turn_in_place_angle = continuation
    x, y, vx, vy, heading = _ZERO, _ZERO, rows[0, 2], rows[0, 3], _ZERO
    smallest_gap = path_length = np.float32(np.inf)
    for k in range(settings.steps):
        if k > 0:
            track_rotated_velocity(
                vx, vy, heading, desired_x, desired_y, action, p, turn_in_place_angle
            )
        new_x, new_y, vx, vy, heading = step_robot(x, y, vx, vy, heading, action, p)
        gap = _smallest_gap(
            rows,
            count,
            situation.walls,
            situation.first_robot,
            x,
            y,
            new_x,
            new_y,
            k,
            settings.uncertain_steps,
            p,
        )
        if gap < _ZERO:
            return np.float32(k) + max(_ONE + gap, _ZERO), _ZERO, path_length
        smallest_gap = min(smallest_gap, gap)
        x, y = new_x, new_y
        if with_path_length:
            path_length = min(
                path_length,
                remaining_path_length(rows, count, x, y, heading, target_x, target_y, p),
            )
        dx, dy = target_x - x, target_y - y
        if situation.target_is_goal and dx * dx + dy * dy < p.robot_radius * p.robot_radius:
            break
    return np.float32(settings.steps), smallest_gap, path_length


@function
def _smallest_gap(rows, count, walls, first_robot, x, y, new_x, new_y, step, uncertain_steps, p):
    """Return the smallest surface distance while driving straight from (x, y) during one step.

    Everybody moves at constant velocity. A team-mate may also stop, as it does on arrival, or
    mirror this robot's change of velocity, since both decide at the same time.
    """
    start = np.float32(step) * p.time_step
    end = start + p.time_step
    stop_time = _HALF * p.time_step  # braking covers the distance of half a step at full velocity
    smallest = np.float32(np.inf)
    if walls.shape[1] > 0:
        smallest = way_distance(walls, walls.shape[1], x, y, new_x - x, new_y - y)
    for j in range(1, count):
        px, py, vx, vy = rows[j, 0], rows[j, 1], rows[j, 2], rows[j, 3]
        distance = closest_approach(
            px + vx * start - x,
            py + vy * start - y,
            px + vx * end - new_x,
            py + vy * end - new_y,
        )
        if j >= first_robot and step < uncertain_steps:
            moving_time = min(start, stop_time)
            distance = min(
                distance,
                closest_approach(
                    px + vx * moving_time - x,
                    py + vy * moving_time - y,
                    px + vx * stop_time - new_x,
                    py + vy * stop_time - new_y,
                ),
                closest_approach(
                    px + (vx + rows[0, 2]) * start - _TWO * x,
                    py + (vy + rows[0, 3]) * start - _TWO * y,
                    px + (vx + rows[0, 2]) * end - _TWO * new_x,
                    py + (vy + rows[0, 3]) * end - _TWO * new_y,
                ),
            )
        smallest = min(smallest, distance - rows[j, 4])
    return smallest - p.robot_radius
