"""What the playground plays: the content of a case file, and its changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from mrsan import ConfigurationError, Crowd, Layout, Scenario, State
from mrsan.case_file import CaseFile, Edit
from mrsan.place_shapes import polygons_of
from mrsan.scenario import scenario_of_case
from samarl.evaluation.summary import changed_fields
from samarl.files import write_text

_HEADER = """\
# A case of SAMARL, saved by samarl-play. Play it with any agent:
#   samarl-evaluate scenario.case_file={name} agent=samarl
#   samarl-render scenario.case_file={name} agent=samarl output=case.mp4
"""
_ERASE_REACH = 0.4  # m, from a wall
Points = list[list[float]]


@dataclass
class Scene:
    """The start of an episode, and what is changed while it runs."""

    scenario: Scenario  # without a case file; its layout has no meaning if there are `walls`
    case: int
    walls: list[Points] = field(default_factory=list)
    floor: list[float] = field(default_factory=list)
    robots: list[dict[str, Any] | None] = field(default_factory=list)  # as in a case file
    people: list[dict[str, Any] | None] = field(default_factory=list)
    edits: list[Edit] = field(default_factory=list)

    @staticmethod
    def of_file(scenario: Scenario, case: CaseFile) -> Scene:
        """Return the scene of a case file, whose scenario may have been changed."""
        layout = Layout.square if case.walls else scenario.layout
        return Scene(
            replace(scenario, case_file=None, layout=layout),
            case.case,
            [[list(point) for point in polygon] for polygon in case.walls],
            list(case.floor),
            [_plain(start) for start in case.robots],
            [_plain(start) for start in case.people],
            list(case.edits),
        )

    def copy(self) -> Scene:
        """Return a copy whose edits and paths can be changed."""
        people = [person and dict(person) for person in self.people]
        for person in people:
            if person and "path" in person:
                person["path"] = list(person["path"])
        return replace(self, people=people, edits=list(self.edits))

    def content(self) -> dict[str, Any]:
        """Return the content of its case file."""
        fields = _nested(changed_fields(self.scenario, Scenario()))
        if self.walls:
            fields |= {"layout": Layout.map.name}
        fields.pop("case_file", None)
        parts = {
            "walls": self.walls,
            "floor": self.floor,
            "robots": self.robots,
            "people": self.people,
            "edits": [
                {"time": e.time, e.agent: e.number, e.field: list(e.value)} for e in self.edits
            ],
        }
        return {
            "scenario": fields,
            "case": self.case,
            **{name: value for name, value in parts.items() if value},
        }

    def write(self, path: Path) -> Scenario:
        """Write the case file; return the scenario that plays it."""
        text = yaml.safe_dump(self.content(), sort_keys=False, default_flow_style=None, width=100)
        write_text(path, _HEADER.format(name=path.name) + text)
        return scenario_of_case(str(path), {})

    def with_starts(self, start: State) -> Scene:
        """Return the same scene, which says where everybody starts.

        Args:
            start: the state of its world at the start.
        """
        scene = self.copy()
        scene.robots = [_robot(start, i) for i in range(self.scenario.robots)]
        if self.scenario.crowd != Crowd.recorded:
            paths = [person.get("path") if person else None for person in self.people]
            paths += [None] * (self.scenario.humans - len(paths))
            scene.people = [
                _person(start, j, paths[j]) if start.human_present[0, j] else None
                for j in range(self.scenario.humans)
            ]
        return scene

    def continued(self, state: State) -> Scene:
        """Return the scene that begins with the present state of a world; its edits are over.

        Raises:
            ConfigurationError: people are recorded.
        """
        scenario = self.scenario
        if scenario.crowd == Crowd.recorded:
            raise ConfigurationError(
                "scenario.crowd is recorded; people and walls can be added to simulated crowds only"
            )
        present = np.flatnonzero(state.human_present[0]).tolist()
        people: list[dict[str, Any] | None] = [_person(state, j) for j in present]
        walls = self.walls
        floor = self.floor
        if scenario.has_walls and not walls:
            walls = [[_short(point) for point in polygon] for polygon in polygons_of(state, 0)]
        changes: dict[str, Any] = {
            "humans": len(people),
            "humans_min": None,
            "late_probability": 0.0,
            "pair_probability": 0.0,
        }
        robots: list[dict[str, Any] | None] = [_robot(state, i) for i in range(scenario.robots)]
        return Scene(replace(scenario, **changes), self.case, walls, floor, robots, people)

    def with_wall(self, start: Points, state: State) -> Scene:
        """Return the scene that continues with one more thin wall, from one point to another.

        Raises:
            ConfigurationError: the wall is too short or touches somebody.
        """
        a, b = np.array(start)
        if np.hypot(*(b - a)) < 0.2:
            raise ConfigurationError("the wall is shorter than 0.2 m; draw a longer one")
        scene = self.continued(state)
        for kind, positions, radii in (
            (
                "robot",
                state.robot_position[0],
                np.full(self.scenario.robots, self.scenario.robot_radius),
            ),
            ("person", state.human_position[0], state.human_radius[0]),
        ):
            near = _distances(positions, a, b) <= radii
            if kind == "person":
                near &= state.human_present[0]
            if near.any():
                raise ConfigurationError(
                    f"the wall touches {kind} {int(near.argmax())}; draw it somewhere else"
                )
        if not scene.walls:
            half = round(self.scenario.half_extent + 1.0, 2)
            scene.floor = [-half, -half, half, half]
        scene.walls = [*scene.walls, start]
        return scene._among_walls()

    def without_wall(self, position: Sequence[float], open_layout: Layout, state: State) -> Scene:
        """Return the scene that continues without the wall at a place.

        Args:
            position: of the wall.
            open_layout: of the scene if it has no more walls.
            state: the present state.

        Raises:
            ConfigurationError: there is none, or it is the outline of the floor.
        """
        scene, point = self.continued(state), np.array([position])
        gaps = [
            min(
                float(_distances(point, np.array(a), np.array(b))[0])
                for a, b in zip(polygon, [*polygon[1:], polygon[0]], strict=True)
            )
            for polygon in scene.walls
        ]
        if not gaps or min(gaps) > _ERASE_REACH:
            raise ConfigurationError("there is no wall here; click on one to erase it")
        nearest = gaps.index(min(gaps))
        if len(scene.walls[nearest]) > 2 and _signed_area(scene.walls[nearest]) < 0.0:
            raise ConfigurationError("this is the outline of the floor; other walls can be erased")
        scene.walls = [polygon for k, polygon in enumerate(scene.walls) if k != nearest]
        if scene.walls:
            return scene._among_walls()
        scene.floor = []
        scene.scenario = replace(scene.scenario, layout=open_layout, map=None)
        return scene

    def with_person(self, position: Sequence[float], state: State) -> Scene:
        """Return the scene that continues with one more person, who stands at a place.

        Raises:
            ConfigurationError: there are too many people.
        """
        scene = self.continued(state)
        s = scene.scenario
        place = [round(float(x), 2) for x in position]
        scene.people.append(
            {
                "position": place,
                "velocity": [0.0, 0.0],
                "goal": place,
                "radius": s.human_radius_min,
                "speed": s.human_speed_min,
                "path": [],
            }
        )
        scene.scenario = replace(s, humans=s.humans + 1)
        return scene._among_walls() if scene.walls else scene

    def _among_walls(self) -> Scene:
        """Return the same scene, whose layout is its walls."""
        scenario = replace(self.scenario, layout=Layout.square, map=None, route_length_min=0.0)
        return replace(self, scenario=scenario)


def _plain(start: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the start of an agent as in YAML."""
    if start is None:
        return None
    single = ("heading", "radius", "speed")
    return {
        k: v[0] if k in single else [list(p) for p in v] if k == "path" else list(v)
        for k, v in start.items()
    }


