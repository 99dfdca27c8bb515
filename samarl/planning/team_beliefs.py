"""What the robots of a team believe of each other, and which passages they come to."""

from __future__ import annotations

import math

import numpy as np

from mrsan.features import (
    GOAL_X,
    GOAL_Y,
    HEADING_COS,
    HEADING_SIN,
    ORIGIN_X,
    ORIGIN_Y,
    OTHER_VELOCITY_X,
    OTHER_VELOCITY_Y,
    OTHER_X,
    OTHER_Y,
    VELOCITY_X,
    VELOCITY_Y,
)
from mrsan.kernels import function, kernel
from mrsan.kernels.team import MACRO_ACTION, PRIORITY, THROUGH
from mrsan.se2 import rotate, transform
from samarl.planning.right_of_way import (
    look_ahead,
    map_of_world,
    mouths_of_world,
    number_of_mode,
)

POINTS = 128  # of a path


@kernel
def perceive(
    first,
    last,
    ego,
    robots,
    robots_visible,
    messages,
    messages_received,
    priority,
    known_maps,
    all_mouths,
    first_mouth,
    memory,
    central,
    p,
):
    """Update where robots are, what they believe of each other, and which passages they come to.

    Args:
        first: first world to work on.
        last: the one after the last.
        ego: [E, N, 11], and so on: what robots observe.
        robots: likewise.
        robots_visible: likewise.
        messages: [E, N, N - 1, 7], `mrsan.sensors.team.MESSAGE_FEATURES`.
        messages_received: [E, N, N - 1] bool.
        priority: [E, N, 1] their own priorities.
        known_maps: `KnownMap` of all worlds.
        all_mouths: `Mouths` of all worlds.
        first_mouth: [E + 1] the first mouth of each world.
        memory: `Memory`, updated.
        central: whether robots know the truth of each other.
        p: the scenario's parameters.
    """
    path, cost = np.zeros((POINTS, 2)), np.zeros(known_maps.corners.shape[2], np.float32)
    for e in range(first, last):
        known_map = map_of_world(known_maps, e)
        mouths = mouths_of_world(all_mouths, first_mouth, e)
        for i in range(ego.shape[1]):
            _write_pose(ego[e, i], memory.pose[e, i], memory.goal[e, i])
            from_goal = length_between(memory.goal[e, i], memory.pose[e, i])
            memory.arrived[e, i] = from_goal < p.robot_radius
        _believe(
            e,
            ego,
            robots,
            robots_visible,
            messages,
            messages_received,
            priority,
            mouths,
            memory,
            central,
            p.time_step,
        )
        for i in range(ego.shape[1]):
            look_ahead(e, i, mouths, memory, known_map, cost, path)


@function
def _believe(
    e,
    ego,
    robots,
    robots_visible,
    messages,
    received,
    priority,
    mouths,
    memory,
    central,
    dt,
):
    """Update what the robots believe of each other: the truth, messages, or what they see."""
    n, pose = ego.shape[1], memory.pose[e]
    for i in range(n):
        memory.belief[e, i, i, PRIORITY] = priority[e, i, 0]
        for j in range(n):
            if i == j:
                continue
            slot = j - (j > i)
            out = memory.belief[e, i, j]
            if central:
                memory.known[e, i, j] = True
                for f in range(4):
                    out[f] = pose[j, f]
                out[THROUGH] = 1.0 if memory.arrived[e, j] else 0.0
                out[MACRO_ACTION] = number_of_mode(e, j, mouths, memory)
                continue
            has_message = slot < received.shape[2] and received[e, i, slot]
            is_visible = robots_visible[e, i, slot]
            if is_visible:  # as messages may be late
                write_track(ego[e, i], pose[i], robots[e, i, slot], out)
            elif has_message:
                write_track(ego[e, i], pose[i], messages[e, i, slot], out)
            elif memory.known[e, i, j]:
                out[0] += out[2] * dt
                out[1] += out[3] * dt
            if has_message:
                for f in range(PRIORITY, MACRO_ACTION + 1):
                    out[f] = messages[e, i, slot, f]
            elif is_visible and not memory.known[e, i, j]:
                out[PRIORITY], out[THROUGH], out[MACRO_ACTION] = 0.0, 1.0, 0.0
            memory.known[e, i, j] |= has_message or is_visible


@function
def _write_pose(ego, pose, goal):
    """Write a robot's pose [5] and goal [2] in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    x, y = rotate(cos, sin, ego[ORIGIN_X], ego[ORIGIN_Y])
    pose[0], pose[1] = -x, -y
    pose[2], pose[3] = rotate(cos, sin, ego[VELOCITY_X], ego[VELOCITY_Y])
    pose[4] = math.atan2(sin, cos)
    goal[0], goal[1] = transform(cos, sin, -x, -y, ego[GOAL_X], ego[GOAL_Y])


@function
def write_track(ego, pose, track, out):
    """Write an observed agent's position and velocity [4] in the world frame."""
    cos, sin = ego[HEADING_COS], ego[HEADING_SIN]
    out[0], out[1] = transform(cos, sin, pose[0], pose[1], track[OTHER_X], track[OTHER_Y])
    vx, vy = track[OTHER_VELOCITY_X], track[OTHER_VELOCITY_Y]
    out[2], out[3] = transform(cos, sin, pose[2], pose[3], vx, vy)


@function
def length_between(a, b):
    """Return the distance of two points, m."""
    return math.hypot(a[0] - b[0], a[1] - b[1])
