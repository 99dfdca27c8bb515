"""The reward of a step and its terms (SAMARL, Eq. 10; MSA3C, Eq. 2-4)."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrsan.fields import ConfigurationError, check_numbers, number, setting, short_repr
from mrsan.kernels import function

_ZERO = np.float32(0.0)
# Custom terms by name, as functions of a state and a scenario (`mrsan.register_reward_term`).
REWARD_TERMS: dict[str, Callable[..., ArrayLike]] = {}


@dataclass
class Reward:
    """Weights of SAMARL, Eq. 10, and of the additional terms of MSA3C, Eq. 2-4."""

    __repr__ = short_repr

    arrival: float = number(10.0, -1e6, 1e6, help="for a robot that reaches its goal")
    team: float = number(5.0, -1e6, 1e6, help="for every robot when the last one arrives")
    collision: float = number(-20.0, -1e6, 1e6, help="for a robot that touches another agent")
    discomfort: float = number(1.0, 0.0, 1e6, help="w in max(-w / d, discomfort_limit)")
    discomfort_limit: float = number(-5.0, -1e6, 0.0, help="lower bound of the discomfort term")
    discomfort_distance: float = number(
        0.45, 0.0, 100.0, unit="m", help="distance d to the nearest person below which it applies"
    )
    progress: float = number(2.0, -1e6, 1e6, help="per metre of progress towards the goal")
    goal_distance: float = number(
        0.0, 0.0, 1e6, help="penalty per step, times d_g / circle_radius^2"
    )
    time: float = number(0.0, -1e6, 1e6, help="per step until arrival")
    literal: bool = setting(
        False, help="the paper's first matching case only: the last robot to arrive gets only team"
    )
    lookahead: float = number(
        0.0, 0.0, 1e6, help="w in -w exp(-k) for a person who will be too close in k steps"
    )
    lookahead_steps: int = number(5, 1, 200, help="largest k")
    lookahead_distance: float = number(
        0.25, 0.0, 100.0, unit="m", help="a person closer than this is too close"
    )
    lookahead_predictor: str = setting(
        "constant_velocity", help="predictor of people: a name or a weights file"
    )
    terms: dict[str, float] = field(
        default_factory=dict,
        metadata={"help": "weights of registered terms: terms.name=weight"},
    )


def check_reward(reward: Reward) -> None:
    """Check the numbers of the reward and the weights of its terms.

    Raises:
        ConfigurationError: a number is out of range, there is no such term, or a weight is not a
            finite number.
    """
    check_numbers(reward, "scenario.reward")
    terms: Any = reward.terms
    if not isinstance(terms, dict):
        raise ConfigurationError(
            f"scenario.reward.terms is {terms!r}; it must map names of terms to their weights"
        )
    for name, weight in terms.items():
        if name not in REWARD_TERMS:
            known = f"one of {', '.join(REWARD_TERMS)} or " if REWARD_TERMS else ""
            raise ConfigurationError(
                f"scenario.reward.terms has {name!r}; it must be {known}registered in this "
                "process: import its module, in commands by plugins=[module]"
            )
        is_number = isinstance(weight, int | float) and not isinstance(weight, bool)
        if not is_number or not math.isfinite(weight):
            raise ConfigurationError(
                f"scenario.reward.terms.{name} is {weight!r}; it must be a finite number"
            )


class RewardParts(NamedTuple):
    """The terms whose sum is the reward, each [E, N] float32; kernels use it for a single robot.

    A term that does not apply is zero. A robot that touches another agent receives only
    `collision`, and `arrival` if it arrives nevertheless (`Scenario.terminate_on_collision`);
    `progress` and `discomfort` exclude each other and any arrival. With `Reward.literal` only
    the first matching case of Eq. 10 applies: the last robot to arrive receives `team` instead of
    `arrival`.
    """

    progress: NDArray[np.float32]  # `Reward.progress` per metre of progress towards the goal
    arrival: NDArray[np.float32]  # the robot reached its goal in this step
    team: NDArray[np.float32]  # the last robot reached its goal; for every robot
    collision: NDArray[np.float32]  # the robot touched another agent
    discomfort: NDArray[np.float32]  # max(-w / d, limit), instead of `progress`
    goal_distance: NDArray[np.float32]  # -`Reward.goal_distance` d_g / circle_radius^2
    time: NDArray[np.float32]  # `Reward.time`, until arrival
    lookahead: NDArray[np.float32]  # a person will be too close (`mrsan.lookahead`)
    custom: NDArray[np.float32]  # registered terms times their weights in `Reward.terms`


@function
def step_reward_parts(
    collided, arrived, team_arrived, driving, human_gap, progress, goal_distance, p
):
    """Return the terms of one robot's reward; the world adds `lookahead` and `custom`.

    Args:
        collided: this robot touched another agent during the step.
        arrived: this robot reached its goal in this step.
        team_arrived: the last robot of the team reached its goal in this step.
        driving: the robot had not arrived when the step began.
        human_gap: surface distance to the nearest human after the step, visible or not (m).
        progress: decrease of the distance to the goal (m).
        goal_distance: distance to the goal after the step (m).
        p: the scenario's parameters.
    """
    progress_term = arrival_term = team_term = collision_term = discomfort_term = _ZERO
    goal_distance_term = time_term = _ZERO
    if driving and not collided:  # MSA3C, Eq. 2
        goal_distance_term = _ZERO - p.reward_goal_distance * goal_distance
        time_term = p.reward_time
    if p.reward_literal and team_arrived:  # the first matching case of Eq. 10, in its order
        team_term = p.reward_team
    elif p.reward_literal and arrived:
        arrival_term = p.reward_arrival
    else:
        if team_arrived:
            team_term = p.reward_team
        if collided:
            collision_term = p.reward_collision
        if arrived:
            arrival_term = p.reward_arrival
        elif driving and not collided:
            if human_gap > p.reward_discomfort_distance:
                progress_term = p.reward_progress * progress
            elif -human_gap * p.reward_discomfort_limit <= p.reward_discomfort:
                discomfort_term = p.reward_discomfort_limit
            else:
                discomfort_term = -p.reward_discomfort / human_gap
    return RewardParts(
        progress=progress_term,
        arrival=arrival_term,
        team=team_term,
        collision=collision_term,
        discomfort=discomfort_term,
        goal_distance=goal_distance_term,
        time=time_term,
        lookahead=_ZERO,
        custom=_ZERO,
    )


@function
def sum_of_parts(parts):
    """Return the sum of the terms of `step_reward_parts`, always added in the same order."""
    moving = parts.progress + parts.arrival + parts.team + parts.collision + parts.discomfort
    return moving + parts.goal_distance + parts.time