def _nested(fields: Any) -> dict[str, Any]:
    """Return values by dotted names as nested mappings."""
    nested: dict[str, Any] = {}
    for name, value in fields:
        *parents, last = name.split(".")
        inner = nested
        for parent in parents:
            inner = inner.setdefault(parent, {})
        inner[last] = value
    return nested


def _short(values: Any) -> list[float]:
    """Return float32 numbers as the shortest decimals that stand for the same bits."""
    return [float(str(np.float32(value))) for value in values]


def _robot(state: State, i: int) -> dict[str, Any]:
    return {
        "position": _short(state.robot_position[0, i]),
        "heading": _short([state.robot_heading[0, i]])[0],
        "velocity": _short(state.robot_velocity[0, i]),
        "goal": _short(state.robot_goal[0, i]),
    }


def _person(state: State, j: int, path: Any = None) -> dict[str, Any]:
    person: dict[str, Any] = {
        "position": _short(state.human_position[0, j]),
        "velocity": _short(state.human_velocity[0, j]),
        "goal": _short(state.human_goal[0, j]),
        "radius": _short([state.human_radius[0, j]])[0],
        "speed": _short([state.human_speed[0, j]])[0],
    }
    return person | ({"path": list(path)} if path is not None else {})


def _distances(points: NDArray[Any], a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Return the distances of points [K, 2] from the segment from a to b, [K]."""
    along = b - a
    share = np.clip((points - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - a - share[:, None] * along, axis=1)


def _signed_area(polygon: Points) -> float:
    x, y = np.array(polygon).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
