"""The inputs of the runtime for a robot of the simulator, to compare the two."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

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
    """Return the inputs of `Driver.step` for a robot, in the frame of the world.

    With `named`, detections have ids.
    """
    ego = [float(value) for value in observation.ego[world, robot]]
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]

    def to_world(ahead: float, left: float) -> tuple[float, float]:
        return rotate(cos, sin, ahead, left)

    origin_x, origin_y = to_world(ego[ORIGIN_X], ego[ORIGIN_Y])
    goal = to_world(ego[GOAL_X], ego[GOAL_Y])
    vx, vy = to_world(ego[VELOCITY_X], ego[VELOCITY_Y])
    x, y = -origin_x, -origin_y
    own = OwnState(x, y, math.atan2(sin, cos), vx, vy, x + goal[0], y + goal[1])
    if "route" in observation.sensors:
        ahead, left = (float(value) for value in observation.sensors["route"][world, robot])
        dx, dy = to_world(ahead, left)
        own = own._replace(next_x=x + dx, next_y=y + dy)
    detections = []
    for group, is_robot in (("humans", False), ("robots", True)):
        rows, visible = observation.entities[group]
        for k in visible[world, robot].nonzero()[0]:
            x, y, other_vx, other_vy, radius = (float(v) for v in rows[world, robot, k])
            offset, velocity = to_world(x, y), to_world(other_vx, other_vy)
            detections.append(
                Detection(
                    own.x + offset[0],
                    own.y + offset[1],
                    vx + velocity[0],
                    vy + velocity[1],
                    radius,
                    is_robot,
                    int(k) if named else None,
                )
            )
    return own, detections


def walls_in_view(observation: Observation, own: OwnState, robot: int, world: int = 0) -> NDArray:
    """Return the `walls` of `Driver.step` for a robot, [K, 4]."""
    if "walls" not in observation.entities:
        return np.zeros((0, 4))
    features, mask = observation.entities["walls"]
    segments = features[world, robot][mask[world, robot]].astype(np.float64)
    cos, sin = math.cos(own.heading), math.sin(own.heading)
    columns = []
    for x, y in ((segments[:, 0], segments[:, 1]), (segments[:, 2], segments[:, 3])):
        dx, dy = rotate(cos, sin, x, y)
        columns += [own.x + dx, own.y + dy]
    return np.stack(columns, -1)


def sensor_readings(observation: Observation, robot: int, world: int = 0) -> dict[str, NDArray]:
    """Return the `sensors` of `Driver.step` for a robot."""
    readings = {
        name: values[world, robot]
        for name, values in observation.sensors.items()
        if name != "route"
    }
    for name, (features, mask) in observation.entities.items():
        if name not in ("humans", "robots", "walls"):
            readings[name], readings[f"{name}_known"] = features[world, robot], mask[world, robot]
    return readings
