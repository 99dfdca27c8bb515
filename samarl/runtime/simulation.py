"""A robot of the simulator as the runtime sees one, to compare the two."""

from __future__ import annotations

import math

from mrsan import Observation
from mrsan.features import (
    GOAL_X,
    GOAL_Y,
    HEADING_COS,
    HEADING_SIN,
    ORIGIN_X,
    ORIGIN_Y,
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.se2 import rotate
from samarl.runtime.inputs import Detection, OwnState


def as_seen(
    observation: Observation, robot: int, world: int = 0, named: bool = True
) -> tuple[OwnState, list[Detection]]:
    """What a robot would tell the runtime, in the frame of the world.

    Args:
        observation: of some worlds.
        robot: which robot.
        world: of which world.
        named: whether detections have ids.
    """
    ego = [float(value) for value in observation.ego[world, robot]]
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]

    def fixed(ahead: float, left: float) -> tuple[float, float]:
        return rotate(cos, sin, ahead, left)

    from_x, from_y = fixed(ego[ORIGIN_X], ego[ORIGIN_Y])
    goal_x, goal_y = fixed(ego[GOAL_X], ego[GOAL_Y])
    vx, vy = fixed(ego[VELOCITY_X], ego[VELOCITY_Y])
    own = OwnState(-from_x, -from_y, math.atan2(sin, cos), vx, vy, goal_x - from_x, goal_y - from_y)
    detections = []
    for rows, visible, is_robot in (
        (observation.humans, observation.humans_visible, False),
        (observation.robots, observation.robots_visible, True),
    ):
        for k in visible[world, robot].nonzero()[0]:
            x, y, other_vx, other_vy, radius = (float(v) for v in rows[world, robot, k])
            there, moves = fixed(x, y), fixed(other_vx, other_vy)
            detections.append(
                Detection(
                    own.x + there[0],
                    own.y + there[1],
                    vx + moves[0],
                    vy + moves[1],
                    radius,
                    is_robot,
                    int(k) if named else None,
                )
            )
    return own, detections
