"""The complete course of one episode, for figures and replays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrsan import CrowdReaction, Episodes, Observation, Reaction, Scenario, State, World
from mrsan.kernels.social_state import GROUP, REACTION
from mrsan.metrics import episodes_of
from mrsan.rendering import walls_of
from samarl.agents import Agent, Explanation

Floats = NDArray[np.float32]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int32]


@dataclass
class Trajectory:
    """One episode of T steps.

    Arrays [..., N, N] are indexed by the observing robot, then by the observed one; the diagonal is
    zero. Fields that the agent does not explain are None.
    """

    scenario: Scenario
    case: int
    walls: Floats  # [W, 4] x and y of the starts and ends of wall segments
    robot_position: Floats  # [T + 1, N, 2]
    robot_heading: Floats  # [T + 1, N]
    robot_goal: Floats  # [N, 2]
    human_position: Floats  # [T + 1, M, 2] of everybody present at any time
    human_radius: Floats  # [M]
    human_present: Bools  # [T + 1, M]
    human_group: Ints | None  # [M] number of the group; -1: none; None: there are no groups
    human_reaction: list[str] | None  # [M] names of `mrsan.Reaction`; None: they are not drawn
    driving: Bools  # [T + 1, N] not yet arrived
    humans_visible: Bools  # [T + 1, N, M]
    robots_visible: Bools  # [T + 1, N, N]
    humans_reported: Bools  # [T + 1, N, M] visible to team-mates only, who reported them
    robots_reported: Bools  # [T + 1, N, N]
    waypoint: Floats | None  # [T, N, 2] that each robot drives to, in the world frame
    human_attention: Floats | None  # [T, N, M] attention weights
    robot_attention: Floats | None  # [T, N, N]
    lidar: Floats | None  # [T + 1, N, L] ranges, m
    shielded: Bools | None  # [T, N] the safety shield replaced the action
    episodes: Episodes  # the record of this one episode


def record_episode(agent: Agent, scenario: Scenario, case: int) -> Trajectory:
    """Run one case and return its trajectory."""
    world = World(scenario)
    observation = world.reset([case])
    agent.reset(np.ones(1, np.bool_))
    state = world.state
    snapshots, explanations = [_snapshot(state, observation)], []
    while not state.done[0]:
        action = agent.act(observation)
        explanations.append(agent.explain() or Explanation())
        observation = world.step(action).observation
        snapshots.append(_snapshot(state, observation))
    position, heading, humans, present, driving, lidar, *masks = (
        np.stack(series) for series in zip(*snapshots, strict=True)
    )
    humans_visible, robots_visible, humans_reported, robots_reported = masks
    ever_present = present.any(0)
    waypoint, human_attention, robot_attention, shielded = (
        None if series[0] is None else np.concatenate(series)
        for series in zip(*explanations, strict=True)
    )
    groups, reactions = _social(scenario, state.human_social[0, ever_present])
    return Trajectory(
        scenario=scenario,
        case=case,
        walls=walls_of(state, 0).copy(),
        robot_position=position,
        robot_heading=heading,
        robot_goal=state.robot_goal[0].copy(),
        human_position=humans[:, ever_present],
        human_radius=state.human_radius[0, ever_present],
        human_present=present[:, ever_present],
        human_group=groups,
        human_reaction=reactions,
        driving=driving,
        humans_visible=humans_visible[..., ever_present],
        robots_visible=_with_diagonal(robots_visible),
        humans_reported=humans_reported[..., ever_present],
        robots_reported=_with_diagonal(robots_reported),
        waypoint=waypoint,
        human_attention=None if human_attention is None else human_attention[..., ever_present],
        robot_attention=None if robot_attention is None else _with_diagonal(robot_attention),
        lidar=lidar if lidar.size else None,
        shielded=shielded,
        episodes=episodes_of(state, scenario, np.ones(1, np.bool_)),
    )


def _social(scenario: Scenario, social: Ints) -> tuple[Ints | None, list[str] | None]:
    """Return the groups and the reactions of the people of `State.human_social` [M, 3]."""
    has_groups = scenario.groups.share > 0.0
    reactions_drawn = scenario.crowd_reaction is CrowdReaction.mixed
    groups = social[:, GROUP].copy() if has_groups else None
    names = [Reaction(kind).name for kind in social[:, REACTION]] if reactions_drawn else None
    return groups, names


def _snapshot(state: State, observation: Observation) -> tuple[NDArray, ...]:
    return (
        state.robot_position[0].copy(),
        state.robot_heading[0].copy(),
        state.human_position[0].copy(),
        state.human_present[0].copy(),
        ~state.arrived[0],
        observation.sensors["lidar"][0] if "lidar" in observation.sensors else np.zeros(0),
        observation.humans_visible[0],
        observation.robots_visible[0],
        observation.humans_reported[0],
        observation.robots_reported[0],
    )


def _with_diagonal(values: NDArray) -> NDArray:
    """Insert zeros for the robot itself: [T, N, N - 1] to [T, N, N]."""
    n = values.shape[1]
    out = np.zeros((len(values), n, n), values.dtype)
    out[:, ~np.eye(n, dtype=np.bool_)] = values.reshape(len(values), -1)
    return out
