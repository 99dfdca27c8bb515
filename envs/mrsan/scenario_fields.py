"""The fields of a scenario: each number of the simulated world, with its unit and its range."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mrsan.choices import CrowdReaction, Kinematics, Layout, LidarTargets, TeamPerception
from mrsan.fields import number, setting
from mrsan.groups import Groups
from mrsan.place import Place
from mrsan.reactions import Reactions
from mrsan.reward import Reward


@dataclass(repr=False)
class ScenarioFields:
    """The fields of `Scenario`, unchecked, and what the checks derive from them."""

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
    hurry_probability: float = number(0.0, 0.0, 1.0, help="share who walk at 1.5 to 2 m/s")
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

    def steps(self, duration: float) -> int:
        """Convert a duration in seconds to the nearest number of steps."""
        return round(duration / self.time_step)
