"""Groups of people who walk abreast or stand and talk: the numbers of `Scenario.groups`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mrsan.fields import ConfigurationError, check_numbers, number, short_repr


@dataclass
class Groups:
    """Who belongs to groups, and how their members keep together (Moussaid et al., 2010)."""

    __repr__ = short_repr

    share: float = number(0.0, 0.0, 1.0, help="share of people in groups, about")
    standing_share: float = number(
        0.0, 0.0, 1.0, help="share of groups that stand and talk; the others walk"
    )
    size_min: int = number(2, 2, 4, help="smallest size of a group")
    size_max: int = number(4, 2, 4, help="largest size of a group")
    gaze: float = number(
        4.0, 0.0, 100.0, unit="1/(s rad)", help="how much turning the head to the others slows down"
    )
    gaze_fov_degrees: float = number(
        180.0, 0.0, 360.0, unit="degrees", help="field of view that needs no turning"
    )
    attraction: float = number(
        3.0, 0.0, 100.0, unit="m/s^2", help="acceleration of stragglers towards the group's centre"
    )
    spread: float = number(
        0.5, 0.0, 10.0, unit="m", help="distance from the centre of a straggler, per other member"
    )
    repulsion: float = number(
        1.0, 0.0, 100.0, unit="m/s^2", help="acceleration sideways, away from members in line"
    )
    gap: float = number(
        0.2,
        0.0,
        10.0,
        unit="m",
        help="distance between members across their way, from surface to surface",
    )
    talk_radius: float = number(
        0.7, 0.1, 10.0, unit="m", help="smallest radius of the circle of a group that talks"
    )
    intrusion_width: float = number(
        0.6, 0.0, 10.0, unit="m", help="a robot nearer than half of it to a group's hull intrudes"
    )


def check_groups(groups: Groups) -> None:
    """Check the numbers of groups.

    Raises:
        ConfigurationError: a number is out of range, or the smallest size exceeds the largest one.
    """
    check_numbers(groups, "scenario.groups")
    if groups.size_min > groups.size_max:
        raise ConfigurationError(
            f"scenario.groups.size_min is {groups.size_min}; it must not exceed "
            f"scenario.groups.size_max ({groups.size_max})"
        )


def group_parameters(g: Groups, relaxation_time: float) -> dict[str, Any]:
    """Return the numbers of groups in the form that kernels take.

    An acceleration `a` of the model is `a * relaxation_time` (m/s) as a change of the preferred
    velocity, which the social-force crowd turns into `a` again.
    """
    f = np.float32
    size = (g.size_min + g.size_max) / 2
    return {
        # That a person who follows no group begins one: of groups with probability q,
        # q size / (q size + 1 - q) of the people are members.
        "start_probability": f(g.share / (g.share + size * (1.0 - g.share))),
        "standing_share": f(g.standing_share),
        "size_min": g.size_min,
        "size_max": g.size_max,
        "gaze": f(g.gaze * relaxation_time),  # per rad
        "half_gaze_fov": f(np.radians(g.gaze_fov_degrees / 2)),
        "attraction": f(g.attraction * relaxation_time),  # m/s
        "spread": f(g.spread),
        "repulsion": f(g.repulsion * relaxation_time),  # m/s
        "gap": f(g.gap),
        "talk_radius": f(g.talk_radius),
        "relaxation_time": f(relaxation_time),
        "intrusion_distance": f(g.intrusion_width / 2),
    }
