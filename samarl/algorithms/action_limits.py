"""The excess of actions over what a robot can execute."""

from __future__ import annotations

import torch
from torch import Tensor

from mrsan import Scenario


def action_limits(scenario: Scenario) -> tuple[float, float, float, float]:
    """Return what `excess` needs to know of the robots.

    Returns:
        The speed that a full acceleration adds in a step (m/s), the largest speed (m/s), the
        largest turn per step (rad), and the turn that the smallest turning radius allows in a step
        per speed (rad per m/s).
    """
    s = scenario
    turn_per_speed = s.time_step / s.min_turning_radius
    return s.max_acceleration * s.time_step, s.robot_speed, s.max_turn, turn_per_speed


def excess(mean: Tensor, std: Tensor, speed: Tensor, limits: Tensor) -> Tensor:
    """Return the squared excess of mean actions over the limits of the robots, [R].

    All actions beyond the limits of speed and turning (SAMARL, Eq. 3) have the same effect. A
    policy whose mean lies far beyond them explores no other effect: robots at full speed would
    never brake, standing robots never start, turning robots never turn less. The result is 0 for
    kinematics without such limits.

    Args:
        mean: [R, 3] longitudinal and lateral acceleration and heading change.
        std: [R, 3] of the exploration noise; so much beyond the limits is not penalised.
        speed: [R] m/s.
        limits: [R, 4] see `action_limits`.
    """
    if mean.shape[-1] != 3:  # only acceleration_heading has these limits
        return torch.zeros_like(speed)
    gain, robot_speed, max_turn, turn_per_speed = limits.unbind(-1)
    margin = std.detach()
    forward = mean[:, 0]
    too_fast = (forward - (robot_speed - speed) / gain - margin[:, 0]).clamp_min(0.0)
    reverse = (-speed / gain - forward - margin[:, 0]).clamp_min(0.0)
    next_speed = torch.minimum((speed + gain * forward.detach()).clamp_min(0.0), robot_speed)
    turn_limit = torch.minimum(turn_per_speed * next_speed, max_turn)
    # Near standstill the lateral part may turn by any angle: use a quarter of the speed instead.
    lateral_turn = torch.atan2(gain * mean[:, 1], torch.maximum(next_speed, 0.25 * robot_speed))
    turn_margin = max_turn * margin[:, 2] + gain * margin[:, 1]
    turn = (max_turn * mean[:, 2] + lateral_turn).abs()
    too_sharp = (turn - turn_limit - turn_margin).clamp_min(0.0) / max_turn
    standing = (mean[:, 2].abs() - 1 - margin[:, 2]).relu()  # a standing robot turns freely
    too_sharp = torch.where(next_speed > 0.0, too_sharp, standing)
    return too_fast.square() + reverse.square() + too_sharp.square()
