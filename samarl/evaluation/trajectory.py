"""The complete course of one episode, for figures and replays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mrsan import CrowdReaction, Episodes, Observation, Reaction, Scenario, State, World
from mrsan.kernels.social_state import GROUP, REACTION
from mrsan.metrics import episodes_of
from mrsan.passages import Passages, find_passages, open_width
from mrsan.place_shapes import walls_of
from samarl.agents import Agent, Explanation
from samarl.agents.agent import act_and_tell

if TYPE_CHECKING:
    from pandas import DataFrame

_DECIMALS = 6  # of positions in the coordinates of a file, m

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
    passages: Passages  # doors and corridors between them
    robot_position: Floats  # [T + 1, N, 2]
    robot_velocity: Floats  # [T + 1, N, 2]
    robot_heading: Floats  # [T + 1, N]
    robot_goal: Floats  # [N, 2]
    human_position: Floats  # [T + 1, M, 2] of everybody present at any time
    human_velocity: Floats  # [T + 1, M, 2]
    human_goal: Floats  # [T + 1, M, 2]
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
    activity: NDArray[np.int8] | None  # [T, N] index in `ACTIVITIES` of what each robot does
    value: Floats | None  # [T, N] discounted reward that each robot expects
    episodes: Episodes  # the record of this one episode


class Playback:
    """One case that an agent plays step by step."""

    def __init__(self, agent: Agent, scenario: Scenario, case: int) -> None:
        """Begin the case.

        Raises:
            ConfigurationError: the case has no room for all robots or people.
        """
        self.agent, self.scenario, self.case = agent, scenario, case
        self.world = World(scenario)
        self.observation = self.world.reset([case])
        agent.reset(np.ones(1, np.bool_))
        state, width = self.world.state, open_width(scenario.robot_radius)
        self._passages = find_passages(state.walls[0], state.place[0], width)
        self.snapshots = [_snapshot(state, self.observation)]
        self.explanations: list[Explanation] = []
        # What the agent last acted on, and how [1, N, A]
        self.decided_on, self.action = self.observation, np.zeros(0, np.float32)

    @property
    def is_over(self) -> bool:
        """Return whether the episode has ended."""
        return bool(self.world.state.done[0])

    def step(self) -> None:
        """Let the agent act once."""
        self.action = act_and_tell(self.agent, self.observation, self.world)
        self.explanations.append(self.agent.explain() or Explanation())
        self.decided_on = self.observation
        self.observation = self.world.step(self.action).observation
        self.snapshots.append(_snapshot(self.world.state, self.observation))

    def observe_again(self) -> None:
        """Observe the moment once more after somebody was moved."""
        self.observation = self.world.observe()
        self.snapshots[-1] = _snapshot(self.world.state, self.observation)

    def trajectory(self, everybody: bool = False) -> Trajectory:
        """Return the trajectory so far.

        Args:
            everybody: also those people who were never present.
        """
        scenario, state = self.scenario, self.world.state
        series = [np.stack(values) for values in zip(*self.snapshots, strict=True)]
        position, velocity, heading, driving, lidar, *people_and_masks = series
        humans, human_velocity, human_goal, present, *masks = people_and_masks
        humans_visible, robots_visible, humans_reported, robots_reported = masks
        ever_present = present.any(0) | everybody
        waypoint, human_attention, robot_attention, shielded, activity, value = (
            None if values[0] is None else np.concatenate(values)
            for values in list(zip(*self.explanations or [Explanation()], strict=True))[:6]
        )
        groups, reactions = _social(scenario, state.human_social[0, ever_present])
        return Trajectory(
            scenario=scenario,
            case=self.case,
            walls=walls_of(state, 0).copy(),
            passages=self._passages,
            robot_position=position,
            robot_velocity=velocity,
            robot_heading=heading,
            robot_goal=state.robot_goal[0].copy(),
            human_position=humans[:, ever_present],
            human_velocity=human_velocity[:, ever_present],
            human_goal=human_goal[:, ever_present],
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
            activity=activity,
            value=value,
            episodes=episodes_of(state, scenario, np.ones(1, np.bool_)),
        )


def record_episode(
    agent: Agent, scenario: Scenario, case: int, everybody: bool = False
) -> Trajectory:
    """Run one case and return its trajectory; `everybody` as in `Playback.trajectory`."""
    playback = Playback(agent, scenario, case)
    while not playback.is_over:
        playback.step()
    return playback.trajectory(everybody)


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
        state.robot_velocity[0].copy(),
        state.robot_heading[0].copy(),
        ~state.arrived[0],
        observation.sensors["lidar"][0] if "lidar" in observation.sensors else np.zeros(0),
        state.human_position[0].copy(),
        state.human_velocity[0].copy(),
        state.human_goal[0].copy(),
        state.human_present[0].copy(),
        observation.humans_visible[0],
        observation.robots_visible[0],
        observation.humans_reported[0],
        observation.robots_reported[0],
    )


def as_table(trajectory: Trajectory) -> DataFrame:
    """Return a trajectory as a table with one row per step and agent, ordered by step.

    Its columns are `step`, `time` (s), `kind` (robot or human) and `id`; the position `x`, `y` (m),
    the velocity `vx`, `vy` (m/s) and the goal `goal_x`, `goal_y` in the world frame, or in the
    coordinates of the map or recording if there is one; and `radius`. Further columns describe
    robots only: `heading` (rad), `arrived`, the waypoint `waypoint_x`, `waypoint_y` it drives to in
    the following step, and whether the shield replaced the action of that step (`shielded`). They
    are NaN or false for people, and where an agent has no such thing.
    People are listed while they are present.
    """
    import pandas as pd

    t = trajectory
    steps, robots = t.driving.shape
    waypoint = np.full((steps, robots, 2), np.nan, np.float32)
    if t.waypoint is not None:
        waypoint[:-1] = t.waypoint
    waypoint = in_file_frame(waypoint, t.scenario)
    shielded = np.zeros((steps, robots), np.bool_)
    if t.shielded is not None:
        shielded[:-1] = t.shielded
    goals = np.broadcast_to(t.robot_goal, t.robot_position.shape)
    robot_rows = _rows("robot", t, t.robot_position, t.robot_velocity, goals) | {
        "radius": t.scenario.robot_radius,
        "heading": t.robot_heading.ravel(),
        "arrived": ~t.driving.ravel(),
        "waypoint_x": waypoint[..., 0].ravel(),
        "waypoint_y": waypoint[..., 1].ravel(),
        "shielded": shielded.ravel(),
    }
    human_rows = _rows("human", t, t.human_position, t.human_velocity, t.human_goal) | {
        "radius": np.tile(t.human_radius, steps),
        "arrived": False,
        "shielded": False,
    }
    people = pd.DataFrame(human_rows)[t.human_present.ravel()]
    table = pd.concat([pd.DataFrame(robot_rows), people], ignore_index=True)
    return table.sort_values("step", kind="stable", ignore_index=True)


def in_file_frame(points: Floats, scenario: Scenario) -> NDArray[np.floating]:
    """Return points [..., 2] of the world in the coordinates of its map or recording, m."""
    origin = np.array(scenario.file_origin)
    return (points + origin).round(_DECIMALS) if origin.any() else points


def _rows(
    kind: str, trajectory: Trajectory, position: Floats, velocity: Floats, goal: Floats
) -> dict[str, Any]:
    """Return the columns that robots and people share, of K agents with arrays [T + 1, K, 2]."""
    steps, agents = position.shape[:2]
    step = np.repeat(np.arange(steps), agents)
    columns = {
        "step": step,
        "time": step * trajectory.scenario.time_step,
        "kind": kind,
        "id": np.tile(np.arange(agents), steps),
    }
    for array, names in (
        (in_file_frame(position, trajectory.scenario), ("x", "y")),
        (velocity, ("vx", "vy")),
        (in_file_frame(goal, trajectory.scenario), ("goal_x", "goal_y")),
    ):
        columns |= {name: array[..., axis].ravel() for axis, name in enumerate(names)}
    return columns


def _with_diagonal(values: NDArray) -> NDArray:
    """Insert zeros for the robot itself: [T, N, N - 1] to [T, N, N]."""
    n = values.shape[1]
    out = np.zeros((len(values), n, n), values.dtype)
    out[:, ~np.eye(n, dtype=np.bool_)] = values.reshape(len(values), -1)
    return out
