"""A shield for the last moment: it replaces actions after which one can hardly avoid a collision.

The least restrictive kind (Alshiekh et al., Safe Reinforcement Learning via Shielding, 2018): an
action passes as long as some way of going on from it keeps clear of everybody's prediction. Else
the robot takes the way that stays clear the longest; of those that stay clear, one that keeps some
distance and leads on to the goal, round whoever stands in between.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from mrsan import Observation, Scenario
from mrsan.features import GOAL_X, GOAL_Y
from mrsan.fields import check_numbers, number, setting
from mrsan.kernels import function, kernel
from mrsan.kernels.contact import closest_approach
from mrsan.parameters import kernel_parameters
from samarl.observations.tracker import Tracks
from samarl.planning.detour import way_left
from samarl.planning.foresight import STRAIGHT, gather_aside, straight_on
from samarl.planning.tracking import SHARP, gather, move, steer, track_velocity

DIRECTIONS = 16  # of the ways of going on: at full speed, at half, and turning on the spot first
WAYS = 1 + 3 * DIRECTIONS
ENOUGH = np.float32(0.3)  # no way is better for keeping further away than that, m
HAIR = np.float32(1e-4)  # what is not for rounding, m
TEAM_MATE_UNCERTAIN = 0.75  # s in which a team-mate may change its plans; later is seen in time
PROGRESS = np.float32(0.3)  # distance that is given for a metre nearer to the goal, m

_ZERO = np.float32(0.0)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_TWO_PI = np.float32(2.0 * math.pi)


@dataclass
class Shield:
    """The numbers of the shield; chosen on validation cases."""

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
    predictor: str = setting(
        STRAIGHT, help="predictor of the people in view: a name or a weights file"
    )

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: names the field, its value and its range.
        """
        check_numbers(self, "agent.shield")


