"""Every number of the simulated world, with its unit and its permitted range."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, get_type_hints

import numpy as np

from mrsan.kernels import kinematics as kinematics_kernel
from mrsan.kernels import layout as layout_kernel
from mrsan.kernels import recorded as recorded_kernel
from mrsan.kernels import step as step_kernel
from mrsan.kernels import team as team_kernel
from mrsan.parameters import Parameters
from mrsan.recording import NOBODY, Recording, RecordingError, load_recording


class ConfigurationError(ValueError):
    """A number or name that cannot be used; the message says which, and what would be right."""


class UnknownFieldError(ConfigurationError, TypeError):
    """A keyword that is no field; a `TypeError` too, which libraries that try keywords expect."""


class Crowd(Enum):
    """How the people move."""

    orca = step_kernel.ORCA
    social_force = step_kernel.SOCIAL_FORCE
    still = step_kernel.STILL
    recorded = recorded_kernel.RECORDED  # as in a file; at most `humans` at once, the nearest


class Layout(Enum):
    """Where everybody starts and wants to go."""

    circle = layout_kernel.CIRCLE  # across a circle: SAMARL
    crossing = layout_kernel.CROSSING  # people in two streams at right angles
    opposite = layout_kernel.OPPOSITE  # people in two streams along one band
    square = layout_kernel.SQUARE  # people anywhere on a square floor
    mixed = layout_kernel.MIXED  # one of these four, drawn per episode


class TeamPerception(Enum):
    """What robots tell each other."""

    none = team_kernel.NONE  # nothing: SAMARL
    tracks = team_kernel.TRACKS  # whom they see, and their own poses


class Kinematics(Enum):
    """What an action means to a robot."""

    acceleration_heading = kinematics_kernel.ACCELERATION_HEADING  # SAMARL, Eq. 1-3
    holonomic = kinematics_kernel.HOLONOMIC  # a velocity in the body frame
    unicycle = kinematics_kernel.UNICYCLE  # a forward speed and a heading change


ACTION_SIZE = {
    Kinematics.acceleration_heading: 3,
    Kinematics.holonomic: 2,
    Kinematics.unicycle: 2,
}


def number(default: Any, low: float, high: float, above: bool = False) -> Any:
    """A dataclass field that must lie in [low, high], or in (low, high] with `above`."""
    return field(default=default, metadata={"low": low, "high": high, "above": above})


def required(low: float, high: float) -> Any:
    """A dataclass field without a default that must lie in [low, high]."""
    return field(metadata={"low": low, "high": high, "above": False})


def check_numbers(config: Any, path: str) -> None:
    """Check every field of a dataclass made with `number` and every enum and switch.

    Args:
        config: a dataclass instance.
        path: prefix of its fields in messages, such as `scenario`; may be empty.

    Raises:
        ConfigurationError: names the first field that is wrong, its value and its range.
    """
    hints = get_type_hints(type(config))
    for f in dataclasses.fields(config):
        name, value, hint = f"{path}.{f.name}", getattr(config, f.name), hints[f.name]
        name = name.removeprefix(".")
        if isinstance(hint, type) and issubclass(hint, Enum):
            if isinstance(value, str) and value in hint.__members__:
                setattr(config, f.name, hint[value])
            elif not isinstance(value, hint):
                choices = ", ".join(hint.__members__)
                raise ConfigurationError(f"{name} is {value!r}; it must be one of {choices}")
        elif hint is bool:
            if not isinstance(value, bool):
                raise ConfigurationError(f"{name} is {value!r}; it must be true or false")
        elif "low" in f.metadata:
            _check_number(name, value, hint, f.metadata)


def _check_number(name: str, value: Any, hint: Any, metadata: Any) -> None:
    low, high, above = metadata["low"], metadata["high"], metadata["above"]
    optional = type(None) in getattr(hint, "__args__", ())
    if optional and value is None:
        return
    whole = hint is int or int in getattr(hint, "__args__", ())
    kind = (int, np.integer) if whole else (int, float, np.integer, np.floating)
    good = isinstance(value, kind) and not isinstance(value, bool) and low <= value <= high
    if not good or (above and value == low):
        what = "be a whole number" if whole else "lie"
        none = " or be null" if optional else ""
        bracket = "(" if above else "["
        raise ConfigurationError(
            f"{name} is {value!r}; it must {what} in {bracket}{low:g}, {high:g}]{none}"
        )


@dataclass
class Reward:
    """Weights of SAMARL, Eq. 10, and of the terms that MSA3C, Eq. 2 to 4, has besides."""

    arrival: float = number(10.0, -1e6, 1e6)  # to a robot that reaches its goal
    team: float = number(5.0, -1e6, 1e6)  # to every robot when the last one arrives
    collision: float = number(-20.0, -1e6, 1e6)  # to a robot that runs into somebody
    discomfort: float = number(1.0, 0.0, 1e6)  # w in max(-w / d, limit)
    discomfort_limit: float = number(-5.0, -1e6, 0.0)
    discomfort_distance: float = number(0.45, 0.0, 100.0)  # d below which it applies, m
    progress: float = number(2.0, -1e6, 1e6)  # per metre nearer to the goal
    goal_distance: float = number(0.0, 0.0, 1e6)  # taken off per step, times d_g / circle_radius^2
    time: float = number(0.0, -1e6, 1e6)  # per step on its way
    literal: bool = False  # the paper's first-match order: the last to arrive gets only `team`
    lookahead: float = number(0.0, 0.0, 1e6)  # w in -w exp(-k), somebody too near in k steps
    lookahead_steps: int = number(5, 1, 200)  # k at most
    lookahead_distance: float = number(0.25, 0.0, 100.0)  # nearer is too near, m
    lookahead_predictor: str = "constant_velocity"  # of people: a name or a file of weights


@dataclass
class Scenario:
    """One multi-robot socially-aware navigation task; the defaults are SAMARL's.

    Construct it, change fields with `dataclasses.replace`; both check every number.
    """

    name: str = "samarl"  # of the file in conf/scenario/ that it is, or a variant of

    # Who is there.
    robots: int = number(3, 1, 16)  # how many
    humans: int = number(10, 0, 64)  # how many at most
    humans_min: int | None = number(
        None, 0, 64
    )  # drawn per episode up to `humans`; null: always all

    # The place and the clock.
    layout: Layout = Layout.circle
    circle_radius: float = number(5.0, 2.0, 1000.0)  # everybody starts on this circle, m
    goal_turn_degrees: float = number(0.0, -180.0, 180.0)  # robots' goals, about the middle
    goal_turn_spread_degrees: float = number(0.0, 0.0, 180.0)  # drawn per robot, +- about that
    floor_size: float = number(14.0, 6.0, 1000.0)  # side of the floor of the other layouts, m
    crossing_width: float = number(8.0, 1.0, 1000.0)  # of each of two streams at right angles, m
    opposite_width: float = number(6.0, 1.0, 1000.0)  # of the band with two opposite streams, m
    robot_way_min: float = number(4.0, 0.0, 1000.0)  # straight, not in the circle, m
    robot_way_max: float = number(14.0, 0.1, 1000.0)
    spawn_jitter: float = number(0.5, 0.0, 2.0)  # +- per coordinate, times the preferred speed, m
    spawn_clearance: float = number(0.4, 0.0, 10.0)  # surface distance kept between starts, m
    arena_radius: float | None = number(
        None, 0.0, 10000.0
    )  # a round wall for robots, m; null: open
    time_step: float = number(0.25, 0.01, 1.0)  # s
    time_limit: float = number(50.0, 0.01, 10000.0)  # s
    collisions_end: bool = True  # the episode; false: they are counted and robots drive on

    # The robots.
    kinematics: Kinematics = Kinematics.acceleration_heading
    robot_radius: float = number(0.3, 0.05, 2.0)  # m
    robot_speed: float = number(1.0, 0.05, 10.0)  # preferred and greatest speed, m/s
    max_acceleration: float = number(5.0, 0.01, 1000.0)  # m/s^2, SAMARL, Eq. 3
    max_turn_rate: float = number(60.0, 0.1, 18000.0)  # degrees/s: 15 a step in SAMARL, Eq. 3
    min_turning_radius: float = number(1.0, 0.001, 100.0)  # m, SAMARL, Eq. 3
    turn_in_place: bool = True  # at standstill; false: Eq. 3 to the letter

    # What they see.
    fov_degrees: float = number(360.0, 0.0, 360.0, above=True)  # centred on the heading
    sensing_range: float = number(10.0, 0.1, 1000.0)  # m
    occlusion: bool = False  # people and robots hide those behind them
    position_noise: float = number(0.0, 0.0, 10.0)  # standard deviation, m
    velocity_noise: float = number(0.0, 0.0, 10.0)  # standard deviation, m/s
    radius_noise: float = number(0.0, 0.0, 2.0)  # of people, standard deviation, m
    missed_detection: float = number(0.0, 0.0, 1.0)  # probability per agent and step

    # What they tell each other.
    team_perception: TeamPerception = TeamPerception.none
    team_range: float = number(20.0, 0.0, 10000.0)  # it reaches so far, m
    team_delay: float = number(0.0, 0.0, 10.0)  # s
    team_loss: float = number(0.0, 0.0, 1.0)  # probability per step, teller and listener

    # The people.
    crowd: Crowd = Crowd.orca
    recorded_start_clear: float = number(2.0, 0.0, 100.0)  # nobody crosses a start so early, s
    recorded_slot_rest: float = number(6.0, 0.0, 1000.0)  # before a slot holds another person, s
    recording: str | None = None  # a file of recorded people; null: a synthetic one that ships
    frame_seconds: float | None = number(
        None, 1e-4, 100.0
    )  # from one of its frame numbers to the next, s; null: what the file states, else 0.04
    recording_scale: float | None = number(
        None, 1e-6, 1e6
    )  # metres per unit of its positions; null: what the file states, else 1
    recording_check: bool = True  # refuse a file that is implausible of people who walk
    robots_visible: bool = False  # do people make way for robots?
    human_radius_min: float = number(0.3, 0.05, 2.0)  # drawn per person, m
    human_radius_max: float = number(0.3, 0.05, 2.0)
    human_speed_min: float = number(1.0, 0.05, 10.0)  # preferred speed, drawn per person, m/s
    human_speed_max: float = number(1.0, 0.05, 10.0)
    human_safety_space: float = number(0.25, 0.0, 5.0)  # added to every radius they avoid, m
    goal_distance: float = number(4.0, 0.0, 1000.0)  # a new goal is at least so far, m
    goal_change_interval: float = number(5.0, 0.01, 10000.0)  # s
    goal_change_probability: float = number(0.5, 0.0, 1.0)  # at each interval
    goal_change_probability_max: float | None = number(
        None, 0.0, 1.0
    )  # drawn per person up to this; null: everybody has the same
    stand_probability: float = number(0.0, 0.0, 1.0)  # to stand still until the next interval
    hurry_probability: float = number(0.0, 0.0, 1.0)  # share of people in a hurry
    hurry_speed_min: float = number(1.5, 0.05, 10.0)  # their preferred speed, drawn, m/s
    hurry_speed_max: float = number(2.0, 0.05, 10.0)
    pair_probability: float = number(0.0, 0.0, 1.0)  # that the next two walk together
    late_probability: float = number(0.0, 0.0, 1.0)  # share of people that come later
    late_time: float = number(20.0, 0.0, 10000.0)  # at the latest, s
    leave_probability: float = number(0.0, 0.0, 1.0)  # to leave at a goal instead of turning
    neighbor_distance: float = number(10.0, 0.1, 1000.0)  # ORCA, m
    max_neighbors: int = number(10, 1, 80)  # ORCA
    time_horizon: float = number(5.0, 0.01, 100.0)  # ORCA, s
    relaxation_time: float = number(0.5, 0.01, 10.0)  # social force, s
    force_strength: float = number(7.0, 0.0, 1000.0)  # social force at contact, m/s^2
    force_range: float = number(0.3, 0.01, 10.0)  # social force, m

    reward: Reward = field(default_factory=Reward)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: names the field, its value and what would be right.
        """
        check_numbers(self, "scenario")
        if not isinstance(self.reward, Reward):
            raise ConfigurationError(f"scenario.reward is {self.reward!r}; it must be a Reward")
        check_numbers(self.reward, "scenario.reward")
        simulated = self.crowd is not Crowd.recorded
        circle, crossing, opposite, square = (
            simulated and self.layout in (layout, Layout.mixed)
            for layout in (Layout.circle, Layout.crossing, Layout.opposite, Layout.square)
        )
        floor = crossing or opposite or square
        for low, high, applies in (
            ("humans_min", "humans", simulated),
            ("human_radius_min", "human_radius_max", True),
            ("human_speed_min", "human_speed_max", simulated),
            ("hurry_speed_min", "hurry_speed_max", simulated and self.hurry_probability > 0.0),
            ("robot_way_min", "robot_way_max", floor or not simulated),
            ("robot_way_min", "floor_size", floor),
            ("crossing_width", "floor_size", crossing),
            ("opposite_width", "floor_size", opposite),
            ("time_step", "time_limit", True),
            ("goal_distance", "circle_radius", circle and self.crowd is not Crowd.still),
            ("goal_change_probability", "goal_change_probability_max",
             simulated and self.crowd is not Crowd.still),
        ):  # fmt: skip
            smallest, largest = getattr(self, low), getattr(self, high)
            if applies and None not in (smallest, largest) and smallest > largest:
                raise ConfigurationError(
                    f"scenario.{low} is {smallest}; it must not exceed scenario.{high} ({largest})"
                )
        if self.recording is not None and self.crowd is not Crowd.recorded:
            raise ConfigurationError(
                f"scenario.recording is {self.recording!r}; it must be null unless scenario.crowd "
                "is recorded"
            )
        if self.crowd is Crowd.recorded and (self.robots_visible or self.arena_radius is not None):
            raise ConfigurationError(
                "scenario.crowd is recorded; then scenario.robots_visible must be false and "
                "scenario.arena_radius null: nobody in a recording knows of robots or walls"
            )
        if self.arena_radius is not None and floor:
            needed = self.floor_size / math.sqrt(2.0) + self.robot_radius
            if self.arena_radius < needed:
                raise ConfigurationError(
                    f"scenario.arena_radius is {self.arena_radius}; it must be null or at least "
                    f"{needed:.2f}, so that the corners of the floor lie inside"
                )
        if self.arena_radius is not None:
            jitter = math.sqrt(2.0) * self.spawn_jitter * self.robot_speed if circle else 0.0
            needed = self.circle_radius + jitter + self.robot_radius
            if circle and self.arena_radius < needed:
                raise ConfigurationError(
                    f"scenario.arena_radius is {self.arena_radius}; it must be null or at least "
                    f"{needed:.2f}, so that every start and goal lies inside"
                )
            # Starts and goals are discs of this radius; they must cover less than 35 % of the room.
            disc = self.robot_radius + self.spawn_clearance / 2
            room = self.arena_radius - self.robot_radius - jitter
            if 2 * self.robots * disc**2 > 0.35 * room**2:
                needed = math.sqrt(2 * self.robots / 0.35) * disc + self.robot_radius + jitter
                raise ConfigurationError(
                    f"scenario.arena_radius is {self.arena_radius}; {self.robots} robots with "
                    f"scenario.spawn_clearance {self.spawn_clearance} need at least {needed:.2f}"
                )

    @property
    def action_size(self) -> int:
        """How many numbers in [-1, 1] drive one robot."""
        return ACTION_SIZE[self.kinematics]

    @property
    def time_limit_steps(self) -> int:
        """The time limit in steps."""
        return self.steps(self.time_limit)

    @property
    def max_turn(self) -> float:
        """How far a robot may turn in one step, rad."""
        return math.radians(min(self.max_turn_rate * self.time_step, 180.0))

    def steps(self, duration: float) -> int:
        """Convert a duration in seconds to the nearest number of steps."""
        return round(duration / self.time_step)

    @property
    def team_tracks(self) -> bool:
        """Whether robots tell each other whom they see."""
        return self.team_perception is TeamPerception.tracks

    @property
    def team_delay_steps(self) -> int:
        """The delay of what team-mates tell, in steps."""
        return self.steps(self.team_delay)

    def load_recording(self) -> Recording:
        """The recorded people, on the clock of the scenario; nobody for other crowds.

        Raises:
            ConfigurationError: the file cannot be read, a line of it is wrong, it is implausible,
                or its floor is too small for `robot_way_min`.
        """
        if self.crowd is not Crowd.recorded:
            return NOBODY
        try:
            recording = load_recording(
                self.recording, self.frame_seconds, self.time_step, self.recording_scale,
                self.recording_check,
            )  # fmt: skip
        except RecordingError as error:
            raise ConfigurationError(f"scenario.{error}") from None
        diagonal = 2.0 * float(np.linalg.norm(recording.half_size))
        if self.robot_way_min > 0.7 * diagonal:
            raise ConfigurationError(
                f"scenario.robot_way_min is {self.robot_way_min}; it must be at most "
                f"{0.7 * diagonal:.1f} for this recording"
            )
        return recording

    def no_room(self, robots: bool, case: int) -> str:
        """Say that a case has no room for all robots, or for all people."""
        clearance = f"scenario.spawn_clearance is {self.spawn_clearance}"
        if not robots:
            return (
                f"scenario.humans is {self.humans}; case {case} has no room for so many: "
                f"{clearance}, scenario.human_radius_max is {self.human_radius_max}"
            )
        if self.crowd is Crowd.recorded:
            place = f"on the recorded floor with scenario.human_radius_max {self.human_radius_max}"
        elif self.layout is Layout.circle:
            place = f"on a circle of scenario.circle_radius {self.circle_radius}"
        else:
            place = f"on a floor of scenario.floor_size {self.floor_size}"
        return (
            f"scenario.robots is {self.robots}; case {case} has no room for so many {place}: "
            f"{clearance}, scenario.robot_radius is {self.robot_radius}, scenario.robot_way_min is "
            f"{self.robot_way_min}"
        )

    @property
    def half_extent(self) -> float:
        """From the middle to where the outermost may start, along an axis, m."""
        if self.crowd is Crowd.recorded:
            return float(self.load_recording().half_size.max())
        circle = self.circle_radius + self.spawn_jitter * max(
            self.robot_speed, self.human_speed_max
        )
        if self.layout is Layout.circle:
            return circle
        return max(self.floor_size / 2, circle if self.layout is Layout.mixed else 0.0)

    def parameters(self) -> Parameters:
        """The scenario as the kernels take it."""
        f = np.float32
        return Parameters(
            humans_min=self.humans if self.humans_min is None else self.humans_min,
            layout=self.layout.value,
            circle_radius=f(self.circle_radius),
            goal_turn=f(math.radians(self.goal_turn_degrees)),
            goal_turn_spread=f(math.radians(self.goal_turn_spread_degrees)),
            floor_size=f(self.floor_size),
            crossing_width=f(self.crossing_width),
            opposite_width=f(self.opposite_width),
            robot_way_min=f(self.robot_way_min),
            robot_way_max=f(self.robot_way_max),
            spawn_jitter=f(self.spawn_jitter),
            spawn_clearance=f(self.spawn_clearance),
            arena_radius=f(np.inf if self.arena_radius is None else self.arena_radius),
            time_step=f(self.time_step),
            time_limit_steps=self.time_limit_steps,
            collisions_end=self.collisions_end,
            kinematics=self.kinematics.value,
            instant_velocity=self.kinematics is not Kinematics.acceleration_heading,
            robot_radius=f(self.robot_radius),
            robot_speed=f(self.robot_speed),
            max_acceleration=f(self.max_acceleration),
            max_turn=f(self.max_turn),
            min_turning_radius=f(self.min_turning_radius),
            turn_in_place=self.turn_in_place,
            cos_half_fov=f(math.cos(math.radians(self.fov_degrees / 2))),
            sensing_range=f(self.sensing_range),
            occlusion=self.occlusion,
            position_noise=f(self.position_noise),
            velocity_noise=f(self.velocity_noise),
            radius_noise=f(self.radius_noise),
            missed_detection=f(self.missed_detection),
            team_tracks=self.team_tracks,
            team_range=f(self.team_range),
            team_delay_steps=self.team_delay_steps,
            team_loss=f(self.team_loss),
            crowd=self.crowd.value,
            robots_visible=self.robots_visible,
            human_radius_min=f(self.human_radius_min),
            human_radius_max=f(self.human_radius_max),
            human_speed_min=f(self.human_speed_min),
            human_speed_max=f(self.human_speed_max),
            human_safety_space=f(self.human_safety_space),
            goal_distance=f(self.goal_distance),
            recorded_start_clear_steps=self.steps(self.recorded_start_clear),
            recorded_slot_rest_steps=self.steps(self.recorded_slot_rest),
            goal_change_steps=max(1, self.steps(self.goal_change_interval)),
            goal_change_probability=f(self.goal_change_probability),
            goal_change_probability_max=f(
                self.goal_change_probability
                if self.goal_change_probability_max is None
                else self.goal_change_probability_max
            ),
            stand_probability=f(self.stand_probability),
            hurry_probability=f(self.hurry_probability),
            hurry_speed_min=f(self.hurry_speed_min),
            hurry_speed_max=f(self.hurry_speed_max),
            pair_probability=f(self.pair_probability),
            late_probability=f(self.late_probability),
            late_steps=self.steps(self.late_time),
            leave_probability=f(self.leave_probability),
            people_come_and_go=self.late_probability > 0 or self.leave_probability > 0,
            neighbor_distance=f(self.neighbor_distance),
            max_neighbors=self.max_neighbors,
            time_horizon=f(self.time_horizon),
            relaxation_time=f(self.relaxation_time),
            force_strength=f(self.force_strength),
            force_range=f(self.force_range),
            reward_none=f(0.0),
            reward_arrival=f(self.reward.arrival),
            reward_team=f(self.reward.team),
            reward_collision=f(self.reward.collision),
            reward_discomfort=f(self.reward.discomfort),
            reward_discomfort_limit=f(self.reward.discomfort_limit),
            discomfort_distance=f(self.reward.discomfort_distance),
            reward_progress=f(self.reward.progress),
            reward_goal_distance=f(self.reward.goal_distance / self.circle_radius**2),
            reward_time=f(self.reward.time),
            reward_literal=self.reward.literal,
        )


def overridden(scenario: Scenario | None, overrides: dict[str, Any]) -> Scenario:
    """`scenario` (None: SAMARL's) with some of its fields changed.

    Raises:
        ConfigurationError: it is no scenario, or has no such field (then it is a `TypeError` as
            well), or not with such a value.
    """
    if not isinstance(scenario, Scenario | None):
        raise ConfigurationError(
            f"scenario is {scenario!r}; it must be a Scenario (other settings go by their names)"
        )
    fields = [f.name for f in dataclasses.fields(Scenario)]
    for name, value in overrides.items():
        if name not in fields:
            raise UnknownFieldError(
                f"unexpected keyword argument '{name}' ({value!r}); it must be a field of "
                f"Scenario: {', '.join(fields)}"
            )
    return dataclasses.replace(scenario or Scenario(), **overrides)
