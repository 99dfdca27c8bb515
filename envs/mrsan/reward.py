"""What a step is worth to a robot, and of what parts (SAMARL, Eq. 10; MSA3C, Eq. 2 to 4)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels import function


class RewardParts(NamedTuple):
    """The terms that the reward is the sum of, each [E, N] float32 and in its unit.

    What does not apply is zero. A robot that touches somebody gets nothing but `collision`, and
    what it is paid for arriving if it arrives all the same (`Scenario.collisions_end`); `progress`
    and `discomfort` never come together, nor with an arrival. With `Reward.literal` only the first
    case of Eq. 10 that holds is paid: `team` takes the place of `arrival` for who arrives last.
    """

    progress: NDArray[np.float32]  # `Reward.progress` per metre nearer to the goal
    arrival: NDArray[np.float32]  # it reached its goal in this step
    team: NDArray[np.float32]  # the last of the team did: to every robot
    collision: NDArray[np.float32]  # it touched somebody
    discomfort: NDArray[np.float32]  # max(-w / d, limit), instead of `progress`
    goal_distance: NDArray[np.float32]  # -`Reward.goal_distance` d_g / R^2, R of the circle
    time: NDArray[np.float32]  # `Reward.time`, for a step on its way
    lookahead: NDArray[np.float32]  # somebody will come too near (`mrsan.lookahead`)


@function
def step_reward_parts(
    collided, arrived, team_arrived, driving, human_gap, progress, goal_distance, p
):
    """Reward of one robot for one step, as `RewardParts` but the last, from the state after it.

    Args:
        collided: this robot touched somebody during the step.
        arrived: this robot reached its goal in this step.
        team_arrived: the last robot of the team reached its goal in this step.
        driving: the robot was still on its way when the step began.
        human_gap: surface distance to the nearest human after the step, seen or not (m).
        progress: by how much the distance to the goal fell (m).
        goal_distance: that distance after the step (m).
        p: the scenario's parameters.
    """
    none = p.reward_none
    crash = p.reward_collision if collided else none
    far, late = none, none
    if driving and not collided:  # MSA3C, Eq. 2
        far, late = none - p.reward_goal_distance * goal_distance, p.reward_time
    if p.reward_literal:  # the first case of Eq. 10 that holds, in the paper's order
        if team_arrived:
            return none, none, p.reward_team, none, none, far, late
        if arrived:
            return none, p.reward_arrival, none, none, none, far, late
    else:  # the last to arrive is paid for its own arrival and for the team's
        bonus = p.reward_team if team_arrived else none
        if arrived:
            return none, p.reward_arrival, bonus, crash, none, far, late
        if not driving:
            return none, none, bonus, none, none, none, none
    if collided or not driving:
        return none, none, none, crash, none, none, none
    if human_gap <= p.reward_discomfort_distance:
        if -human_gap * p.reward_discomfort_limit <= p.reward_discomfort:
            return none, none, none, none, p.reward_discomfort_limit, far, late
        return none, none, none, none, -p.reward_discomfort / human_gap, far, late
    return p.reward_progress * progress, none, none, none, none, far, late
