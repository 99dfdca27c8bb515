"""Records of episodes and the measures derived from them."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels.step import HIT_HUMAN, HIT_ROBOT, HIT_WALL, PERSONAL_SPACE
from mrsan.kernels.tally import TALLY
from mrsan.scenario import Scenario
from mrsan.state import State


class Outcome(IntEnum):
    """How an episode ended for one robot; a collision takes precedence over arrival."""

    arrived = 0
    hit_human = HIT_HUMAN
    hit_robot = HIT_ROBOT
    timeout = 3  # had not arrived at the time limit
    interrupted = 4  # had not arrived when a team-mate collided
    hit_wall = HIT_WALL


class Episodes(NamedTuple):
    """Records of B episodes of N robots."""

    case: NDArray[np.int64]  # [B]
    episode: NDArray[np.int64]  # [B]
    duration: NDArray[np.float64]  # [B] s
    outcome: NDArray[np.int8]  # [B, N] Outcome
    path_length: NDArray[np.float64]  # [B, N] length of the path driven, m
    straight_line: NDArray[np.float64]  # [B, N] from start to goal, m
    shortest_path: NDArray[np.float64]  # [B, N] the same round walls, m
    time: NDArray[np.float64]  # [B, N] time until arrival or the end of the episode, s
    closest_human: NDArray[np.float64]  # [B, N] surface distance, also within steps, m; or inf
    close_share: NDArray[np.float64]  # [B, N] share of steps within 0.45 m of the nearest human
    personal_share: NDArray[np.float64]  # [B, N] share of steps from 0.45 to 1.2 m
    social_share: NDArray[np.float64]  # [B, N] share of steps from 1.2 to 3.6 m
    standing_share: NDArray[np.float64]  # [B, N] share of steps slower than 0.05 m/s
    jerk: NDArray[np.float64]  # [B, N] mean norm, m/s^3
    heading_change: NDArray[np.float64]  # [B, N] sum of absolute turns, rad
    min_time_to_collision: NDArray[np.float64]  # [B, N] smallest time to collision with a human, s
    robot_at_fault: NDArray[np.bool_]  # [B, N] it hit a human that did not approach faster
    steps: NDArray[np.int64]  # [B]
    arrived: NDArray[np.bool_]  # [B, N] in time, regardless of collisions
    contacts: NDArray[np.float64]  # [B, N] beginnings of contacts; two robots share one
    comfort_share: NDArray[np.float64]  # [B, N] share of steps within 0.25 m of a human
    deadlock: NDArray[np.bool_]  # [B] every driving robot stood still for 10 s
    intrusion_share: NDArray[np.float64]  # [B, N] share of steps in a group; NaN without groups

    @property
    def success(self) -> NDArray[np.bool_]:
        """Return whether all robots arrived without a collision, [B] (SAMARL's joint success)."""
        return (self.outcome == Outcome.arrived).all(axis=1)

    @property
    def hit_human(self) -> NDArray[np.bool_]:
        """Return whether a robot and a human collided, [B]."""
        return (self.outcome == Outcome.hit_human).any(axis=1)

    @property
    def robot_on_person(self) -> NDArray[np.bool_]:
        """Return whether a robot hit a human, approaching at least as fast as the human, [B]."""
        return ((self.outcome == Outcome.hit_human) & self.robot_at_fault).any(axis=1)

    @property
    def person_on_robot(self) -> NDArray[np.bool_]:
        """Return whether a human hit a robot, approaching faster than the robot, [B]."""
        return ((self.outcome == Outcome.hit_human) & ~self.robot_at_fault).any(axis=1)

    @property
    def hit_robot(self) -> NDArray[np.bool_]:
        """Return whether two robots collided, [B]."""
        return (self.outcome == Outcome.hit_robot).any(axis=1)

    @property
    def hit_wall(self) -> NDArray[np.bool_]:
        """Return whether a robot hit a wall, [B]."""
        return (self.outcome == Outcome.hit_wall).any(axis=1)

    @property
    def timeout(self) -> NDArray[np.bool_]:
        """Return whether the time limit ended the episode for a robot, [B]."""
        return (self.outcome == Outcome.timeout).any(axis=1)


def episodes_of(state: State, scenario: Scenario, worlds: NDArray[np.bool_]) -> Episodes:
    """Return the records of the worlds of a mask [E]; all of them must have ended."""
    rows = np.flatnonzero(worlds)  # faster to index with than a mask
    collision, arrived, clock = state.collision[rows], state.arrived[rows], state.clock[rows]
    ended_by_time = state.truncated[rows][:, None]
    unfinished = np.where(ended_by_time, Outcome.timeout, Outcome.interrupted)
    outcome = np.where(arrived, Outcome.arrived, unfinished)
    outcome = np.where(collision != 0, collision, outcome).astype(np.int8)
    columns = np.moveaxis(state.tally[rows], -1, 0).astype(np.float64, order="C")
    tally = dict(zip(TALLY, columns, strict=True))
    per_step = dict(zip(TALLY, columns / np.maximum(tally["driven_steps"], 1.0), strict=True))
    to_goal = (state.robot_goal[rows] - state.robot_start[rows]).astype(np.float64)
    straight_line = np.sqrt(np.square(to_goal).sum(-1))
    return Episodes(
        case=state.case[rows],
        episode=state.episode[rows],
        duration=clock.astype(np.float64) * scenario.time_step,
        outcome=outcome,
        path_length=tally["path_length"],
        straight_line=straight_line,
        shortest_path=state.route_length[rows].astype(np.float64)
        if scenario.has_walls
        else straight_line,
        time=tally["driven_steps"] * scenario.time_step,
        closest_human=tally["closest_human"],
        close_share=per_step["close_steps"],
        personal_share=per_step["personal_steps"],
        social_share=per_step["social_steps"],
        standing_share=per_step["standing_steps"],
        jerk=per_step["jerk_sum"],
        heading_change=tally["heading_change"],
        min_time_to_collision=tally["min_time_to_collision"],
        robot_at_fault=tally["ran_into"] > 0,
        steps=clock.astype(np.int64),
        arrived=arrived,
        contacts=tally["contacts"],
        comfort_share=per_step["comfort_steps"],
        deadlock=(tally["deadlocks"] > 0).any(axis=1),
        intrusion_share=per_step["intrusion_steps"]
        if scenario.groups.share > 0.0
        else np.full(arrived.shape, np.nan),
    )


def social_score(episodes: Episodes) -> NDArray[np.float64]:
    """Return the social score F of each robot, [B, N], 0 to 100 (our form of SAMARL, Eq. 11).

    F = 100 A (P / 2 + C / 2): A is arrival; P is the shortest path over the path driven; C is half
    the closest approach to a human (up to 0.45 m) and half the share of steps outside personal
    space. The paper does not define F, and its column is on another scale.
    """
    arrived = episodes.outcome == Outcome.arrived
    path = episodes.shortest_path / np.maximum(episodes.path_length, episodes.shortest_path)
    approach = np.clip(episodes.closest_human / PERSONAL_SPACE, 0.0, 1.0)
    comfort = 0.5 * approach + 0.5 * (1.0 - episodes.close_share)
    return 100.0 * arrived * (0.5 * path + 0.5 * comfort)
