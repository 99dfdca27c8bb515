"""What the robots perceive, and why they do what they do, in words and numbers for the page."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Kinematics, Scenario, State
from mrsan.place_shapes import route_of
from samarl.evaluation.trajectory import Playback
from samarl.observations.features import to_world
from samarl.observations.tracker import AGE

_HORIZON = 2.0  # s, for which the reason of the shield is looked for


def insight(side: Playback) -> list[dict[str, Any]]:
    """Return what is known of the last decision, for each robot; empty before the first one.

    - `route`: points from the robot to its goal, as far as they are known;
    - `tracks`: [number, x, y, age] of the people that the agent remembers, age in s;
    - `words`: one line on the action and its reason.
    """
    if not side.explanations:
        return []
    explanation, scenario, state = side.explanations[-1], side.scenario, side.world.state
    insights: list[dict[str, Any]] = []
    for i in range(scenario.robots):
        words = []
        if state.arrived[0, i]:
            insights.append({"route": [], "tracks": [], "words": "It has arrived."})
            continue
        tracks = None
        if explanation.tracks is not None:
            tracks = explanation.tracks[0, i]
        action = _action(side.action[0, i], scenario)
        if explanation.shielded is not None and explanation.shielded[0, i]:
            assert explanation.proposed is not None
            words.append(f"The policy wants to {_action(explanation.proposed[0, i], scenario)}.")
            words.append(f"The shield makes it {action}{_reason(tracks, scenario)}.")
        else:
            words.append(f"The policy wants to {action}.")
        insights.append(
            {
                "route": _route(state, scenario, i),
                "tracks": [] if tracks is None else _tracks(tracks, side, i),
                "words": " ".join(words),
            }
        )
    return insights


def _action(action: NDArray[np.float32], scenario: Scenario) -> str:
    """Return an action [A] in words."""
    if scenario.kinematics is Kinematics.holonomic:
        speed = min(float(np.hypot(*action)), 1.0) * scenario.robot_speed
        bearing = math.degrees(math.atan2(action[1], action[0]))
        return f"drive at {speed:.2f} m/s, {_degrees(bearing)}"
    turn = math.degrees(float(action[-1]) * scenario.max_turn)
    if scenario.kinematics is Kinematics.unicycle:
        return f"drive at {(action[0] + 1) / 2 * scenario.robot_speed:.2f} m/s, {_degrees(turn)}"
    change = float(action[0]) * scenario.max_acceleration
    verb = "accelerate" if change >= 0.0 else "brake"
    return f"{verb} with {abs(change):.1f} m/s², {_degrees(turn)}"


def _degrees(angle: float) -> str:
    if abs(angle) < 0.5:
        return "straight ahead"
    return f"turning {abs(angle):.0f}° to the {'left' if angle > 0.0 else 'right'}"


def _reason(tracks: NDArray[np.float32] | None, scenario: Scenario) -> str:
    """Return whom the robot would reach first if everybody kept their velocity."""
    if tracks is None:
        return ""
    radius = scenario.robot_radius
    soonest, person = _HORIZON, None
    for j, (x, y, vx, vy, other, _) in enumerate(tracks.astype(float)):
        if other <= 0.0:
            continue  # nobody is known in this slot
        # |(x, y) + t (vx, vy)| = other + radius; velocities are relative to the floor.
        a, b = vx * vx + vy * vy, x * vx + y * vy
        inside = b * b - a * (x * x + y * y - (other + radius) ** 2)
        if a > 0.0 and b < 0.0 and inside >= 0.0 and (-b - math.sqrt(inside)) / a < soonest:
            soonest, person = (-b - math.sqrt(inside)) / a, j
    if person is None:
        return f": no way on avoids everybody for {_HORIZON:g} s"
    return f": person {person} walks to where it is and arrives in {max(soonest, 0.0):.1f} s"


def _tracks(tracks: NDArray[np.float32], side: Playback, i: int) -> list[list[float]]:
    """Return [number, x, y, age] of the people known, in the world frame."""
    agent: Any = side.agent
    longest = getattr(getattr(agent, "shield", None), "track_time", 1.0)
    ego = side.decided_on.ego[0, i]
    return [
        [
            j,
            *(round(float(v), 2) for v in to_world(track[:2], ego)),
            round(float(track[AGE]) * longest, 2),
        ]
        for j, track in enumerate(tracks)
        if track.any()
    ]


def _route(state: State, scenario: Scenario, i: int) -> list[list[float]]:
    """Return the corners of the route of a robot, as far as it knows them, and its goal."""
    start, goal = state.robot_position[0, i], state.robot_goal[0, i]
    agent = scenario.humans + i
    known = scenario.has_walls and scenario.map_known and state.route_corner[0, agent] >= 0
    points = route_of(state, 0, agent, start, goal)[1:] if known else goal[None]
    return [[round(float(x), 2) for x in point] for point in points]
