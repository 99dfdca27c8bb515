"""The scenario: every number of the simulated world, with its unit and its permitted range."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mrsan.case_file import map_of_case, read_case_file
from mrsan.choices import (
    ACTION_SIZE,
    Crowd,
    CrowdReaction,
    Kinematics,
    Layout,
    LidarTargets,
    TeamPerception,
)
from mrsan.consistency import check_consistency
from mrsan.crowds import check_crowd
from mrsan.fields import (
    ConfigurationError,
    UnknownFieldError,
    check_numbers,
    from_mapping,
    number,
    setting,
    short_repr,
)
from mrsan.fixed_map import FixedMap, fixed_map, map_centre
from mrsan.groups import Groups, check_groups
from mrsan.place import Place, check_place, half_size, largest_place
from mrsan.reactions import Reactions, check_reactions
from mrsan.recording import NOBODY, Recording, RecordingError, load_recording
from mrsan.reward import Reward
from mrsan.reward_terms import check_reward_terms
from mrsan.sensors.sensor import check_sensors
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
@dataclass
class Scenario:
    """One multi-robot socially-aware navigation task; the defaults are SAMARL's.

    Construct it, or change fields with `dataclasses.replace`; both check every number. `reward`,
    `place`, `reactions` and `groups` may be mappings, as in `Scenario(reward={"collision": -5.0})`;
    their other fields then have their defaults.
    """

    __repr__ = short_repr

    name: str = setting("samarl", help="scenario=name that it is, or is a variant of")

    # The agents.
    robots: int = number(3, 1, 16, help="number of robots")
    humans: int = number(10, 0, 64, help="largest number of people")
    humans_min: int | None = number(
        None, 0, 64, help="smallest number of people, drawn per episode; null: always humans"
    )

    # The place and the clock.
    layout: Layout = setting(Layout.circle, help="where agents start and go")
    map: str | None = setting(None, help="file of walls, for layout map")
    case_file: str | None = setting(
        None, help="file of one case, saved by samarl-play: its start, walls, people and changes"
    )
    map_known: bool = setting(True, help="robots know the map: they observe the next corner")
    place: Place = field(default_factory=Place)
    circle_radius: float = number(
        5.0, 2.0, 1000.0, unit="m", help="radius of the circle on which agents start"
    )
    goal_turn_degrees: float = number(
        0.0, -180.0, 180.0, unit="degrees", help="rotation of the robots' goals about the origin"
    )
    goal_rotation_range_degrees: float = number(
        0.0, 0.0, 180.0, unit="degrees", help="half-width of the rotation drawn per robot"
    )
    floor_size: float = number(
        14.0, 6.0, 1000.0, unit="m", help="side of the floor of layouts other than the circle"
    )
    route_length_min: float = number(
        4.0, 0.0, 1000.0, unit="m", help="shortest straight route, except in the circle"
    )
    route_length_max: float = number(
        14.0, 0.1, 1000.0, unit="m", help="longest straight route, except in the circle"
    )
    spawn_jitter: float = number(
        0.5,
        0.0,
        2.0,
        unit="m",
        help="half-width of the noise on start coordinates, at 1 m/s",
    )
    spawn_clearance: float = number(
        0.4, 0.0, 10.0, unit="m", help="smallest distance between the surfaces of starting agents"
    )
    arena_radius: float | None = number(
        None, 0.0, 10000.0, unit="m", help="radius of a round wall for robots (null: no wall)"
    )
    time_step: float = number(0.25, 0.01, 1.0, unit="s", help="duration of a step")
    time_limit: float = number(50.0, 0.01, 10000.0, unit="s", help="longest duration of an episode")
    terminate_on_collision: bool = setting(
        True, help="collisions end the episode; false: they are counted and robots drive on"
    )

    # The robots.
    kinematics: Kinematics = setting(Kinematics.acceleration_heading, help="meaning of an action")
    robot_radius: float = number(0.3, 0.05, 2.0, unit="m", help="radius of a robot")
    robot_speed: float = number(
        1.0, 0.05, 10.0, unit="m/s", help="preferred and greatest speed of a robot"
    )
    max_acceleration: float = number(
        5.0, 0.01, 1000.0, unit="m/s^2", help="greatest acceleration (SAMARL, Eq. 3)"
    )
    max_turn_rate: float = number(
        60.0, 0.1, 18000.0, unit="degrees/s", help="greatest turn rate: 15 a step in SAMARL, Eq. 3"
    )
    min_turning_radius: float = number(
        1.0, 0.001, 100.0, unit="m", help="smallest turning radius (SAMARL, Eq. 3)"
    )
    turn_in_place: bool = setting(
        True, help="robots at a standstill may turn; false: Eq. 3 to the letter"
    )

    # What robots see.
    fov_degrees: float = number(
        360.0, 0.0, 360.0, above=True, unit="degrees", help="field of view, centred on the heading"
    )
    sensing_range: float = number(10.0, 0.1, 1000.0, unit="m", help="range of the sensor")
    occlusion: bool = setting(False, help="people and robots hide agents behind them")
    walls_occlude: bool = setting(True, help="walls hide agents behind them")
    nearest_walls: int | None = number(
        None, 0, 64, help="largest number of walls a robot sees; null: 12, or 0 without walls"
    )
    lidar_rays: int = number(0, 0, 1024, help="number of rays of a lidar; 0: robots have none")
    lidar_range: float = number(10.0, 0.1, 1000.0, unit="m", help="range of the lidar")
    lidar_fov_degrees: float = number(
        360.0, 0.0, 360.0, above=True, unit="degrees", help="field of view of the lidar"
    )
    lidar_noise: float = number(0.01, 0.0, 10.0, unit="m", help="standard deviation of its ranges")
    lidar_noise_share: float = number(
        0.01, 0.0, 1.0, help="a further standard deviation, as a share of the range"
    )
    lidar_dropout: float = number(0.01, 0.0, 1.0, help="probability of losing a ray, per step")
    lidar_targets: LidarTargets = setting(LidarTargets.walls, help="what stops its rays")
    next_passages: int = number(
        0, 0, 8, help="number of doors and corridors ahead on its route that a robot observes"
    )
    position_noise: float = number(
        0.0, 0.0, 10.0, unit="m", help="standard deviation of observed positions"
    )
    velocity_noise: float = number(
        0.0, 0.0, 10.0, unit="m/s", help="standard deviation of observed velocities"
    )
    radius_noise: float = number(
        0.0, 0.0, 2.0, unit="m", help="standard deviation of people's observed radii"
    )
    missed_detection: float = number(
        0.0, 0.0, 1.0, help="probability of missing an agent, per step"
    )

    sensors: dict[str, Any] = field(
        default_factory=dict,
        metadata={"help": "further sensors, with their settings: sensors.name.setting=value"},
    )

    # What robots report to each other.
    team_perception: TeamPerception = setting(
        TeamPerception.none, help="what robots report to each other"
    )
    team_range: float = number(20.0, 0.0, 10000.0, unit="m", help="range of a report")
    team_delay: float = number(0.0, 0.0, 10.0, unit="s", help="delay of a report")
    team_loss: float = number(
        0.0, 0.0, 1.0, help="probability of losing a report, per step, sender and receiver"
    )
    team_messages: bool = setting(
        False,
        help="robots tell each other where they are, a random priority, whether their way to the "
        "goal is clear, and their macro action",
    )

    # The people.
    crowd: str = setting(
        "orca",
        help="how people move: orca | social_force | still | recorded, or a model that "
        "plugins=[module] registers",
    )
    crowd_settings: dict[str, Any] = field(
        default_factory=dict,
        metadata={"help": "settings of a registered crowd model: crowd_settings.name=value"},
    )
    start_clear_time: float = number(
        2.0, 0.0, 100.0, unit="s", help="time for which no recorded person crosses a robot's start"
    )
    slot_reuse_delay: float = number(
        6.0, 0.0, 1000.0, unit="s", help="pause before a slot holds another recorded person"
    )
    recording: str | None = setting(
        None, help="file of recorded people; null: the synthetic one that ships"
    )
    frame_seconds: float | None = number(
        None, 1e-4, 100.0, unit="s", help="time per frame number (null: as in the file, else 0.04)"
    )
    recording_scale: float | None = number(
        None, 1e-6, 1e6, unit="m", help="length of a unit (null: as in the file, else 1)"
    )
    recording_check: bool = setting(
        True, help="refuse a recording that is implausible for pedestrians"
    )
    crowd_reaction: CrowdReaction = setting(CrowdReaction.blind, help="how people react to robots")
    reactions: Reactions = field(default_factory=Reactions)
    groups: Groups = field(default_factory=Groups)
    human_radius_min: float = number(
        0.3, 0.05, 2.0, unit="m", help="smallest radius, drawn per person"
    )
    human_radius_max: float = number(
        0.3, 0.05, 2.0, unit="m", help="largest radius, drawn per person"
    )
    human_speed_min: float = number(
        1.0, 0.05, 10.0, unit="m/s", help="smallest preferred speed, drawn per person"
    )
    human_speed_max: float = number(
        1.0, 0.05, 10.0, unit="m/s", help="largest preferred speed, drawn per person"
    )
    human_safety_space: float = number(
        0.25, 0.0, 5.0, unit="m", help="margin that people add to every radius they avoid"
    )
    goal_distance: float = number(
        4.0, 0.0, 1000.0, unit="m", help="smallest distance to a person's new goal"
    )
    goal_change_interval: float = number(
        5.0, 0.01, 10000.0, unit="s", help="interval at which people may change their goals"
    )
    goal_change_probability: float = number(
        0.5, 0.0, 1.0, help="probability of a new goal at each interval"
    )
    goal_change_probability_max: float | None = number(
        None, 0.0, 1.0, help="largest such probability, drawn per person; null: the same for all"
    )
    stand_probability: float = number(
        0.0, 0.0, 1.0, help="probability of standing still until the next interval"
    )
    hurry_probability: float = number(0.0, 0.0, 1.0, help="share of people in a hurry")
    hurry_speed_min: float = number(
        1.5, 0.05, 10.0, unit="m/s", help="smallest preferred speed of people in a hurry"
    )
    hurry_speed_max: float = number(
        2.0, 0.05, 10.0, unit="m/s", help="largest preferred speed of people in a hurry"
    )
    pair_probability: float = number(
        0.0, 0.0, 1.0, help="probability that the next two people walk together"
    )
    late_probability: float = number(0.0, 0.0, 1.0, help="share of people who enter later")
    late_time: float = number(20.0, 0.0, 10000.0, unit="s", help="latest time at which they enter")
    leave_probability: float = number(
        0.0, 0.0, 1.0, help="probability of leaving at a goal instead of taking a new one"
    )
    neighbor_distance: float = number(
        10.0, 0.1, 1000.0, unit="m", help="ORCA: agents farther away are ignored"
    )
    max_neighbors: int = number(10, 1, 80, help="ORCA: largest number of neighbours considered")
    time_horizon: float = number(
        5.0, 0.01, 100.0, unit="s", help="ORCA: time for which velocities are free of collisions"
    )
    time_horizon_obstacles: float = number(
        2.0, 0.01, 100.0, unit="s", help="ORCA: the same for collisions with walls"
    )
    relaxation_time: float = number(
        0.5, 0.01, 10.0, unit="s", help="social force: time to reach the preferred velocity"
    )
    force_strength: float = number(
        7.0, 0.0, 1000.0, unit="m/s^2", help="social force: repulsion at contact"
    )
    force_range: float = number(
        0.3,
        0.01,
        10.0,
        unit="m",
        help="social force: distance in which repulsion decays by factor e",
    )

    reward: Reward = field(default_factory=Reward)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            ConfigurationError: names the field, its value and what would be right.
        """
        check_numbers(self, "scenario")
        self.reward = from_mapping(Reward, self.reward, "scenario.reward")
        check_numbers(self.reward, "scenario.reward")
        self.place = from_mapping(Place, self.place, "scenario.place")
        check_reward_terms(self.reward.terms)
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
    def has_walls(self) -> bool:
        """Return whether the place has walls."""
        return self.layout.has_walls

    @property
    def robots_avoided(self) -> bool:
        """Return whether everybody avoids robots as people."""
        return self.crowd_reaction is CrowdReaction.reciprocal

    @property
    def is_social(self) -> bool:
        """Return whether people draw a reaction to robots or belong to groups."""
        return self.crowd_reaction is CrowdReaction.mixed or self.groups.share > 0.0

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

    def steps(self, duration: float) -> int:
        """Convert a duration in seconds to the nearest number of steps."""
        return round(duration / self.time_step)

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
