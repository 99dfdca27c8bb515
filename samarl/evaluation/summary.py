"""From episode records to a row of the table."""

from __future__ import annotations

import math
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Outcome, Scenario, social_score

_Z95 = 1.959963984540054  # 97.5 % quantile of the normal distribution


class Row(TypedDict):
    """One method in one column of the table; rates in percent, lengths in m, times in s."""

    method: str
    fov_degrees: float
    humans: int
    robots: int
    episodes: int
    success_rate: float
    success_low: float
    success_high: float
    social_score: float
    social_low: float  # 95 % interval of the mean
    social_high: float
    collision_rate: float
    human_collision_rate: float
    robot_collision_rate: float
    timeout_rate: float
    path_length: float | None  # of robots that arrived; null: none did
    time_to_goal: float | None
    closest_human: float | None  # median over robots and episodes; null: no humans
    close_share: float  # of robot steps within personal space
    jerk: float
    command: str
    commit: str
    seed: int


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % confidence interval of a rate (Wilson, 1927), as shares.

    Example:
        >>> low, high = wilson_interval(450, 500)
        >>> round(low, 3), round(high, 3)
        (0.871, 0.923)
    """
    share, z2 = successes / trials, _Z95**2
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    half *= _Z95
    # At the ends the bound is exact; rounding must not push it past the rate itself.
    return min(max(centre - half, 0.0), share), max(min(centre + half, 1.0), share)


def summarise(
    episodes: Episodes, scenario: Scenario, method: str, command: str, commit: str, seed: int
) -> Row:
    """The row of one method in one scenario.

    Args:
        episodes: what happened.
        scenario: in which task.
        method: the name in the table.
        command: what produces the row again.
        commit: of the code that produced it.
        seed: the first case number.
    """
    trials, success = len(episodes.case), episodes.success
    low, high = wilson_interval(int(success.sum()), trials)
    arrived = episodes.outcome == Outcome.arrived
    seen = np.isfinite(episodes.closest_human)
    scores = social_score(episodes).mean(axis=1)
    social, social_half = float(scores.mean()), _Z95 * float(scores.std()) / math.sqrt(trials)
    return Row(
        method=method,
        fov_degrees=scenario.fov_degrees,
        humans=scenario.humans,
        robots=scenario.robots,
        episodes=trials,
        success_rate=_percent(success),
        success_low=round(100 * low, 2),
        success_high=round(100 * high, 2),
        social_score=round(social, 2),
        social_low=round(max(social - social_half, 0.0), 2),
        social_high=round(min(social + social_half, 100.0), 2),
        collision_rate=_percent(episodes.hit_human | episodes.hit_robot),
        human_collision_rate=_percent(episodes.hit_human),
        robot_collision_rate=_percent(episodes.hit_robot),
        timeout_rate=_percent(episodes.timeout),
        path_length=_mean(episodes.path_length[arrived]),
        time_to_goal=_mean(episodes.time[arrived]),
        closest_human=(
            round(float(np.median(episodes.closest_human[seen])), 3) if seen.any() else None
        ),
        close_share=_percent(episodes.close_share),
        jerk=round(float(episodes.jerk.mean()), 2),
        command=command,
        commit=commit,
        seed=seed,
    )


def _percent(share: NDArray[np.bool_] | NDArray[np.float64]) -> float:
    return round(100 * float(share.mean()), 2)


def _mean(values: NDArray[np.float64]) -> float | None:
    return round(float(values.mean()), 2) if values.size else None
