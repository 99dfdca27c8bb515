"""The excess of actions over what a robot can execute."""

from __future__ import annotations

import torch
from torch import Tensor

from mrsan import Kinematics, Scenario


def excess(mean: Tensor, std: Tensor, speed: Tensor, scenario: Scenario, slack: float) -> Tensor:
    """Return the squared excess of mean actions over the limits of the robots, [R].

    All actions beyond the limits of speed and turning (SAMARL, Eq. 3) have the same effect. A
    policy whose mean lies far beyond them explores no other effect: robots at full speed would
    never brake, standing robots never start, turning robots never turn less. The result is 0 for
    kinematics without such limits.

    Args:
        mean: [R, 3] longitudinal and lateral acceleration and heading change.
        std: [R, 3] of the exploration noise.
        speed: [R] m/s.
        scenario: of the robots.
        slack: number of standard deviations beyond the limits that are not penalised.
    """
    s = scenario
    if s.kinematics is not Kinematics.acceleration_heading:
        return torch.zeros_like(speed)
    margin = slack * std.detach()
    gain = s.max_acceleration * s.time_step  # m/s that a full acceleration adds in a step
    forward = mean[:, 0]
    too_fast = (forward - (s.robot_speed - speed) / gain - margin[:, 0]).clamp_min(0.0)
    reverse = (-speed / gain - forward - margin[:, 0]).clamp_min(0.0)
    next_speed = (speed + gain * forward.detach()).clamp(0.0, s.robot_speed)
    turn_limit = (s.time_step * next_speed / s.min_turning_radius).clamp(max=s.max_turn)
    # Near standstill the lateral part may turn by any angle: use a quarter of the speed instead.
    lateral_turn = torch.atan2(gain * mean[:, 1], next_speed.clamp_min(0.25 * s.robot_speed))
    turn_margin = s.max_turn * margin[:, 2] + gain * margin[:, 1]
    turn = (s.max_turn * mean[:, 2] + lateral_turn).abs()
    too_sharp = (turn - turn_limit - turn_margin).clamp_min(0.0) / s.max_turn
    standing = (mean[:, 2].abs() - 1 - margin[:, 2]).relu()  # a standing robot turns freely
    too_sharp = torch.where(next_speed > 0.0, too_sharp, standing)
    return too_fast.square() + reverse.square() + too_sharp.square()
