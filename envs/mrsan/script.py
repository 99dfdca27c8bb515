"""What a case file says, carried out in worlds."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from mrsan.case_file import Edit, Start, read_case_file, steps_of
from mrsan.choices import Crowd
from mrsan.fields import ConfigurationError
from mrsan.kernels.scripted import Paths, find_routes
from mrsan.kernels.structs import by_reference
from mrsan.scenario import Scenario
from mrsan.state import Bools, Floats, State


class Script:
    """The case file of a scenario in E worlds; all of them play it."""

    def __init__(self, scenario: Scenario, worlds: int) -> None:
        """Read the file.

        Raises:
            ConfigurationError: it does not fit the scenario.
        """
        assert scenario.case_file is not None
        self.scenario, self.case = scenario, read_case_file(scenario.case_file)
        s, last = scenario, scenario.time_limit_steps
        for name, starts, field in (
            ("robots", self.case.robots, "robots"),
            ("people", self.case.people, "humans"),
        ):
            if starts and len(starts) != getattr(s, field):
                raise ConfigurationError(
                    f"scenario.{field} is {getattr(s, field)}; it must be {len(starts)}, as "
                    f"{s.case_file} has so many {name}"
                )
        if s.crowd == Crowd.recorded and any(self.case.people):
            raise ConfigurationError(
                f"scenario.crowd is recorded; {s.case_file} must not have people then"
            )
        # Of people on paths; what is written here before a step, that step carries out.
        self.paths: Floats = np.full((worlds, s.humans, last + 1, 2), np.nan, np.float32)
        for j, start in enumerate(self.case.people):
            if start and start.get("path"):
                begin = [(0.0, *start["position"])] if "position" in start else []
                self.paths[:, j] = steps_of([*begin, *start["path"]], s.time_step, last)
        self.argument = by_reference(Paths(self.paths))
        self.edits: dict[int, list[Edit]] = {}  # by step
        for edit in self.case.edits:
            self.add(edit)

    def add(self, edit: Edit) -> None:
        """Add an edit.

        Raises:
            ConfigurationError: it does not fit the scenario.
        """
        s = self.scenario
        count = s.robots if edit.agent == "robot" else s.humans
        if edit.number >= count:
            raise ConfigurationError(
                f"{edit.agent} is {edit.number} in an edit; it must lie in [0, {count - 1}]"
            )
        if edit.agent == "person" and s.crowd == Crowd.recorded:
            raise ConfigurationError(
                f"person {edit.number} walks as recorded; edits must be those of robots"
            )
        if edit.field == "action" and (
            len(edit.value) != s.action_size or not all(abs(x) <= 1.0 for x in edit.value)
        ):
            raise ConfigurationError(
                f"action is {edit.value!r:.60} in an edit; it must be {s.action_size} numbers in "
                "[-1, 1]"
            )
        self.edits.setdefault(s.steps(edit.time), []).append(edit)

    def begin(self, state: State, worlds: Bools) -> None:
        """Place the agents of the file in some worlds [E] in which an episode has begun."""
        moved = np.zeros((len(worlds), self.scenario.humans + self.scenario.robots), np.bool_)
        for e in np.flatnonzero(worlds).tolist():
            for i, start in enumerate(self.case.robots):
                if start:
                    _place_robot(state, e, i, start)
                    moved[e, self.scenario.humans + i] = True
            for j, start in enumerate(self.case.people):
                if start:
                    _place_person(state, e, j, start)
                    moved[e, j] = True
        if self.scenario.has_walls and moved.any():
            find_routes(len(worlds), moved, state)
            robots = moved[:, self.scenario.humans :]
            state.route_length[robots] = state.route_left[robots]
        self.change(state, worlds)

    def act(self, state: State, actions: Floats) -> Floats:
        """Return the actions [E, N, A] of the next step, with those of the file."""
        for e, edit in self._due(state, np.ones(len(actions), np.bool_)):
            if edit.field == "action":
                actions = actions.copy()
                actions[e, edit.number] = edit.value
        return actions

    def change(self, state: State, worlds: Bools) -> None:
        """Carry out the changes of the moment in some worlds [E]."""
        for e, edit in self._due(state, worlds):
            self.carry_out(state, e, edit)

    def carry_out(self, state: State, e: int, edit: Edit) -> None:
        """Move an agent or a goal of a world."""
        if edit.field == "action":
            return
        people = edit.agent == "person"
        arrays: Any = {
            ("person", "position"): state.human_position,
            ("person", "goal"): state.human_goal,
            ("robot", "position"): state.robot_position,
            ("robot", "goal"): state.robot_goal,
        }
        arrays[edit.agent, edit.field][e, edit.number] = edit.value
        if self.scenario.has_walls:
            moved = np.zeros(
                (len(state.clock), self.scenario.humans + self.scenario.robots), np.bool_
            )
            moved[e, edit.number + (0 if people else self.scenario.humans)] = True
            find_routes(len(moved), moved, state)

    def _due(self, state: State, worlds: Bools) -> Iterable[tuple[int, Edit]]:
        """Yield the changes of the moment with their worlds, of those [E] that have not ended."""
        if self.edits:
            for e in np.flatnonzero(worlds & ~state.done):
                for edit in self.edits.get(int(state.clock[e]), ()):
                    yield int(e), edit


def _place_robot(state: State, e: int, i: int, start: Start) -> None:
    position, goal = state.robot_position[e, i], state.robot_goal[e, i]
    position[:] = start.get("position", position)
    goal[:] = start.get("goal", goal)
    state.robot_start[e, i] = position
    state.robot_velocity[e, i] = start.get("velocity", state.robot_velocity[e, i])
    way = goal - position
    state.robot_heading[e, i] = start.get("heading", (math.atan2(way[1], way[0]),))[0]
    state.route_length[e, i] = state.route_left[e, i] = np.sqrt(way[0] * way[0] + way[1] * way[1])


def _place_person(state: State, e: int, j: int, start: Start) -> None:
    for field, array in (
        ("position", state.human_position),
        ("velocity", state.human_velocity),
        ("goal", state.human_goal),
    ):
        array[e, j] = start.get(field, array[e, j])
    if "radius" in start:
        state.human_radius[e, j] = start["radius"][0]
    if "speed" in start:
        state.human_speed[e, j] = start["speed"][0]
    state.human_present[e, j], state.human_entry[e, j] = True, 0
