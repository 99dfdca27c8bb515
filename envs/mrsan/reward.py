"""What a step is worth to a robot, and of what parts (SAMARL, Eq. 10; MSA3C, Eq. 4)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan.kernels import function


class RewardParts(NamedTuple):
    """The terms that the reward is the sum of, each [E, N] float32 and in its unit.

    All but the last are of Eq. 10. What does not apply is zero. A robot that collides gets nothing
    but `collision`; `progress` and `discomfort` never come together, nor with an arrival. With
    `Reward.literal` only the first case that holds is paid: `team` takes the place of `arrival` for
    who arrives last.
    """

    progress: NDArray[np.float32]  # `Reward.progress` per metre nearer to the goal
    arrival: NDArray[np.float32]  # it reached its goal in this step
    team: NDArray[np.float32]  # the last of the team did: to every robot
    collision: NDArray[np.float32]  # it ran into somebody
    discomfort: NDArray[np.float32]  # max(-w / d, limit), instead of `progress`
    lookahead: NDArray[np.float32]  # somebody will come too near (`mrsan.lookahead`)


@function
def step_reward_parts(collided, arrived, team_arrived, driving, human_gap, progress, p):
    """Eq. 10 for one robot and one step: all `RewardParts` but the last, from the state after it.

    Args:
        collided: this robot ran into somebody during the step.
        arrived: this robot reached its goal in this step.
        team_arrived: the last robot of the team reached its goal in this step.
        driving: the robot was still on its way when the step began.
        human_gap: surface distance to the nearest human after the step, seen or not (m).
        progress: by how much the distance to the goal fell (m).
        p: the scenario's parameters.
    """
    none = p.reward_none
    if p.reward_literal:  # the first case of Eq. 10 that holds, in the paper's order
        if team_arrived:
            return none, none, p.reward_team, none, none
        if arrived:
            return none, p.reward_arrival, none, none, none
        if collided:
            return none, none, none, p.reward_collision, none
    else:  # the last to arrive is paid for its own arrival and for the team's
        if collided:
            return none, none, none, p.reward_collision, none
        bonus = p.reward_team if team_arrived else none
        if arrived:
            return none, p.reward_arrival, bonus, none, none
        if not driving:
            return none, none, bonus, none, none
    if not driving:
        return none, none, none, none, none
    if human_gap <= p.discomfort_distance:
        if -human_gap * p.reward_discomfort_limit <= p.reward_discomfort:
            return none, none, none, none, p.reward_discomfort_limit
        return none, none, none, none, -p.reward_discomfort / human_gap
    return p.reward_progress * progress, none, none, none, none
