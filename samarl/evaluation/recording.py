"""Everything that happened in one episode, for pictures and replays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Scenario, State, World
from mrsan.metrics import episodes_of
from samarl.agents import Agent

Floats = NDArray[np.float32]


@dataclass
class Recording:
    """One episode of T steps."""

    scenario: Scenario
    case: int
    robot_position: Floats  # [T + 1, N, 2]
    robot_heading: Floats  # [T + 1, N]
    robot_goal: Floats  # [N, 2]
    human_position: Floats  # [T + 1, M, 2], those present
    human_radius: Floats  # [M]
    driving: NDArray[np.bool_]  # [T + 1, N] not yet arrived
    episodes: Episodes  # the record of this one episode


def record_episode(agent: Agent, scenario: Scenario, case: int) -> Recording:
    """Play one case and keep every state of it."""
    world = World(scenario)
    observation = world.reset([case])
    agent.reset(np.ones(1, np.bool_))
    state = world.state
    present = int(state.human_count[0])
    frames = [_frame(state, present)]
    while not state.done[0]:
        observation = world.step(agent.act(observation)).observation
        frames.append(_frame(state, present))
    position, heading, humans, driving = (np.stack(part) for part in zip(*frames, strict=True))
    return Recording(
        scenario=scenario,
        case=case,
        robot_position=position,
        robot_heading=heading,
        robot_goal=state.robot_goal[0].copy(),
        human_position=humans,
        human_radius=state.human_radius[0, :present].copy(),
        driving=driving,
        episodes=episodes_of(state, scenario, np.ones(1, np.bool_)),
    )


def _frame(state: State, present: int) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    return (
        state.robot_position[0].copy(),
        state.robot_heading[0].copy(),
        state.human_position[0, :present].copy(),
        ~state.arrived[0],
    )
