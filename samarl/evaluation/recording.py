"""Everything that happened in one episode, for pictures and replays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Observation, Scenario, State, World
from mrsan.metrics import episodes_of
from samarl.agents import Agent, Explanation

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]


@dataclass
class Recording:
    """One episode of T steps; what robots see of each other is [..., N, N], of themselves nothing.

    What an agent cannot tell of itself is None.
    """

    scenario: Scenario
    case: int
    robot_position: Floats  # [T + 1, N, 2]
    robot_heading: Floats  # [T + 1, N]
    robot_goal: Floats  # [N, 2]
    human_position: Floats  # [T + 1, M, 2], those who were ever present
    human_radius: Floats  # [M]
    human_present: Bools  # [T + 1, M]
    driving: Bools  # [T + 1, N] not yet arrived
    humans_seen: Bools  # [T + 1, N, M]
    robots_seen: Bools  # [T + 1, N, N]
    humans_reported: Bools  # [T + 1, N, M] of these, whom only team-mates see
    robots_reported: Bools  # [T + 1, N, N]
    waypoint: Floats | None  # [T, N, 2] where each robot drives to, in the world frame
    human_attention: Floats | None  # [T, N, M] shares
    robot_attention: Floats | None  # [T, N, N] shares
    shielded: Bools | None  # [T, N] the safety shield replaced the action
    episodes: Episodes  # the record of this one episode


def record_episode(agent: Agent, scenario: Scenario, case: int) -> Recording:
    """Play one case and keep every state of it."""
    world = World(scenario)
    observation = world.reset([case])
    agent.reset(np.ones(1, np.bool_))
    state = world.state
    frames, thoughts = [_frame(state, observation)], []
    while not state.done[0]:
        action = agent.act(observation)
        thoughts.append(agent.explain() or Explanation())
        observation = world.step(action).observation
        frames.append(_frame(state, observation))
    position, heading, humans, present, driving, *known = (
        np.stack(part) for part in zip(*frames, strict=True)
    )
    humans_seen, robots_seen, humans_reported, robots_reported = known
    met = present.any(0)
    waypoint, human_attention, robot_attention, stepped_in = (
        None if part[0] is None else np.concatenate(part) for part in zip(*thoughts, strict=True)
    )
    return Recording(
        scenario=scenario,
        case=case,
        robot_position=position,
        robot_heading=heading,
        robot_goal=state.robot_goal[0].copy(),
        human_position=humans[:, met],
        human_radius=state.human_radius[0, met],
        human_present=present[:, met],
        driving=driving,
        humans_seen=humans_seen[..., met],
        robots_seen=_of_all(robots_seen),
        humans_reported=humans_reported[..., met],
        robots_reported=_of_all(robots_reported),
        waypoint=waypoint,
        human_attention=None if human_attention is None else human_attention[..., met],
        robot_attention=None if robot_attention is None else _of_all(robot_attention),
        shielded=stepped_in,
        episodes=episodes_of(state, scenario, np.ones(1, np.bool_)),
    )


def _frame(state: State, observation: Observation) -> tuple[NDArray, ...]:
    return (
        state.robot_position[0].copy(),
        state.robot_heading[0].copy(),
        state.human_position[0].copy(),
        state.human_present[0].copy(),
        ~state.arrived[0],
        observation.humans_visible[0],
        observation.robots_visible[0],
        _told(observation.humans_reported[0], observation.humans_visible[0]),
        _told(observation.robots_reported[0], observation.robots_visible[0]),
    )


def _told(told: Bools, visible: Bools) -> Bools:
    """Without team perception the masks are empty: nobody was told of."""
    return told if told.size else np.zeros_like(visible)


def _of_all(of_others: NDArray) -> NDArray:
    """From a value for each other robot, [T, N, N - 1], to one for each robot, [T, N, N]."""
    n = of_others.shape[1]
    out = np.zeros((len(of_others), n, n), of_others.dtype)
    out[:, ~np.eye(n, dtype=np.bool_)] = of_others.reshape(len(of_others), -1)
    return out
