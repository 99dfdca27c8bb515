"""What is measured of the episodes of a row: one registered function a metric.

Each becomes fields of the row, and with a heading a column of every table and of the report.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Flag, auto
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Outcome, social_score

Value = float | None  # None: there is nothing to measure it of
Measure = Callable[[Episodes], Any]  # a value, or a tuple of one for each field

_Z95 = 1.959963984540054  # 97.5 % quantile of the normal distribution
_FAR_AHEAD = 10.0  # a collision later than this is none to fear, s


class Shown(Flag):
    """The tables in which a metric has a column."""

    printed = auto()  # those that are printed
    report = auto()  # the report's, of all that is measured
    driving = auto()  # the report's other one, of how the robots drive
    counted = auto()  # the first two, where collisions are counted and do not end the episode
    everywhere = printed | report | driving


@dataclass(frozen=True)
class Metric:
    """A metric of a row."""

    fields: tuple[str, ...]  # of the row; the first is the metric itself
    heading: str  # of its column; empty: it stands in the files only
    form: str  # how its values are printed, as of `str.format`
    decimals: int  # to which they are rounded in the files
    measure: Measure
    shown: Shown = Shown.printed | Shown.report

    def of(self, episodes: Episodes) -> dict[str, Value]:
        """Its fields of a row, rounded."""
        found = self.measure(episodes)
        values = found if isinstance(found, tuple) else (found,)
        if len(values) != len(self.fields):
            raise ValueError(
                f"metric {self.fields[0]} gives {len(values)} values; it must give "
                f"{len(self.fields)}: {', '.join(self.fields)}"
            )
        return {
            name: None if value is None else round(float(value), self.decimals)
            for name, value in zip(self.fields, values, strict=True)
        }

    def cell(self, row: dict[str, Any]) -> str:
        """How a table shows it: `-` where there is nothing to measure, empty in older rows."""
        values = [row.get(name) for name in self.fields]
        if self.fields[0] not in row:
            return ""
        return "-" if values[0] is None else self.form.format(*values)


METRICS: dict[str, Metric] = {}  # by the first field, in the order of a row


def metric(
    *fields: str,
    heading: str,
    form: str = "{:.1f}",
    decimals: int = 2,
    shown: Shown = Shown.printed | Shown.report,
) -> Callable[[Measure], Measure]:
    """Make a function of the episode records known as a metric.

    Args:
        *fields: the names of what it gives in a row.
        heading: of its column in the tables; empty: only in the files.
        form: how a cell shows the values, as of `str.format`.
        decimals: to which the files round them.
        shown: in which tables it has a column.

    Raises:
        ValueError: another metric has a field of this name.
    """

    def register(measure: Measure) -> Measure:
        for name in fields:
            if name in metric_fields():
                raise ValueError(f"metric field {name!r} is there already; name it otherwise")
        METRICS[fields[0]] = Metric(fields, heading, form, decimals, measure, shown)
        return measure

    return register


def metric_fields() -> list[str]:
    """The fields of all metrics, in the order of a row."""
    return [name for known in METRICS.values() for name in known.fields]


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % confidence interval of a rate (Wilson, 1927), as shares.

    Examples:
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


def mean_interval(scores: NDArray[np.float64]) -> tuple[float, float, float]:
    """The mean of scores from 0 to 100, [B], and its normal 95 % interval."""
    mean, half = float(scores.mean()), _Z95 * float(scores.std()) / math.sqrt(len(scores))
    return mean, max(mean - half, 0.0), min(mean + half, 100.0)


@metric(
    "success_rate", "success_low", "success_high",
    heading="success % [95 %]", form="{:.1f} [{:.1f}, {:.1f}]", shown=Shown.everywhere,
)  # fmt: skip
def _success(episodes: Episodes) -> tuple[float, float, float]:
    """Every robot arrived and nobody collided, %, with its Wilson interval."""
    success = episodes.success
    low, high = wilson_interval(int(success.sum()), len(success))
    return _percent(success), 100 * low, 100 * high


@metric("robot_success_rate", heading="robots' success %", shown=Shown.driving)
def _robot_success(episodes: Episodes) -> float:
    """Robots that arrived, whatever became of the others, %."""
    return _percent(episodes.outcome == Outcome.arrived)


@metric("social_score", "social_low", "social_high", heading="social score")
def _social(episodes: Episodes) -> tuple[float, float, float]:
    """Mean of F, with the normal interval of the mean over episodes."""
    return mean_interval(social_score(episodes).mean(axis=1))


@metric("collision_rate", heading="collision %", shown=Shown.report)
def _collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_human | episodes.hit_robot)


@metric("human_collision_rate", heading="hit human %")
def _human_collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_human)


@metric("robot_on_person_rate", heading="robot on person %", shown=Shown.driving)
def _robot_on_person(episodes: Episodes) -> float:
    """Episodes in which a robot hit a human and was the faster towards the other, %."""
    return _percent(episodes.robot_on_person)


@metric("person_on_robot_rate", heading="person on robot %", shown=Shown.driving)
def _person_on_robot(episodes: Episodes) -> float:
    """The same where the human was the faster, %."""
    return _percent(episodes.person_on_robot)


@metric("robot_collision_rate", heading="hit robot %", shown=Shown.everywhere)
def _robot_collision(episodes: Episodes) -> float:
    return _percent(episodes.hit_robot)


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


@metric("closest_human", heading="nearest m", form="{:.2f}", decimals=3, shown=Shown.report)
def _closest_human(episodes: Episodes) -> Value:
    """Median over robots and episodes in which there was a human, m."""
    met = episodes.closest_human[np.isfinite(episodes.closest_human)]
    return float(np.median(met)) if met.size else None


@metric("csr", heading="CSR %", shown=Shown.counted)
def _csr(episodes: Episodes) -> float:
    """Every robot arrived in time, whatever it hit (MSA3C), %."""
    return 100 * float(episodes.arrived.all(axis=1).mean())


@metric("cr", heading="CR %", shown=Shown.counted)
def _cr(episodes: Episodes) -> float:
    """Collisions per episode (MSA3C), %."""
    return 100 * float(episodes.contacts.sum(axis=1).mean())


@metric("apl", heading="APL m", shown=Shown.counted)
def _apl(episodes: Episodes) -> Value:
    """Path of all robots together, mean over the episodes in which all arrived (MSA3C), m."""
    return _mean(episodes.path_length.sum(axis=1)[episodes.arrived.all(axis=1)])


@metric("ntc", heading="NTC", shown=Shown.counted)
def _ntc(episodes: Episodes) -> Value:
    """Steps until the last robot arrived, mean over the episodes in which all did (MSA3C)."""
    return _mean(episodes.steps[episodes.arrived.all(axis=1)])


@metric("cir", heading="CIR %", shown=Shown.counted)
def _cir(episodes: Episodes) -> float:
    """Share of the steps of all robots within 0.25 m of somebody (MSA3C), %."""
    return 100 * float(np.average(episodes.comfort_share, weights=episodes.time))


@metric("close_share", heading="close %", shown=Shown.report | Shown.driving)
def _close_share(episodes: Episodes) -> float:
    """Share of a robot's steps within 0.45 m of somebody: in intimate space (Hall, 1966), %."""
    return _percent(episodes.close_share)