def shielded(
    known: Observation | Tracks, action: NDArray[np.float32], scenario: Scenario, shield: Shield,
    aside: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:  # fmt: skip
    """The actions [E, N, A], each of them replaced where it leads into a collision.

    Args:
        known: what every robot sees, or sees and remembers.
        action: [E, N, A] in [-1, 1].
        scenario: the dynamics.
        shield: its numbers.
        aside: by how much people will be elsewhere than at constant velocity, as
            `Foresight.update` says; None: not at all.
    """
    checked = np.array(action, np.float32)
    margins = np.float32(shield.human_margin), np.float32(shield.robot_margin)
    aside = straight_on(known[2]) if aside is None else aside
    steps = max(1, scenario.steps(shield.horizon)), scenario.steps(TEAM_MATE_UNCERTAIN)
    _check(len(checked), *known[:5], aside, kernel_parameters(scenario), *steps, *margins, checked)
    return checked


@kernel
def _check(
    chunks,
    ego,
    humans,
    humans_known,
    robots,
    robots_known,
    aside,
    p,
    steps,
    uncertain_steps,
    human_margin,
    robot_margin,
    action,
):
    total = ego.shape[0]
    for chunk in prange(chunks):
        rows = np.empty((1 + humans.shape[2] + robots.shape[2], 5), np.float32)
        bends = np.zeros((rows.shape[0], aside.shape[3], 2), np.float32)
        first = np.empty(action.shape[2], np.float32)
        attempt = np.empty(action.shape[2], np.float32)
        for e in range(chunk * total // chunks, (chunk + 1) * total // chunks):
            for i in range(ego.shape[1]):
                goal_x, goal_y = ego[e, i, GOAL_X], ego[e, i, GOAL_Y]
                if goal_x * goal_x + goal_y * goal_y < p.robot_radius * p.robot_radius:
                    continue  # it has arrived
                count = gather(
                    ego[e, i],
                    humans[e, i],
                    humans_known[e, i],
                    robots[e, i],
                    robots_known[e, i],
                    human_margin,
                    robot_margin,
                    rows,
                )
                mates = gather_aside(humans_known[e, i], aside[e, i], bends)
                _allow_for_nearness(rows, count, p)
                if not _passes(
                    rows,
                    bends,
                    count,
                    mates,
                    goal_x,
                    goal_y,
                    steps,
                    uncertain_steps,
                    action[e, i],
                    attempt,
                    p,
                ):
                    _escape(
                        rows,
                        bends,
                        count,
                        mates,
                        goal_x,
                        goal_y,
                        steps,
                        uncertain_steps,
                        action[e, i],
                        first,
                        attempt,
                        p,
                    )


@function
def _allow_for_nearness(rows, count, p):
    """Take off the margins what is not there: who is too near already must not come nearer."""
    for j in range(1, count):
        x, y = rows[j, 0], rows[j, 1]
        room = math.sqrt(x * x + y * y) - p.robot_radius - HAIR
        rows[j, 4] = min(rows[j, 4], max(room, _ZERO))


@function
def _passes(rows, bends, count, mates, goal_x, goal_y, steps, uncertain_steps, action, attempt, p):
    """Whether some way of going on after `action` stays clear."""
    for way in range(WAYS):
        vx, vy, sharp = _way(way, goal_x, goal_y, p)
        for k in range(action.shape[0]):
            attempt[k] = action[k]
        clear, _, _ = _outlook(
            rows,
            bends,
            count,
            mates,
            goal_x,
            goal_y,
            vx,
            vy,
            sharp,
            steps,
            uncertain_steps,
            attempt,
            False,
            p,
        )
        if clear >= steps:
            return True
    return False


@function
def _escape(
    rows, bends, count, mates, goal_x, goal_y, steps, uncertain_steps, action, first, attempt, p
):
    """Write the first action of the best way."""
    speed = math.sqrt(rows[0, 2] * rows[0, 2] + rows[0, 3] * rows[0, 3])
    longest, best = -_ONE, _ZERO
    for way in range(WAYS):
        vx, vy, sharp = _way(way, goal_x, goal_y, p)
        track_velocity(vx, vy, speed, first, p, sharp)
        for k in range(action.shape[0]):
            attempt[k] = first[k]
        clear, gap, left = _outlook(
            rows,
            bends,
            count,
            mates,
            goal_x,
            goal_y,
            vx,
            vy,
            sharp,
            steps,
            uncertain_steps,
            attempt,
            True,
            p,
        )
        merit = min(gap, ENOUGH) - PROGRESS * left
        if clear > longest or (clear == longest and merit > best + HAIR):
            longest, best = clear, merit
            for k in range(action.shape[0]):
                action[k] = first[k]


@function
def _way(way, goal_x, goal_y, p):
    """A way of going on: standing, or in one of the directions.

    They are counted from the goal's, so a robot that turns towards one finds it again; clockwise,
    so two robots that stand face to face both keep to the right.

    Returns:
        Its velocity (x, y), and beyond which turn the robot turns on the spot, rad.
    """
    if way == 0:
        return _ZERO, _ZERO, SHARP
    turn = _TWO_PI * np.float32((way - 1) % DIRECTIONS) / np.float32(DIRECTIONS)
    angle = math.atan2(goal_y, goal_x) - turn
    kind = (way - 1) // DIRECTIONS
    speed = p.robot_speed * (_HALF if kind == 1 else _ONE)
    sharp = p.max_turn if kind == 2 else SHARP
    return np.float32(speed * math.cos(angle)), np.float32(speed * math.sin(angle)), sharp


@function
def _outlook(
    rows,
    bends,
    count,
    mates,
    goal_x,
    goal_y,
    wanted_x,
    wanted_y,
    sharp,
    steps,
    uncertain_steps,
    action,
    judged,
    p,
):
    """What comes of taking `action`, which is overwritten, and then driving at a velocity.

    Rows from `mates` on are team-mates.

    Returns:
        The steps that stay clear, the smallest gap in them (m), and if `judged` the shortest way
        that is left to the goal after any of them (m).
    """
    x, y, vx, vy, heading = _ZERO, _ZERO, rows[0, 2], rows[0, 3], _ZERO
    least = left = np.float32(np.inf)
    for k in range(steps):
        if k > 0:
            steer(vx, vy, heading, wanted_x, wanted_y, action, p, sharp)
        new_x, new_y, vx, vy, heading = move(x, y, vx, vy, heading, action, p)
        gap = _least_gap(rows, bends, count, mates, x, y, new_x, new_y, k, uncertain_steps, p)
        if gap < _ZERO:
            return np.float32(k) + max(_ONE + gap, _ZERO), _ZERO, left
        least = min(least, gap)
        x, y = new_x, new_y
        if judged:
            left = min(left, way_left(rows, count, x, y, heading, goal_x, goal_y, p))
        left_x, left_y = goal_x - x, goal_y - y
        if left_x * left_x + left_y * left_y < p.robot_radius * p.robot_radius:
            break
    return np.float32(steps), least, left


@function
def _least_gap(rows, bends, count, mates, x, y, new_x, new_y, step, uncertain_steps, p):
    """The smallest surface distance while driving straight from (x, y) in one step.

    Everybody goes on at constant velocity, but for what `bends` adds to it. A team-mate may also
    stop, as those do that arrive, or change its velocity as much as this robot does and against it,
    as both decide at the same time.
    """
    begin = np.float32(step) * p.time_step
    end = begin + p.time_step
    stopped = _HALF * p.time_step  # it is as far as if it had gone on for so long
    now, then = min(step, bends.shape[1] - 1), min(step + 1, bends.shape[1] - 1)
    least = np.float32(np.inf)
    for j in range(1, count):
        px, py, vx, vy = rows[j, 0], rows[j, 1], rows[j, 2], rows[j, 3]
        distance = closest_approach(
            px + vx * begin + bends[j, now, 0] - x,
            py + vy * begin + bends[j, now, 1] - y,
            px + vx * end + bends[j, then, 0] - new_x,
            py + vy * end + bends[j, then, 1] - new_y,
        )
        if j >= mates and step < uncertain_steps:
            still = min(begin, stopped)
            distance = min(
                distance,
                closest_approach(
                    px + vx * still - x,
                    py + vy * still - y,
                    px + vx * stopped - new_x,
                    py + vy * stopped - new_y,
                ),
                closest_approach(
                    px + (vx + rows[0, 2]) * begin - _TWO * x,
                    py + (vy + rows[0, 3]) * begin - _TWO * y,
                    px + (vx + rows[0, 2]) * end - _TWO * new_x,
                    py + (vy + rows[0, 3]) * end - _TWO * new_y,
                ),
            )
        least = min(least, distance - rows[j, 4])
    return least - p.robot_radius
