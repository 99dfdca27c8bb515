"""How people react to robots: the numbers of `Scenario.reactions`.

The kinds of reaction are those of HuNavSim (Perez-Higueras et al., 2023); the numbers are ours.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrsan.choices import CrowdReaction, Reaction
from mrsan.fields import ConfigurationError, check_numbers, number, short_repr

_ROUNDING = 1e-6  # by which the sum of the shares may exceed 1
# The kinds that people draw.
DRAWN = [reaction for reaction in Reaction if reaction is not Reaction.blind]


@dataclass
class Reactions:
    """Shares of the people who react in each way, and the numbers of each way.

    The shares apply with `Scenario.crowd_reaction` mixed; the rest of the people ignore robots.
    """

    __repr__ = short_repr

    regular: float = number(0.4, 0.0, 1.0, help="share who avoid robots as people")
    impassive: float = number(0.2, 0.0, 1.0, help="share who avoid robots as if they stood still")
    surprised: float = number(0.1, 0.0, 1.0, help="share who stop at the sight of a robot")
    curious: float = number(0.1, 0.0, 1.0, help="share who approach a robot")
    scared: float = number(0.1, 0.0, 1.0, help="share who keep far away from robots")
    threatening: float = number(0.1, 0.0, 1.0, help="share who block the way of a robot")

    notice_distance: float = number(
        4.0, 0.1, 100.0, unit="m", help="surface distance within which people notice a robot"
    )
    notice_fov_degrees: float = number(
        180.0, 0.0, 360.0, above=True, unit="degrees", help="their field of view, centred ahead"
    )
    surprised_time: float = number(
        5.0, 0.0, 1000.0, unit="s", help="time for which surprised people stand"
    )
    curious_time: float = number(
        10.0, 0.0, 1000.0, unit="s", help="time for which curious people follow the robot"
    )
    curious_speed: float = number(
        0.6, 0.05, 10.0, unit="m/s", help="largest speed of curious people on their way to it"
    )
    curious_gap: float = number(
        0.9, 0.0, 10.0, unit="m", help="surface distance at which curious people stop"
    )
    scared_speed: float = number(
        0.6, 0.0, 10.0, unit="m/s", help="largest speed of scared people towards their goals"
    )
    scared_push: float = number(
        3.0, 0.0, 100.0, unit="m/s", help="velocity away from the robot, at contact"
    )
    scared_range: float = number(
        1.0, 0.01, 100.0, unit="m", help="distance in which that velocity decays by factor e"
    )
    threatening_time: float = number(
        10.0, 0.0, 1000.0, unit="s", help="time for which threatening people block the robot"
    )
    threatening_speed: float = number(
        1.5, 0.05, 10.0, unit="m/s", help="largest speed of threatening people"
    )
    threatening_gap: float = number(
        0.5, 0.2, 10.0, unit="m", help="surface distance at which they stay in front of the robot"
    )


def check_reactions(reactions: Reactions) -> None:
    """Check the numbers of reactions.

    Raises:
        ConfigurationError: a number is out of range, or the shares exceed 1.
    """
    check_numbers(reactions, "scenario.reactions")
    total = sum(_shares(reactions))
    if total > 1.0 + _ROUNDING:
        names = ", ".join(reaction.name for reaction in DRAWN)
        raise ConfigurationError(
            f"scenario.reactions has shares whose sum is {total:.3g}; the sum of {names} must be "
            "at most 1"
        )


def _shares(reactions: Reactions) -> list[float]:
    return [getattr(reactions, reaction.name) for reaction in DRAWN]


def reaction_parameters(
    r: Reactions, kind: CrowdReaction, steps: Callable[[float], int]
) -> dict[str, Any]:
    """Return the numbers of reactions in the form that kernels take.

    Args:
        r: their numbers.
        kind: how people react.
        steps: converts seconds to steps.
    """
    f = np.float32
    everybody = Reaction.regular if kind is CrowdReaction.reciprocal else Reaction.blind
    names = [reaction.name for reaction in DRAWN]
    up_to = dict(zip(names, map(f, np.cumsum(_shares(r))), strict=True))
    return up_to | {  # shares of the people with this reaction or one before
        "everybody": -1 if kind is CrowdReaction.mixed else everybody.value,
        "notice_distance": f(r.notice_distance),
        "cos_half_fov": f(math.cos(math.radians(r.notice_fov_degrees / 2))),
        "surprised_steps": steps(r.surprised_time),
        "curious_steps": steps(r.curious_time),
        "curious_speed": f(r.curious_speed),
        "curious_gap": f(r.curious_gap),
        "scared_speed": f(r.scared_speed),
        "scared_push": f(r.scared_push),
        "scared_range": f(r.scared_range),
        "threatening_steps": steps(r.threatening_time),
        "threatening_speed": f(r.threatening_speed),
        "threatening_gap": f(r.threatening_gap),
    }