@metric("personal_share", heading="personal %", shown=Shown.driving)
def _personal_share(episodes: Episodes) -> float:
    """Share of its steps from 0.45 to 1.2 m from the nearest human (Hall, 1966), %."""
    return _percent(episodes.personal_share)


@metric("social_share", heading="social %", shown=Shown.driving)
def _social_share(episodes: Episodes) -> float:
    """Share of its steps from 1.2 to 3.6 m from the nearest human (Hall, 1966), %."""
    return _percent(episodes.social_share)


@metric("soonest_collision", heading="soonest collision s", decimals=3, shown=Shown.driving)
def _soonest_collision(episodes: Episodes) -> Value:
    """Smallest time to one with a human if nobody changed velocity, at most 10 s (Francis et al.).

    Median over robots and episodes in which there was a human, s.
    """
    met = episodes.soonest_collision[np.isfinite(episodes.closest_human)]
    return float(np.median(np.minimum(met, _FAR_AHEAD))) if met.size else None


@metric("jerk", heading="jerk m/s³", shown=Shown.report)
def _jerk(episodes: Episodes) -> float:
    """Mean norm, m/s^3."""
    return float(episodes.jerk.mean())


@metric("standing_share", heading="not moving %", shown=Shown.driving)
def _standing_share(episodes: Episodes) -> float:
    """Share of a robot's steps slower than 0.05 m/s (HuNavSim's time not moving), %."""
    return _percent(episodes.standing_share)


@metric("heading_change", heading="heading change rad", form="{:.2f}", shown=Shown.driving)
def _heading_change(episodes: Episodes) -> Value:
    """Sum of the turns to either side, mean over the robots that arrived, rad (HuNavSim)."""
    return _mean(episodes.heading_change[episodes.outcome == Outcome.arrived])


@metric(
    "path_irregularity", heading="irregularity rad/m", form="{:.2f}", decimals=3,
    shown=Shown.driving,
)  # fmt: skip
def _path_irregularity(episodes: Episodes) -> Value:
    """Turning for each metre driven, mean over the robots that arrived (Guzzi et al., 2013), rad/m.

    They count what exceeds the turning on the straight way; a robot that begins with its heading
    towards its goal has none there.
    """
    arrived = episodes.outcome == Outcome.arrived
    return _mean(episodes.heading_change[arrived] / episodes.path_length[arrived])


def _percent(share: NDArray[np.bool_] | NDArray[np.float64]) -> float:
    return 100 * float(share.mean())


def _mean(values: NDArray[Any]) -> Value:
    return float(values.mean()) if values.size else None
