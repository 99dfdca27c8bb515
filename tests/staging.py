"""Worlds put by hand into a wanted state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mrsan import Crowd, Scenario, World

NOBODY_AVOIDS = 0.1  # neighbor_distance that makes people walk straight to their goals


def stage(
    robots: Sequence[Sequence[float]],
    humans: Sequence[Sequence[float]] = (),
    arrived: Sequence[int] = (),
    clock: int = 0,
    **scenario: Any,
) -> World:
    """One world in a given state.

    Args:
        robots: rows `[x, y, heading, speed, goal_x, goal_y]`.
        humans: rows `[x, y, vx, vy]`; they walk on in this direction at this speed, and no goal is
            redrawn.
        arrived: the numbers of the robots that are parked.
        clock: steps taken so far.
        **scenario: fields of the scenario.
    """
    fields = {
        "crowd": Crowd.orca,
        "neighbor_distance": NOBODY_AVOIDS,
        "goal_change_probability": 0.0,
        "robots": len(robots),
        "humans": len(humans),
    }
    world = World(replace(Scenario(), **(fields | scenario)))
    world.reset([0])
    state = world.state
    for i, (x, y, heading, speed, goal_x, goal_y) in enumerate(robots):
        state.robot_position[0, i] = state.robot_start[0, i] = x, y
        state.robot_heading[0, i] = heading
        state.robot_velocity[0, i] = speed * np.cos(heading), speed * np.sin(heading)
        state.robot_goal[0, i] = goal_x, goal_y
        state.arrived[0, i] = i in arrived
    for j, (x, y, vx, vy) in enumerate(humans):
        state.human_position[0, j] = x, y
        state.human_velocity[0, j] = vx, vy
        state.human_speed[0, j] = np.hypot(vx, vy)
        state.human_goal[0, j] = (x + 1000 * vx, y + 1000 * vy) if vx or vy else (x, y + 1000)
        state.human_radius[0, j] = 0.3
    state.clock[0] = clock
    return world


def step_once(scenario: Scenario, worlds: int) -> None:
    """Begin an episode in every world and take one step; this compiles missing kernels."""
    world = World(scenario, worlds)
    world.reset(range(worlds))
    world.step(np.zeros((worlds, scenario.robots, scenario.action_size), np.float32))
