"""Named tasks, whose numbers never change: `mrsan/Doorway-v0`.

An id names the same worlds in Gymnasium, PettingZoo, TorchRL, on the command line and in tables.
`tests/mrsan/test_tasks.py` holds a digest of an episode of each: whoever changes what happens in a
task raises its version.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from mrsan.fields import ConfigurationError
from mrsan.scenario import Scenario
from mrsan.suggestions import choice_hint


@dataclass(frozen=True)
class Task:
    """A named scenario."""

    id: str  # `mrsan/NAME-vVERSION`
    family: str  # similar tasks
    about: str  # in one line
    fields: dict[str, Any]  # of `Scenario`; the others have their defaults

    @property
    def scenario(self) -> Scenario:
        """Return the scenario."""
        return Scenario(**self.fields)


_MSA3C = {  # Table 1 of MSA3C and, where it is silent, values of its authors (docs/decisions.md)
    "robots": 3,  # as in its Table 2
    "goal_rotation_range_degrees": 180.0,  # goals anywhere on the circle, as path lengths imply
    "time_limit": 37.5,  # s: 150 steps
    "terminate_on_collision": False,  # its collision rate counts collisions per 100 episodes
    "kinematics": "holonomic",  # velocities are reached immediately
    "robot_radius": 0.3,  # of the safety zone; its 0.6 m are read as the diameter
    "radius_noise": 0.05,  # of the observed safety zones, sampled at every step, m; our choice
    "crowd": "social_force",  # people ignore robots
    "human_radius_min": 0.25,  # of the safety zone; its 0.5 to 1.3 m are read as the diameter
    "human_radius_max": 0.65,
    "human_speed_min": 0.5,  # m/s
    "human_speed_max": 1.5,
    "goal_change_probability": 0.2,  # sampled per person, every 5 s
    "goal_change_probability_max": 0.3,
    "reward": {  # its Eq. 2
        "arrival": 0.0,
        "team": 0.0,
        "progress": 0.0,
        "collision": -1.0,  # per step of contact; -5 in its second stage
        "discomfort_limit": -0.5,  # lower limit in the comfort zone of a person,
        "discomfort_distance": 0.25,  # width of the comfort zone, m
        "goal_distance": 1.0,  # times the goal distance over the squared radius of the circle
        "time": -0.001,  # per step
    },
}


def _samarl(view: float, robots: int) -> Task:
    about = f"{robots} robots that see {view:g}° cross a circle with 10 people (SAMARL, Table I)"
    fields = {"fov_degrees": view, "humans": 10, "robots": robots}
    return Task(f"mrsan/SAMARL-{view:g}-{robots}-v0", "SAMARL's circle", about, fields)


def _msa3c(name: str, humans: int, radius: float) -> Task:
    about = f"3 holonomic robots and {humans} people who walk by social forces (MSA3C, Table 2)"
    fields = {**_MSA3C, "name": name, "humans": humans, "circle_radius": radius}
    return Task(f"mrsan/MSA3C-{name}-v0", "MSA3C's circle", about, fields)


def _open(name: str, about: str) -> Task:
    about = f"3 robots drive across 10 people, who {about}"
    fields = {"layout": name.lower(), "humans": 10, "robots": 3}
    return Task(f"mrsan/{name}-v0", "Open floor", about, fields)


def _walled(name: str, layout: str, humans: int, robots: int, about: str, **sizes: float) -> Task:
    fields = {"layout": layout, "humans": humans, "robots": robots}
    about = f"{robots} robots and {humans} people, who avoid robots, {about}"
    family = "Narrow passages" if sizes else "Walled environments"
    place = {"place": sizes} if sizes else {}
    fields |= {"crowd_reaction": "reciprocal", **place}
    return Task(f"mrsan/{name}-v0", family, about, fields)


_NARROW = "pass an opening that hardly holds two robots"
TASKS = {  # by the name of the newest version, as in `scenario=doorway`
    "samarl-90-3": _samarl(90.0, 3),
    "samarl-90-5": _samarl(90.0, 5),
    "samarl-360-5": _samarl(360.0, 5),
    "samarl-360-3": _samarl(360.0, 3),
    "5p3r": _msa3c("5p3r", 5, 6.0),
    "10p3r": _msa3c("10p3r", 10, 8.0),
    "20p3r": _msa3c("20p3r", 20, 10.0),
    "crossing": _open("Crossing", "walk in two streams at right angles"),
    "opposite": _open("Opposite", "walk in two opposite streams"),
    "square": _open("Square", "walk anywhere"),
    "doorway": _walled("Doorway", "doorway", 4, 3, "pass one doorway"),
    "corridor": _walled("Corridor", "corridor", 4, 3, "pass one corridor"),
    "intersection": _walled("Intersection", "intersection", 6, 3, "meet where corridors cross"),
    "corner": _walled("Corner", "corner", 4, 3, "meet at a blind corner"),
    "rooms": _walled("Rooms", "rooms", 8, 3, "walk from room to room"),
    "pillars": _walled("Pillars", "pillars", 8, 3, "walk among pillars"),
    "narrow_doorway": _walled(
        "NarrowDoorway", "doorway", 4, 4, _NARROW, door_width_min=1.0, door_width_max=1.3
    ),
    "narrow_corridor": _walled(
        "NarrowCorridor", "corridor", 4, 4, _NARROW, corridor_width_min=1.0, corridor_width_max=1.3
    ),
}
IDS = {task.id: task for task in TASKS.values()}


def find_task(name: str) -> Task:
    """Return a task by its id, or the newest version of a task by its name in `TASKS`.

    Raises:
        ConfigurationError: there is no such task.
    """
    tasks = IDS | TASKS
    if name not in tasks:
        hint = choice_hint(name, list(tasks), "mrsan.TASKS lists the tasks")
        raise ConfigurationError(f"scenario is {name!r:.60}, which does not exist; {hint}")
    return tasks[name]


def overridden(scenario: Scenario | str | None, overrides: dict[str, Any]) -> Scenario:
    """Return a scenario with some of its fields changed.

    Args:
        scenario: the scenario, or a task, see `find_task`; None: SAMARL's.
        overrides: values by the names of the fields.

    Raises:
        ConfigurationError: it is no scenario or a value is invalid.
        UnknownFieldError: there is no such field.
    """
    if isinstance(scenario, str):
        scenario = find_task(scenario).scenario
    if not isinstance(scenario, Scenario | None):
        raise ConfigurationError(
            f"scenario is {scenario!r}; it must be a Scenario or the id of a task (pass other "
            "settings by name)"
        )
    return dataclasses.replace(scenario or Scenario(), **overrides)
