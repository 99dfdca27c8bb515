"""Metrics of a set of episodes, each a registered function.

A metric fills fields of a table row. With a heading it is also a column of tables and the report.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Outcome, PluginError, social_score

Value = float | None  # None: undefined, as there is nothing to measure
Measure = Callable[[Episodes], Any]  # returns a value, or a tuple with one per field

_Z95 = 1.959963984540054  # 97.5 % quantile of the normal distribution
_MAX_TIME_TO_COLLISION = 10.0  # longer times count as this, s


class Tables(Flag):
    """Tables in which a metric has a column."""

    printed = auto()  # of the commands and of results/*.md
    report = auto()  # of the report
    driving = auto()  # of the report, on how the robots drive
    counted = auto()  # printed and report, if collisions do not end the episode
    walled = auto()  # printed and report, of walled environments
    grouped = auto()  # printed and report, if there are groups of people
    everywhere = printed | report | driving


@dataclass(frozen=True)
class Metric:
    """A metric of a row."""

    fields: tuple[str, ...]  # of the row; the first holds the metric itself
    heading: str  # of its column; empty: the metric is in the files only
    form: str  # format string of a cell, for `str.format`
    decimals: int  # in the files
    measure: Measure
    tables: Tables = Tables.printed | Tables.report

    def row_fields(self, episodes: Episodes) -> dict[str, Value]:
        """Return the fields of this metric in a row, rounded.

        Raises:
            PluginError: `measure` returns another number of values than there are fields, or one
                that is neither a finite number nor None.
        """
        result = self.measure(episodes)
        values = result if isinstance(result, tuple) else (result,)
        if len(values) != len(self.fields):
            raise PluginError(
                f"metric {self.fields[0]} returns {len(values)} values; it must return "
                f"{len(self.fields)}: {', '.join(self.fields)}"
            )
        for name, value in zip(self.fields, values, strict=True):
            is_number = isinstance(value, int | float | np.number)
            if value is not None and not (is_number and math.isfinite(value)):
                raise PluginError(
                    f"metric {name} is {value!r:.60}; it must be a finite number, or None"
                )
        return {
            name: None if value is None else round(float(value), self.decimals)
            for name, value in zip(self.fields, values, strict=True)
        }

    def cell(self, row: dict[str, Any]) -> str:
        """Return the cell of a row: `-` for undefined values, empty if the row lacks the metric."""
        values = [row.get(name) for name in self.fields]
        if self.fields[0] not in row:
            return ""
        return "-" if values[0] is None else self.form.format(*values)


METRICS: dict[str, Metric] = {}  # by first field, in the order of the fields in a row


def metric(
    *fields: str,
    heading: str,
    form: str = "{:.1f}",
    decimals: int = 2,
    tables: Tables = Tables.printed | Tables.report,
) -> Callable[[Measure], Measure]:
    """Return a decorator that registers a function of the episodes as a metric.

    Args:
        *fields: names of its values in a row.
        heading: heading of its column; empty: the metric is in the files only.
        form: format string of a cell, for `str.format`.
        decimals: number of decimals in the files.
        tables: tables in which it has a column.

    Raises:
        ValueError: another metric has a field of the same name.
    """

    def register(measure: Measure) -> Measure:
        for name in fields:
            if name in metric_fields():
                raise ValueError(f"metric field {name!r} is already registered")
        METRICS[fields[0]] = Metric(fields, heading, form, decimals, measure, tables)
        return measure

    return register


def metric_fields() -> list[str]:
    """Return the fields of all metrics, in the order of the fields in a row."""
    return [name for metric in METRICS.values() for name in metric.fields]


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a rate as fractions (Wilson, 1927).

    Examples:
        >>> low, high = wilson_interval(450, 500)
        >>> round(low, 3), round(high, 3)
        (0.871, 0.923)
    """
    share, z2 = successes / trials, _Z95**2
    centre = (share + z2 / (2 * trials)) / (1 + z2 / trials)
    half = math.sqrt(share * (1 - share) / trials + z2 / (4 * trials**2)) / (1 + z2 / trials)
    half *= _Z95
    # At rates of 0 and 1 one bound equals the rate; rounding must not push it beyond.
    return min(max(centre - half, 0.0), share), max(min(centre + half, 1.0), share)


