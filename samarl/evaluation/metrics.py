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
    walled = auto()  # printed and report, of places with walls
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


@metric("robot_success_rate", heading="robots' success %", tables=Tables.driving)
def _robot_success(episodes: Episodes) -> float:
    """Robots that arrived, regardless of the others, %."""
    return _percent(episodes.outcome == Outcome.arrived)


@metric("social_score", "social_low", "social_high", heading="social score")
def _social(episodes: Episodes) -> tuple[float, float, float]:
    """Mean of the social score F, with its interval over episodes."""
    return mean_interval(social_score(episodes).mean(axis=1))


@metric("collision_rate", heading="collision %", tables=Tables.report)
def _collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_human | episodes.hit_robot | episodes.hit_wall)


@metric("human_collision_rate", heading="hit human %")
def _human_collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_human)


@metric("robot_on_person_rate", heading="robot on person %", tables=Tables.driving)
def _robot_on_person(episodes: Episodes) -> float:
    """Episodes in which a robot hit a human and approached it the faster of the two, %."""
    return _percent(episodes.robot_on_person)


@metric("person_on_robot_rate", heading="person on robot %", tables=Tables.driving)
def _person_on_robot(episodes: Episodes) -> float:
    """Episodes in which they hit each other and the human approached faster, %."""
    return _percent(episodes.person_on_robot)


@metric("robot_collision_rate", heading="hit robot %", tables=Tables.everywhere)
def _robot_collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_robot)


@metric("wall_collision_rate", heading="hit wall %", tables=Tables.walled)
def _wall_collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_wall)


@metric("deadlock_rate", heading="deadlock %", tables=Tables.walled)
def _deadlock(episodes: Episodes) -> float:
    """Episodes in which every robot that had not arrived stood still for 10 s, %."""
    return _percent(episodes.deadlock)


@metric("makespan", heading="makespan s", tables=Tables.walled)
def _makespan(episodes: Episodes) -> Value:
    """Time until the last robot arrived, mean over the successful episodes, s."""
    return _mean(episodes.duration[episodes.success])


@metric("flow_rate", heading="robots / min", tables=Tables.walled)
def _flow_rate(episodes: Episodes) -> Value:
    """Robots that arrive per minute until the last one does, mean over successful episodes.

    In a doorway or a corridor every robot passes the opening once, so this is the flow through it.
    """
    robots = episodes.outcome.shape[1]
    return _mean(60.0 * robots / episodes.duration[episodes.success])


@metric("path_ratio", heading="path ratio", form="{:.2f}", decimals=3, tables=Tables.walled)
def _path_ratio(episodes: Episodes) -> Value:
    """Path driven over the shortest route, mean over the robots that arrived."""
    arrived = episodes.outcome == Outcome.arrived
    return _mean(episodes.path_length[arrived] / episodes.shortest_path[arrived])


@metric("timeout_rate", heading="timeout %")
def _timeout(episodes: Episodes) -> float:
    return _percent(episodes.timeout)


@metric("path_length", heading="path m")
def _path_length(episodes: Episodes) -> Value:
    """Mean over the robots that arrived, m."""
    return _mean(episodes.path_length[episodes.outcome == Outcome.arrived])


@metric("time_to_goal", heading="time s")
def _time_to_goal(episodes: Episodes) -> Value:
    """Mean over the robots that arrived, s."""
    return _mean(episodes.time[episodes.outcome == Outcome.arrived])


@metric("closest_human", heading="nearest m", form="{:.2f}", decimals=3, tables=Tables.report)
def _closest_human(episodes: Episodes) -> Value:
    """Median over robots and episodes with at least one human, m."""
    distance = episodes.closest_human[np.isfinite(episodes.closest_human)]
    return float(np.median(distance)) if distance.size else None


@metric("csr", heading="CSR %", tables=Tables.counted)
def _csr(episodes: Episodes) -> float:
    """Episodes in which every robot arrived in time, even after collisions (MSA3C), %."""
    return 100 * float(episodes.arrived.all(axis=1).mean())


@metric("cr", heading="CR %", tables=Tables.counted)
def _cr(episodes: Episodes) -> float:
    """Collisions per episode (MSA3C), %."""
    return 100 * float(episodes.contacts.sum(axis=1).mean())


@metric("apl", heading="APL m", tables=Tables.counted)
def _apl(episodes: Episodes) -> Value:
    """Total path length of all robots, mean over the episodes in which all arrived (MSA3C), m."""
    return _mean(episodes.path_length.sum(axis=1)[episodes.arrived.all(axis=1)])


@metric("ntc", heading="NTC", tables=Tables.counted)
def _ntc(episodes: Episodes) -> Value:
    """Steps until the last robot arrived, mean over the episodes in which all did (MSA3C)."""
    return _mean(episodes.steps[episodes.arrived.all(axis=1)])


@metric("cir", heading="CIR %", tables=Tables.counted)
def _cir(episodes: Episodes) -> float:
    """Share of the steps of all robots within 0.25 m of a human (MSA3C), %."""
    return 100 * float(np.average(episodes.comfort_share, weights=episodes.time))


@metric("close_share", heading="close %", tables=Tables.report | Tables.driving)
def _close_share(episodes: Episodes) -> float:
    """Share of a robot's steps in the intimate space of a human, 0.45 m (Hall, 1966), %."""
    return _percent(episodes.close_share)


@metric("personal_share", heading="personal %", tables=Tables.driving)
def _personal_share(episodes: Episodes) -> float:
    """Share of a robot's steps 0.45 to 1.2 m from the nearest human (Hall, 1966), %."""
    return _percent(episodes.personal_share)


@metric("social_share", heading="social %", tables=Tables.driving)
def _social_share(episodes: Episodes) -> float:
    """Share of a robot's steps 1.2 to 3.6 m from the nearest human (Hall, 1966), %."""
    return _percent(episodes.social_share)


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


@metric("jerk", heading="jerk m/s³", tables=Tables.report)
def _jerk(episodes: Episodes) -> float:
    """Mean norm of the jerk, m/s^3."""
    return float(episodes.jerk.mean())


@metric("standing_share", heading="not moving %", tables=Tables.driving)
def _standing_share(episodes: Episodes) -> float:
    """Share of a robot's steps slower than 0.05 m/s (HuNavSim's time not moving), %."""
    return _percent(episodes.standing_share)


@metric("heading_change", heading="heading change rad", form="{:.2f}", tables=Tables.driving)
def _heading_change(episodes: Episodes) -> Value:
    """Sum of absolute changes of heading, mean over the robots that arrived, rad (HuNavSim)."""
    return _mean(episodes.heading_change[episodes.outcome == Outcome.arrived])


@metric(
    "path_irregularity",
    heading="irregularity rad/m",
    form="{:.2f}",
    decimals=3,
    tables=Tables.driving,
)
def _path_irregularity(episodes: Episodes) -> Value:
    """Turning per metre driven, mean over the robots that arrived (Guzzi et al., 2013), rad/m.

    Guzzi et al. subtract the turning needed for the straight path, which is zero for robots that
    start with their heading towards the goal.
    """
    arrived = episodes.outcome == Outcome.arrived
    return _mean(episodes.heading_change[arrived] / episodes.path_length[arrived])


def _percent(share: NDArray[np.bool_] | NDArray[np.float64]) -> float:
    return 100 * float(share.mean())


def _mean(values: NDArray[Any]) -> Value:
    return float(values.mean()) if values.size else None
