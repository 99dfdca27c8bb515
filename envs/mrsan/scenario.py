"""The scenario: its fields, checked, and what follows from them."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mrsan.case_file import map_of_case, read_case_file
from mrsan.choices import ACTION_SIZE, Crowd, Layout, TeamPerception
from mrsan.consistency import check_consistency
from mrsan.crowds import check_crowd
from mrsan.fields import (
    ConfigurationError,
    UnknownFieldError,
    check_numbers,
    from_mapping,
    short_repr,
)
from mrsan.fixed_map import FixedMap, fixed_map, map_centre
from mrsan.groups import Groups, check_groups
from mrsan.place import Place, check_place, half_size, largest_place
from mrsan.reactions import Reactions, check_reactions
from mrsan.recording import NOBODY, Recording, RecordingError, load_recording
from mrsan.reward import Reward, check_reward
from mrsan.scenario_fields import ScenarioFields
from mrsan.sensors.registry import check_sensors
from mrsan.suggestions import choice_hint

DEFAULT_NEAREST_WALLS = 12  # that robots see in places with walls


def _suggesting_fields(cls: type) -> type:
    """Let a dataclass refuse an unknown keyword with the field that is probably meant."""
    init: Any = cls.__init__  # type: ignore[misc]
    names = [f.name for f in dataclasses.fields(cls)]

    @functools.wraps(init)
    def checked_init(self: Any, *arguments: Any, **values: Any) -> None:
        for name, value in values.items():
            if name not in names:
                hint = choice_hint(name, names, f"it must be a field of {cls.__name__}")
                raise UnknownFieldError(f"unexpected keyword argument '{name}' ({value!r}); {hint}")
        init(self, *arguments, **values)

    cls.__init__ = checked_init  # type: ignore[misc]
    return cls


@_suggesting_fields
@dataclass(repr=False)
class Scenario(ScenarioFields):
    """One multi-robot socially-aware navigation task; the defaults are SAMARL's.

    Construct it, or change fields with `dataclasses.replace`; both check every number. `reward`,
    `place`, `reactions` and `groups` may be mappings, as in `Scenario(reward={"collision": -5.0})`;
    their other fields then have their defaults.
    """

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            ConfigurationError: names the field, its value and what would be right.
        """
        check_numbers(self, "scenario")
        self.reward = from_mapping(Reward, self.reward, "scenario.reward")
        check_reward(self.reward)
        self.place = from_mapping(Place, self.place, "scenario.place")
        check_place(self.place)
        self.reactions = from_mapping(Reactions, self.reactions, "scenario.reactions")
        check_reactions(self.reactions)
        self.groups = from_mapping(Groups, self.groups, "scenario.groups")
        check_groups(self.groups)
        check_crowd(self.crowd, self.crowd_settings)
        self.crowd = str(self.crowd)
        check_sensors(self.sensors)
        check_consistency(self)

    @property
    def action_size(self) -> int:
        """Return how many numbers in [-1, 1] drive one robot."""
        return ACTION_SIZE[self.kinematics]

    @property
    def walls_observed(self) -> int:
        """Return the largest number of walls that a robot observes."""
        usual = DEFAULT_NEAREST_WALLS if self.has_walls else 0
        return usual if self.nearest_walls is None else self.nearest_walls

    @property
    def route_clearance(self) -> float:
        """Return the distance that routes keep from walls, m: they suit all robots and people."""
        return max(self.robot_radius, self.human_radius_max) + self.place.feasible_margin

    @property
    def fixed_map(self) -> FixedMap:
        """Return the walls of the map file about its middle; empty arrays without one."""
        if self.case_file is not None and read_case_file(self.case_file).walls:
            return map_of_case(self.case_file, self.route_clearance)
        return fixed_map(self.map, self.route_clearance)

    @property
    def file_origin(self) -> tuple[float, float]:
        """Return the coordinates that the world's origin has in the file of its place, m.

        The file is the map, whose middle is the origin, or the recording, whose floor's middle is;
        other worlds have none, and (0, 0).
        """
        if self.layout is Layout.map:
            return map_centre(self.map)
        x, y = self.load_recording().centre.tolist()
        return x, y

    @property
    def most_walls(self) -> int:
        """Return the largest number of wall segments of a place."""
        return self._place_size[0]

    @property
    def most_corners(self) -> int:
        """Return the largest number of corners of the route graph of a place."""
        return self._place_size[1]

    @property
    def _place_size(self) -> tuple[int, int]:
        if self.layout is Layout.map:
            return self.fixed_map.walls.shape[1], self.fixed_map.corners.shape[1]
        return largest_place(self.layout)

    @property
    def time_limit_steps(self) -> int:
        """Return the time limit in steps."""
        return self.steps(self.time_limit)

    @property
    def max_turn(self) -> float:
        """Return the greatest turn of a robot in one step, rad."""
        return math.radians(min(self.max_turn_rate * self.time_step, 180.0))

    @property
    def team_tracks(self) -> bool:
        """Return whether robots report the agents they see to each other."""
        return self.team_perception is TeamPerception.tracks

    @property
    def team_delay_steps(self) -> int:
        """Return the delay of team-mates' reports in steps."""
        return self.steps(self.team_delay)

    def load_recording(self) -> Recording:
        """Return the recorded people, resampled to the time step; nobody for other crowds.

        Raises:
            ConfigurationError: the file cannot be read, has an invalid line, is implausible, or
                its floor is too small for `route_length_min`.
        """
        if self.crowd != Crowd.recorded:
            return NOBODY
        try:
            recording = load_recording(
                self.recording,
                self.frame_seconds,
                self.time_step,
                self.recording_scale,
                self.recording_check,
            )
        except RecordingError as error:
            raise ConfigurationError(f"scenario.{error}") from None
        diagonal = 2.0 * float(np.linalg.norm(recording.half_size))
        if self.route_length_min > 0.7 * diagonal:
            raise ConfigurationError(
                f"scenario.route_length_min is {self.route_length_min}; it must be at most "
                f"{0.7 * diagonal:.1f} for this recording"
            )
        return recording

    def describe_shortage(self, robots: bool, case: int) -> str:
        """Return the message that a case has no room for all robots, or for all people.

        Args:
            robots: the robots have no room; otherwise the people.
            case: its number.
        """
        clearance = f"scenario.spawn_clearance is {self.spawn_clearance}"
        if not robots:
            return (
                f"scenario.humans is {self.humans}; case {case} has no room for so many: "
                f"{clearance}, scenario.human_radius_max is {self.human_radius_max}"
            )
        if self.crowd == Crowd.recorded:
            place = f"on the recorded floor with scenario.human_radius_max {self.human_radius_max}"
        elif self.has_walls:
            place = f"in layout {self.layout.name}"
        elif self.layout is Layout.circle:
            place = f"on a circle of scenario.circle_radius {self.circle_radius}"
        else:
            place = f"on a floor of scenario.floor_size {self.floor_size}"
        return (
            f"scenario.robots is {self.robots}; case {case} has no room for so many {place}: "
            f"{clearance}, scenario.robot_radius is {self.robot_radius}, "
            f"scenario.route_length_min is {self.route_length_min}"
        )

    @property
    def half_extent(self) -> float:
        """Return the largest distance of a start from the origin along an axis, m."""
        if self.crowd == Crowd.recorded:
            return float(self.load_recording().half_size.max())
        circle = self.circle_radius + self.spawn_jitter * max(
            self.robot_speed, self.human_speed_max
        )
        if self.layout is Layout.circle:
            return circle
        if self.layout is Layout.map:
            left, bottom, right, top = map(float, self.fixed_map.zone)
            return max(right - left, top - bottom) / 2
        if self.has_walls:
            return half_size(self.layout, self.place)
        return max(self.floor_size / 2, circle if self.layout is Layout.mixed else 0.0)


def scenario_of_case(path: str, overrides: dict[str, Any]) -> Scenario:
    """Return the scenario of a case file, with some of its fields changed.

    Args:
        path: the file, which becomes `Scenario.case_file`.
        overrides: values by the names of the fields.

    Raises:
        ConfigurationError: the file or a value is invalid.
    """
    fields = read_case_file(path).scenario
    return Scenario(**{**fields, "case_file": path, **overrides})