def mean_interval(scores: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the mean of scores [B] in [0, 100] and its 95 % interval (normal approximation)."""
    mean, half = float(scores.mean()), _Z95 * float(scores.std()) / math.sqrt(len(scores))
    return mean, max(mean - half, 0.0), min(mean + half, 100.0)


@metric(
    "success_rate",
    "success_low",
    "success_high",
    heading="success % [95 %]",
    form="{:.1f} [{:.1f}, {:.1f}]",
    tables=Tables.everywhere,
)
def _success(episodes: Episodes) -> tuple[float, float, float]:
    """Episodes in which every robot arrived and nobody collided, %, with the Wilson interval."""
    success = episodes.success
    low, high = wilson_interval(int(success.sum()), len(success))
    return _percent(success), 100 * low, 100 * high


def _percent(share: Any) -> float:
    return 100 * float(share.mean())


def _rate(
    field: str,
    heading: str,
    share: Callable[[Episodes], Any],
    tables: Tables = Tables.printed | Tables.report,
) -> None:
    """Register the mean of booleans or shares, in %."""
    metric(field, heading=heading, tables=tables)(lambda episodes: _percent(share(episodes)))


def _average(
    field: str,
    heading: str,
    values: Callable[[Episodes], NDArray[Any]],
    tables: Tables = Tables.printed | Tables.report,
    form: str = "{:.1f}",
    decimals: int = 2,
) -> None:
    """Register the mean of values, which is undefined if there are none."""

    def measure(episodes: Episodes) -> Value:
        selected = values(episodes)
        return float(selected.mean()) if selected.size else None

    metric(field, heading=heading, form=form, decimals=decimals, tables=tables)(measure)


def _arrived(episodes: Episodes) -> NDArray[np.bool_]:
    return episodes.outcome == Outcome.arrived


_rate("robot_success_rate", "robots' success %", _arrived, Tables.driving)


@metric("social_score", "social_low", "social_high", heading="social score")
def _social(episodes: Episodes) -> tuple[float, float, float]:
    """Mean of the social score F, with its interval over episodes."""
    return mean_interval(social_score(episodes).mean(axis=1))


_rate(
    "collision_rate", "collision %", lambda e: e.hit_human | e.hit_robot | e.hit_wall, Tables.report
)
_rate("human_collision_rate", "hit human %", lambda e: e.hit_human)
# Who approached faster when a robot and a human hit each other:
_rate("robot_on_person_rate", "robot on person %", lambda e: e.robot_on_person, Tables.driving)
_rate("person_on_robot_rate", "person on robot %", lambda e: e.person_on_robot, Tables.driving)
_rate("robot_collision_rate", "hit robot %", lambda e: e.hit_robot, Tables.everywhere)
_rate("wall_collision_rate", "hit wall %", lambda e: e.hit_wall, Tables.walled)
# Every robot that had not arrived stood still for 10 s:
_rate("deadlock_rate", "deadlock %", lambda e: e.deadlock, Tables.walled)
# Time until the last robot arrived in the successful episodes, s:
_average("makespan", "makespan s", lambda e: e.duration[e.success], Tables.walled)
# Robots that arrive per minute until the last one does, in the successful episodes. In a doorway or
# a corridor every robot passes the opening once, so this is the flow through it.
_average(
    "flow_rate",
    "robots / min",
    lambda e: 60.0 * e.outcome.shape[1] / e.duration[e.success],
    Tables.walled,
)
# Path driven over the shortest route, of the robots that arrived:
_average(
    "path_ratio",
    "path ratio",
    lambda e: e.path_length[_arrived(e)] / e.shortest_path[_arrived(e)],
    Tables.walled,
    "{:.2f}",
    decimals=3,
)
_rate("timeout_rate", "timeout %", lambda e: e.timeout)
_average("path_length", "path m", lambda e: e.path_length[_arrived(e)])
_average("time_to_goal", "time s", lambda e: e.time[_arrived(e)])


@metric("closest_human", heading="nearest m", form="{:.2f}", decimals=3, tables=Tables.report)
def _closest_human(episodes: Episodes) -> Value:
    """Median over robots and episodes with at least one human, m."""
    distance = episodes.closest_human[np.isfinite(episodes.closest_human)]
    return float(np.median(distance)) if distance.size else None


# Metrics of MSA3C: episodes in which every robot arrived in time, even after collisions; collisions
# per episode; total path length (m) and steps in the episodes in which all arrived; and the share
# of all steps within 0.25 m of a human.
_rate("csr", "CSR %", lambda e: e.arrived.all(axis=1), Tables.counted)
_rate("cr", "CR %", lambda e: e.contacts.sum(axis=1), Tables.counted)
_average("apl", "APL m", lambda e: e.path_length.sum(axis=1)[e.arrived.all(axis=1)], Tables.counted)
_average("ntc", "NTC", lambda e: e.steps[e.arrived.all(axis=1)], Tables.counted)
_rate("cir", "CIR %", lambda e: np.average(e.comfort_share, weights=e.time), Tables.counted)
# Shares of a robot's steps up to 0.45 m from the nearest human, to 1.2 m and to 3.6 m (Hall, 1966):
_rate("close_share", "close %", lambda e: e.close_share, Tables.report | Tables.driving)
_rate("personal_share", "personal %", lambda e: e.personal_share, Tables.driving)
_rate("social_share", "social %", lambda e: e.social_share, Tables.driving)


@metric("min_time_to_collision", heading="soonest collision s", decimals=3, tables=Tables.driving)
def _min_time_to_collision(episodes: Episodes) -> Value:
    """Minimum time to collision with a human at constant velocities (Francis et al.).

    Median over robots and episodes with at least one human, at most 10 s.
    """
    seconds = episodes.min_time_to_collision[np.isfinite(episodes.closest_human)]
    return float(np.median(np.minimum(seconds, _MAX_TIME_TO_COLLISION))) if seconds.size else None


@metric("group_intrusion_rate", heading="in a group %", tables=Tables.grouped)
def _group_intrusion(episodes: Episodes) -> Value:
    """Episodes in which a robot was inside a group of people, %; undefined without groups."""
    share = episodes.intrusion_share
    return None if np.isnan(share).any() else _percent(share.max(axis=1) > 0)


@metric("group_intrusion_share", heading="", tables=Tables.grouped)
def _group_intrusion_share(episodes: Episodes) -> Value:
    """Share of a robot's steps inside a group of people, %; undefined without groups."""
    share = episodes.intrusion_share
    return None if np.isnan(share).any() else _percent(share)


_average("jerk", "jerk m/s³", lambda e: e.jerk, Tables.report)  # norm, m/s^3
# Share of a robot's steps slower than 0.05 m/s (HuNavSim's time not moving):
_rate("standing_share", "not moving %", lambda e: e.standing_share, Tables.driving)
# Sum of absolute changes of heading of the robots that arrived, rad (HuNavSim):
_average(
    "heading_change",
    "heading change rad",
    lambda e: e.heading_change[_arrived(e)],
    Tables.driving,
    "{:.2f}",
)
# Turning per metre driven of the robots that arrived, rad/m. Guzzi et al. (2013) subtract the
# turning needed for the straight path, which is zero for robots that start towards the goal.
_average(
    "path_irregularity",
    "irregularity rad/m",
    lambda e: e.heading_change[_arrived(e)] / e.path_length[_arrived(e)],
    Tables.driving,
    "{:.2f}",
    decimals=3,
)
