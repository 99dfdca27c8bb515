"""A visitor's session in the playground: the scene, its agents, and what the visitor does."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mrsan import Crowd, Scenario, Split, State
from mrsan.case_file import Edit, read_case_file
from mrsan.cases import CASES_PER_SPLIT
from samarl.api import load_agent, load_scenario
from samarl.configuration import available_agents, available_scenarios
from samarl.evaluation.methods import label_of, split_method
from samarl.evaluation.trajectory import Playback
from samarl.play.attack import WALKING_SPEED, Attack
from samarl.play.insight import insight
from samarl.play.keyboard import KEYS, keyboard_action
from samarl.play.scene import Scene
from samarl.report.replays import as_replay

LONGEST_ATTACK = 60.0  # s of processor time
_MOST_UNDO = 50
_FARTHEST = 100.0  # m from the origin, of what is dragged
CHOICES = {  # fields of a scenario that the page changes
    "layout": "layout",
    "robots": "robots",
    "humans": "humans",
    "view": "fov_degrees",
    "crowd": "crowd",
    "reaction": "crowd_reaction",
}


class MessageError(ValueError):
    """A message of the page is not valid; it has changed nothing."""


class _Moment(NamedTuple):
    """All that a change may change."""

    scene: Scene
    starts: State
    sides: list[Playback]
    states: list[Any]  # of each side
    walker: int | None


@dataclass
class _Driven:
    robot: int
    keys: list[str]


class Session:
    """One page, which plays a scene with one or two agents side by side."""

    def __init__(
        self,
        folder: Path,
        scenario: Scenario,
        agents: Sequence[str],
        case: int,
        save_to: Path = Path(),
        name: str | None = None,
    ) -> None:
        """Begin a case.

        Args:
            folder: for the files of scenes that are played.
            scenario: the task; of one with a case file, the case of the file.
            agents: the names of one or two agents.
            case: its number.
            save_to: where scenes are saved.
            name: of the scenario in the menu, as in `load_scenario`; None: that of the scenario.

        Raises:
            ConfigurationError: an agent or the scenario cannot be used.
        """
        self._folder, self._save_to, self._files = folder, save_to, 0
        self._permitted = {*available_agents(), *agents}
        self._scenario = scenario.name if name is None else name
        self._scenarios = {*available_scenarios(), self._scenario}
        self._undo: list[_Moment] = []
        self._walk_to: tuple[float, float] | None = None
        self._driven: _Driven | None = None
        self._search: Attack | None = None
        self.walker: int | None = None  # number of the person who walks where the mouse goes
        self.agents: list[str] = []
        self.sides: list[Playback] = []
        if scenario.case_file is None:
            scene = Scene(scenario, case)
        else:
            scene = Scene.of_file(scenario, read_case_file(scenario.case_file))
        self._open_layout = scene.scenario.layout
        self._begin(scene, agents)

    def handle(self, message: Any) -> dict[str, Any]:
        """Carry out a message of the page and return the answer.

        Raises:
            MessageError: it is not a valid message.
            ConfigurationError: what it asks for is not possible.
        """
        kind = message.get("type") if isinstance(message, dict) else None
        handlers: dict[Any, Callable[[dict[str, Any]], dict[str, Any] | None]] = {
            "choose": self._choose,
            "step": self._step,
            "restart": self._restart,
            "undo": self._take_back,
            "move": self._move,
            "wall": self._wall,
            "erase": self._erase,
            "add": self._add,
            "walk": self._walk,
            "drive": self._drive,
            "attack": self._attack,
            "save": self._save,
        }
        if not isinstance(kind, str) or kind not in handlers:
            raise MessageError(f"type is {kind!r:.60}; it must be one of {', '.join(handlers)}")
        answer = handlers[kind](message)
        return self.view() if answer is None else answer

    def view(self) -> dict[str, Any]:
        """Return what the page shows."""
        s = self.sides[0].scenario
        return {
            "type": "view",
            "scene": self._number,
            "sides": [
                {
                    "agent": agent,
                    "label": label_of(agent),
                    "note": side.agent.scope_warning(),
                    "over": side.is_over,
                    "insight": insight(side),
                    "episode": as_replay(side.trajectory(everybody=True))
                    | {"running": not side.is_over},
                }
                for agent, side in zip(self.agents, self.sides, strict=True)
            ],
            "clock": self._clock,
            "case": _case_text(self.scene.case),
            "scenario": self._scenario,
            "layout": s.layout.name,
            "robots": s.robots,
            "humans": s.humans,
            "view": s.fov_degrees,
            "crowd": s.crowd,
            "reaction": s.crowd_reaction.name,
            "walker": self.walker,
            "driven": self._driven and self._driven.robot,
            "undo": len(self._undo),
            "changes": len(self.scene.edits),
        }

    @property
    def _clock(self) -> int:
        return max(len(side.snapshots) for side in self.sides) - 1

    @property
    def _now(self) -> float:
        """The time of the latest moment, s."""
        return round(self._clock * self.sides[0].scenario.time_step, 6)

    # ------------------------------------------------------------------ scenes

    def _begin(self, scene: Scene, agents: Sequence[str]) -> None:
        """Begin a scene; nothing changes unless it can be played."""
        self._files += 1
        scenario = scene.write(self._folder / f"scene{self._files}.yaml")
        earlier = dict(zip(self.agents, self.sides, strict=True))
        sides = []
        for name in agents:
            if name in earlier:
                agent = earlier[name].agent.for_scenario(scenario)
            else:
                method, settings = split_method(name)
                agent = load_agent(method, scenario, **settings)
            sides.append(Playback(agent, scenario, scene.case))
        self._starts = sides[0].world.snapshot()
        self.scene, self.agents, self.sides = scene, list(agents), sides
        self._number, self._search = self._files, None
        if self.walker is not None and self.walker >= scenario.humans:
            self.walker = None

    def _restart(self, message: dict[str, Any]) -> None:
        """Play the scene again from its start, with all changes."""
        self._walk_to = self._driven = None
        self._begin(self.scene.copy(), self.agents)

    def _choose(self, message: dict[str, Any]) -> None:
        """Choose agents for the same scene, or another scenario or case."""
        agents = message.get("agents", self.agents)
        if not isinstance(agents, list) or not 1 <= len(agents) <= 2:
            raise MessageError(f"agents is {agents!r:.60}; it must be a list of one or two names")
        for agent in agents:
            if not isinstance(agent, str) or agent not in self._permitted:
                raise MessageError(f"agents has {agent!r:.60}; it must be the name of an agent")
        if len(set(agents)) < len(agents):
            raise MessageError(f"agents is {agents!r:.60}; they must differ")
        if not message.keys() & {"scenario", "case", *CHOICES}:
            self._begin(self.scene.copy(), agents)
            self._walk_to = self._driven = None
            return
        name = message.get("scenario")
        if name is not None and (not isinstance(name, str) or name not in self._scenarios):
            raise MessageError(f"scenario is {name!r:.60}; it must be the name of a scenario")
        scenario = self.scene.scenario if name is None else load_scenario(name)
        if self.scene.walls and name is None and "layout" not in message:
            scenario = replace(scenario, layout=self._open_layout)
        changes = {field: message[key] for key, field in CHOICES.items() if key in message}
        if "humans" in changes:
            changes["humans_min"] = None
        if "crowd" in changes and changes["crowd"] not in (*Crowd, scenario.crowd):
            raise MessageError(
                f"crowd is {changes['crowd']!r:.60}; it must be one of {', '.join(Crowd)}"
            )
        if changes.get("layout") == "map":
            raise MessageError("layout is 'map'; it must be one without a file")
        if "layout" in changes:
            changes["map"] = None
        scenario = replace(scenario, **changes)
        case = message.get("case", self.scene.case)
        if "case" in message:
            case = _whole(message, "case", 0, CASES_PER_SPLIT - 1)
        self._begin(Scene(scenario, Split.test.number(case)), agents)
        self._open_layout = scenario.layout
        self._scenario = name or self._scenario
        self.walker = self._walk_to = self._driven = None
        self._undo.clear()

    def _save(self, message: dict[str, Any]) -> dict[str, Any]:
        """Write the scene, with all that was changed, as a case file."""
        name = message.get("name")
        if not isinstance(name, str) or not name.isidentifier() or len(name) > 60:
            raise MessageError(
                f"name is {name!r:.60}; it must be letters, digits and _, such as doorway_1"
            )
        path = self._save_to / f"{name}.yaml"
        if path.exists():
            raise MessageError(f"name is {name!r}; {path} exists, choose another name")
        try:
            self.scene.with_starts(self._starts).write(path)
        except OSError as error:
            raise MessageError(f"{path} cannot be written ({error.strerror})") from None
        return {"type": "saved", "path": str(path)}

    # ------------------------------------------------------------------ time

    def _step(self, message: dict[str, Any]) -> None:
        """Move on by one time step."""
        running = [side for side in self.sides if not side.is_over]
        if not running:
            return
        self._walk_on(running)
        if self._driven is not None:
            state, s = running[0].world.state, running[0].scenario
            i = self._driven.robot
            speed = float(np.hypot(*state.robot_velocity[0, i]))
            heading = float(state.robot_heading[0, i])
            action = keyboard_action(self._driven.keys, speed, heading, s)
            self._add_edit(Edit(self._now, "robot", i, "action", action))
        for side in running:
            side.step()

    def _walk_on(self, running: list[Playback]) -> None:
        """Let the person who walks where the mouse goes make the next step."""
        if self.walker is None or self._walk_to is None:
            return
        j, s = self.walker, running[0].scenario
        x, y = (float(v) for v in running[0].world.state.human_position[0, j])
        dx, dy = self._walk_to[0] - x, self._walk_to[1] - y
        share = min(1.0, WALKING_SPEED * s.time_step / max(math.hypot(dx, dy), 1e-6))
        x, y = round(x + share * dx, 3), round(y + share * dy, 3)
        person = self.scene.people[j]
        assert person is not None
        path = person.setdefault("path", [])
        path[:] = [point for point in path if point[0] <= self._now]
        path.append([round(self._now + s.time_step, 6), x, y])
        self._search = None  # it attacked another scene
        for side in running:
            assert side.world.script is not None
            side.world.script.paths[0, j, self._clock + 1 :] = np.nan
            side.world.script.paths[0, j, self._clock + 1] = x, y

    # ------------------------------------------------------------------ changes

    def _add_edit(self, edit: Edit) -> None:
        """Carry out an edit at the present moment; later ones are dropped."""

        def remains(other: Edit) -> bool:
            return other.time < edit.time or (other.time == edit.time and other[1:4] != edit[1:4])

        for side in self.sides:
            script, world = side.world.script, side.world
            assert script is not None
            for step, edits in script.edits.items():
                script.edits[step] = [other for other in edits if remains(other)]
            script.add(edit)
            if not side.is_over and edit.field != "action":
                script.carry_out(world.state, 0, edit)
                side.observe_again()
        self.scene.edits = [*filter(remains, self.scene.edits), edit]
        self._search = None  # it attacked another scene

    def _remember(self) -> None:
        """Keep the present moment, to which undoing the next change returns."""
        states = []
        for side in self.sides:
            script = side.world.script
            assert script is not None
            states.append(
                (
                    side.world.snapshot(),
                    script.paths.copy(),
                    dict(script.edits),
                    copy.deepcopy(side.agent),
                    (side.observation, side.decided_on, side.action),
                    list(side.snapshots),
                    list(side.explanations),
                )
            )
        moment = _Moment(self.scene.copy(), self._starts, list(self.sides), states, self.walker)
        self._undo.append(moment)
        del self._undo[:-_MOST_UNDO]

    def _take_back(self, message: dict[str, Any]) -> None:
        """Return to the moment before the last change."""
        if not self._undo:
            raise MessageError("nothing was changed that could be undone")
        self.scene, self._starts, self.sides, states, self.walker = self._undo.pop()
        for side, (snapshot, paths, edits, agent, decision, *lists) in zip(
            self.sides, states, strict=True
        ):
            script = side.world.script
            assert script is not None
            side.world.restore(snapshot)
            script.paths[:], script.edits = paths, edits
            side.agent = agent
            side.observation, side.decided_on, side.action = decision
            side.snapshots, side.explanations = lists
        self._walk_to = self._driven = self._search = None

    def _move(self, message: dict[str, Any]) -> None:
        """Move a person, a robot or the goal of a robot; a drag is many of these."""
        what, position = message.get("what"), _point(message, "position")
        s = self.sides[0].scenario
        counts = {"person": s.humans, "robot": s.robots, "goal": s.robots}
        if not isinstance(what, str) or what not in counts:
            raise MessageError(f"what is {what!r:.60}; it must be person, robot or goal")
        number = _whole(message, "number", 0, counts[what] - 1)
        if what == "person" and s.crowd == Crowd.recorded:
            raise MessageError("people of a recording cannot be moved; choose a simulated crowd")
        if what == "person" and not self.sides[0].world.state.human_present[0, number]:
            raise MessageError(f"number is {number}; that person is not present")
        self._must_run()
        if message.get("begins", True):
            self._remember()
        agent, field = ("robot", "goal") if what == "goal" else (str(what), "position")
        self._add_edit(Edit(self._now, agent, number, field, position))

    def _must_run(self) -> None:
        if all(side.is_over for side in self.sides):
            raise MessageError("the episode is over; restart it, undo, or choose the next case")

    def _continue_with(self, scene: Scene) -> None:
        """Continue with a scene that was made from the present moment."""
        self._remember()
        try:
            self._begin(scene, self.agents)
        except BaseException:
            self._undo.pop()
            raise

    def _wall(self, message: dict[str, Any]) -> None:
        """Draw a wall."""
        points = [list(_point(message, "start")), list(_point(message, "end"))]
        self._must_run()
        self._continue_with(self.scene.with_wall(points, self.sides[0].world.state))

    def _erase(self, message: dict[str, Any]) -> None:
        """Erase the wall at a place."""
        position = _point(message, "position")
        self._must_run()
        state = self.sides[0].world.state
        self._continue_with(self.scene.without_wall(position, self._open_layout, state))

    def _add(self, message: dict[str, Any]) -> None:
        """Add a person, who walks where the mouse goes."""
        position = _point(message, "position")
        self._must_run()
        self._continue_with(self.scene.with_person(position, self.sides[0].world.state))
        self.walker, self._walk_to = self.sides[0].scenario.humans - 1, position

    def _walk(self, message: dict[str, Any]) -> None:
        """Let the added person walk to a place."""
        if self.walker is None:
            raise MessageError("nobody was added who could walk; add a person first")
        self._walk_to = _point(message, "position")

    def _attack(self, message: dict[str, Any]) -> dict[str, Any] | None:
        """Search on for a path of a person that makes the first agent fail, or play the best."""
        if message.get("play"):
            if self._search is None or self._search.best is None or not self._search.best.fails:
                raise MessageError(f"no path was found that makes {self.agents[0]} fail")
            self._continue_with(self._search.attacked_scene())
            return None
        if self._search is None:
            self._search = Attack(self.sides[0].agent, self.scene, self._folder)
        self._search.run_generation()
        best = self._search.best
        assert best is not None
        return {
            "type": "attack",
            "tried": self._search.tried,
            "seconds": round(self._search.seconds, 1),
            "change": round(best.cost, 2) if best.fails else None,
            "failure": best.failure,
            "over": self._search.is_over or self._search.seconds > LONGEST_ATTACK,
        }

    def _drive(self, message: dict[str, Any]) -> None:
        """Drive a robot by keys, or leave it to its agent again."""
        if message.get("robot") is None:
            self._driven = None
            return
        robot = _whole(message, "robot", 0, self.sides[0].scenario.robots - 1)
        keys = message.get("keys", [])
        if not isinstance(keys, list) or not all(key in KEYS for key in keys):
            raise MessageError(f"keys is {keys!r:.60}; it must be some of {', '.join(KEYS)}")
        if self._driven is None or self._driven.robot != robot:
            self._must_run()
            self._remember()
        self._driven = _Driven(robot, keys)


def _case_text(case: int) -> int:
    """Return the index of a case in its split."""
    return Split.of(case)[1]


def _whole(message: dict[str, Any], name: str, low: int, high: int) -> int:
    value = message.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise MessageError(f"{name} is {value!r:.60}; it must be a whole number in [{low}, {high}]")
    return value


def _point(message: dict[str, Any], name: str) -> tuple[float, float]:
    """Return the point [x, y] of a message, to the centimetre."""
    value = message.get(name)
    valid = (
        isinstance(value, list)
        and len(value) == 2
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        and all(abs(x) <= _FARTHEST for x in value)
    )
    if not valid:
        raise MessageError(
            f"{name} is {value!r:.60}; it must be two numbers in [-{_FARTHEST:g}, {_FARTHEST:g}]"
        )
    x, y = value  # type: ignore[misc]
    return round(float(x), 2), round(float(y), 2)
