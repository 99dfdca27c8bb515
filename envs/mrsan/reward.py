"""What a step is worth to a robot (SAMARL, Eq. 10)."""

from mrsan.kernels import function


@function
def step_reward(collided, arrived, team_arrived, driving, human_gap, progress, p):
    """Reward of one robot for one step, computed from the state after it.

    Args:
        collided: this robot ran into somebody during the step.
        arrived: this robot reached its goal in this step.
        team_arrived: the last robot of the team reached its goal in this step.
        driving: the robot was still on its way when the step began.
        human_gap: surface distance to the nearest human after the step, seen or not (m).
        progress: by how much the distance to the goal fell (m).
        p: the scenario's parameters.
    """
    if p.reward_literal:  # the first case of Eq. 10 that holds, in the paper's order
        if team_arrived:
            return p.reward_team
        if arrived:
            return p.reward_arrival
        if collided:
            return p.reward_collision
    else:  # the last to arrive is paid for its own arrival and for the team's
        if collided:
            return p.reward_collision
        bonus = p.reward_team if team_arrived else p.reward_none
        if arrived:
            return bonus + p.reward_arrival
        if not driving:
            return bonus
    if not driving:
        return p.reward_none
    if human_gap <= p.discomfort_distance:
        if -human_gap * p.reward_discomfort_limit <= p.reward_discomfort:
            return p.reward_discomfort_limit
        return -p.reward_discomfort / human_gap
    return p.reward_progress * progress
