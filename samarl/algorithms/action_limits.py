"""How far actions lie beyond what a robot can execute."""

from __future__ import annotations

import torch
from torch import Tensor

from mrsan import Kinematics, Scenario


def excess(mean: Tensor, std: Tensor, speed: Tensor, scenario: Scenario, slack: float) -> Tensor:
    """Return the squared excess of mean actions over the limits of the robots, [R].

    Beyond the limits of speed and turning (SAMARL, Eq. 3) all actions have the same effect. A
    policy whose mean lies far outside never explores anything else: robots at full speed would
    never brake, standing robots never start, turning robots never turn less. For kinematics
    without such limits the result is 0.

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
    free_of = slack * std.detach()
    gain = s.max_acceleration * s.time_step  # m/s that a full acceleration adds in a step
    turn = s.max_turn
    along = mean[:, 0]
    faster = (along - (s.robot_speed - speed) / gain - free_of[:, 0]).clamp_min(0.0)
    slower = (-speed / gain - along - free_of[:, 0]).clamp_min(0.0)
    after = (speed + gain * along.detach()).clamp(0.0, s.robot_speed)
    limit = (s.time_step * after / s.min_turning_radius).clamp(max=turn)
    # Near standstill the lateral part may turn by any angle: use a quarter of the speed instead.
    across = torch.atan2(gain * mean[:, 1], after.clamp_min(0.25 * s.robot_speed))
    free = turn * free_of[:, 2] + gain * free_of[:, 1]
    sharper = ((turn * mean[:, 2] + across).abs() - limit - free).clamp_min(0.0) / turn
    sharper = torch.where(after > 0.0, sharper, (mean[:, 2].abs() - 1 - free_of[:, 2]).relu())
    return faster.square() + slower.square() + sharper.square()
