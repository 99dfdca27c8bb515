"""What is measured of an episode: pure functions of what happened."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels.step import HIT_HUMAN, HIT_ROBOT, PERSONAL_SPACE
from mrsan.kernels.tally import TALLY
from mrsan.scenario import Scenario
from mrsan.state import State


class Outcome(IntEnum):
    """How an episode ended for one robot; whom it ran into comes before whether it arrived."""

    arrived = 0
    hit_human = HIT_HUMAN
    hit_robot = HIT_ROBOT
    timeout = 3  # still on its way at the time limit
    interrupted = 4  # still on its way when a team-mate collided


class Episodes(NamedTuple):
    """What happened in B episodes of N robots."""

    case: NDArray[np.int64]  # [B]
    episode: NDArray[np.int64]  # [B]
    duration: NDArray[np.float64]  # [B] s
    outcome: NDArray[np.int8]  # [B, N] Outcome
    path_length: NDArray[np.float64]  # [B, N] driven, m
    straight_line: NDArray[np.float64]  # [B, N] from start to goal, m
    time: NDArray[np.float64]  # [B, N] until it arrived or the episode ended, s
    closest_human: NDArray[np.float64]  # [B, N] surface distance, also within steps, m; or inf
    close_share: NDArray[np.float64]  # [B, N] share of its steps within personal space
    personal_share: NDArray[np.float64]  # [B, N] from 0.45 to 1.2 m from the nearest human
    social_share: NDArray[np.float64]  # [B, N] from 1.2 to 3.6 m
    standing_share: NDArray[np.float64]  # [B, N] of its steps slower than 0.05 m/s
    jerk: NDArray[np.float64]  # [B, N] mean norm, m/s^3
    heading_change: NDArray[np.float64]  # [B, N] sum of the turns to either side, rad
    soonest_collision: NDArray[np.float64]  # [B, N] smallest time to one with a human, s; or inf
    ran_into_human: NDArray[np.bool_]  # [B, N] it hit one, and came to it at least as fast
    steps: NDArray[np.int64]  # [B]
    arrived: NDArray[np.bool_]  # [B, N] in time, whatever it hit before
    contacts: NDArray[np.float64]  # [B, N] how often it began to touch somebody; two share one
    comfort_share: NDArray[np.float64]  # [B, N] of its steps within a person's comfort zone

    @property
    def success(self) -> NDArray[np.bool_]:
        """Every robot reached its goal and nobody collided, [B] (SAMARL's joint success)."""
        return (self.outcome == Outcome.arrived).all(axis=1)

    @property
    def hit_human(self) -> NDArray[np.bool_]:
        """Some robot and a human ran into each other, [B]."""
        return (self.outcome == Outcome.hit_human).any(axis=1)

    @property
    def robot_on_person(self) -> NDArray[np.bool_]:
        """Some robot hit a human, and moved towards it at least as fast as it came, [B]."""
        return ((self.outcome == Outcome.hit_human) & self.ran_into_human).any(axis=1)

    @property
    def person_on_robot(self) -> NDArray[np.bool_]:
        """Some human hit a robot, and moved towards it faster than the robot came, [B]."""
        return ((self.outcome == Outcome.hit_human) & ~self.ran_into_human).any(axis=1)

    @property
    def hit_robot(self) -> NDArray[np.bool_]:
        """Some robot ran into another robot, [B]."""
        return (self.outcome == Outcome.hit_robot).any(axis=1)

    @property
    def timeout(self) -> NDArray[np.bool_]:
        """The time limit came first, [B]."""
        return (self.outcome == Outcome.timeout).any(axis=1)


def episodes_of(state: State, scenario: Scenario, worlds: NDArray[np.bool_]) -> Episodes:
    """The records of the worlds whose mask `worlds` [E] is set; all of them must have ended."""
    rows = np.flatnonzero(worlds)  # faster to index with than a mask
    collision, arrived, clock = state.collision[rows], state.arrived[rows], state.clock[rows]
    ended_by_time = state.truncated[rows][:, None]
    on_its_way = np.where(ended_by_time, Outcome.timeout, Outcome.interrupted)
    outcome = np.where(arrived, Outcome.arrived, on_its_way)
    outcome = np.where(collision != 0, collision, outcome).astype(np.int8)
    columns = np.moveaxis(state.tally[rows], -1, 0).astype(np.float64, order="C")
    tally = dict(zip(TALLY, columns, strict=True))
    per_step = dict(zip(TALLY, columns / np.maximum(tally["driven_steps"], 1.0), strict=True))
    to_goal = (state.robot_goal[rows] - state.robot_start[rows]).astype(np.float64)
    return Episodes(
        case=state.case[rows],
        episode=state.episode[rows],
        duration=clock.astype(np.float64) * scenario.time_step,
        outcome=outcome,
        path_length=tally["path_length"],
        straight_line=np.sqrt(np.square(to_goal).sum(-1)),
        time=tally["driven_steps"] * scenario.time_step,
        closest_human=tally["closest_human"],
        close_share=per_step["close_steps"],
        personal_share=per_step["personal_steps"],
        social_share=per_step["social_steps"],
        standing_share=per_step["standing_steps"],
        jerk=per_step["jerk_sum"],
        heading_change=tally["heading_change"],
        soonest_collision=tally["soonest_collision"],
        ran_into_human=tally["ran_into"] > 0,
        steps=clock.astype(np.int64),
        arrived=arrived,
        contacts=tally["contacts"],
        comfort_share=per_step["comfort_steps"],
    )


def social_score(episodes: Episodes) -> NDArray[np.float64]:
    """F of each robot in each episode, [B, N], 0 to 100 (our form of SAMARL, Eq. 11).

    F = 100 A (P / 2 + C / 2): A, it arrived; P, the straight line over the path driven; C, half
    for the closest approach to a human (up to 0.45 m) and half for the share of steps outside
    everybody's personal space. The paper does not define F: its column is on another scale.
    """
    arrived = episodes.outcome == Outcome.arrived
    path = episodes.straight_line / np.maximum(episodes.path_length, episodes.straight_line)
    approach = np.clip(episodes.closest_human / PERSONAL_SPACE, 0.0, 1.0)
    comfort = 0.5 * approach + 0.5 * (1.0 - episodes.close_share)
    return 100.0 * arrived * (0.5 * path + 0.5 * comfort)
