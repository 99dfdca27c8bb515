"""Checks of the settings of a scenario against each other."""

from __future__ import annotations

import math

from mrsan.case_file import read_case_file
from mrsan.choices import Crowd, Layout
from mrsan.fields import ConfigurationError
from mrsan.scenario_fields import ScenarioFields

_MAX_COVERAGE = 0.35  # largest share of a walled floor that discs at starts and goals may cover


def check_consistency(s: ScenarioFields) -> None:
    """Check the settings of a scenario, each of which is valid by itself, against each other.

    Raises:
        ConfigurationError: names the first field that contradicts another one, and both values.
    """
    _check_order(s)
    if s.recording is not None and s.crowd != Crowd.recorded:
        raise ConfigurationError(
            f"scenario.recording is {s.recording!r}; it must be null unless scenario.crowd is "
            "recorded"
        )
    if s.crowd == Crowd.recorded and (s.robots_avoided or s.arena_radius is not None):
        raise ConfigurationError(
            "scenario.crowd is recorded; then scenario.crowd_reaction must be blind and "
            "scenario.arena_radius null: recorded people react neither to robots nor to walls"
        )
    _check_social(s)
    _check_walls(s)
    if s.arena_radius is not None:
        _check_arena(s, s.arena_radius)


def _check_social(s: ScenarioFields) -> None:
    """Check the settings of people who react to robots or belong to groups."""
    if s.is_social and s.crowd in (Crowd.still, Crowd.recorded):
        raise ConfigurationError(
            f"scenario.crowd is {s.crowd}; with scenario.crowd_reaction "
            f"{s.crowd_reaction.name} and scenario.groups.share {s.groups.share} it must be a "
            "crowd that walks to goals"
        )
    if s.groups.share == 0.0:
        return
    share = f"scenario.groups.share is {s.groups.share}"
    if s.has_walls:
        raise ConfigurationError(
            f"{share}; it must be 0 in walled environments (scenario.layout {s.layout.name})"
        )
    for name in ("pair_probability", "late_probability", "leave_probability"):
        if getattr(s, name) > 0.0:
            raise ConfigurationError(
                f"{share}; then scenario.{name} must be 0, not {getattr(s, name)}: groups stay "
                "together"
            )


def _check_walls(s: ScenarioFields) -> None:
    """Check the settings of walled environments."""
    drawn = s.case_file is not None and bool(read_case_file(s.case_file).walls)
    if (s.map is not None or drawn) != (s.layout is Layout.map):
        files = f"scenario.map is {s.map!r}, scenario.case_file is {s.case_file!r}"
        raise ConfigurationError(
            f"{files} and scenario.layout is {s.layout.name}; layout must be map with a map file "
            "or a case file with walls, and only then"
        )
    if s.next_passages and not s.map_known:
        raise ConfigurationError(
            f"scenario.next_passages is {s.next_passages}; it must be 0 with scenario.map_known "
            "false: passages are those of the map"
        )
    if s.has_walls and s.crowd == Crowd.recorded:
        raise ConfigurationError(
            f"scenario.layout is {s.layout.name}; it must be a layout without walls with "
            "scenario.crowd recorded: recorded people would walk through the walls"
        )
    if s.has_walls and s.arena_radius is not None:
        raise ConfigurationError(
            f"scenario.arena_radius is {s.arena_radius}; it must be null with walls (scenario."
            f"layout {s.layout.name})"
        )


def _layouts(s: ScenarioFields) -> list[Layout]:
    """Return the layouts that episodes of a scenario may have; none if people are recorded."""
    if s.crowd == Crowd.recorded:
        return []
    single = [Layout.circle, Layout.crossing, Layout.opposite, Layout.square]
    return single if s.layout is Layout.mixed else [s.layout]


def _check_order(s: ScenarioFields) -> None:
    """Check that no smallest value exceeds the largest one, where both apply."""
    layouts, simulated = _layouts(s), s.crowd != Crowd.recorded
    circle = Layout.circle in layouts
    floor = any(Layout.circle.value < layout.value < Layout.mixed.value for layout in layouts)
    walking = simulated and s.crowd != Crowd.still
    for low, high, applies in (
        ("humans_min", "humans", simulated),
        ("human_radius_min", "human_radius_max", True),
        ("human_speed_min", "human_speed_max", simulated),
        ("route_length_min", "route_length_max", floor or not simulated),
        ("route_length_min", "floor_size", floor),
        ("time_step", "time_limit", True),
        ("goal_distance", "circle_radius", circle and walking),
        ("goal_change_probability", "goal_change_probability_max", walking),
    ):
        smallest, largest = getattr(s, low), getattr(s, high)
        if applies and None not in (smallest, largest) and smallest > largest:
            raise ConfigurationError(
                f"scenario.{low} is {smallest}; it must not exceed scenario.{high} ({largest})"
            )


def _check_arena(s: ScenarioFields, arena_radius: float) -> None:
    """Check that the wall leaves room for the starts and goals of all robots."""
    layouts = _layouts(s)
    invalid = f"scenario.arena_radius is {arena_radius}; "
    if any(layout is not Layout.circle for layout in layouts):
        smallest = s.floor_size / math.sqrt(2.0) + s.robot_radius
        if arena_radius < smallest:
            raise ConfigurationError(
                f"{invalid}it must be null or at least {smallest:.2f}, so that the corners of the "
                "floor lie inside"
            )
    circle = Layout.circle in layouts
    jitter = math.sqrt(2.0) * s.spawn_jitter * s.robot_speed if circle else 0.0
    smallest = s.circle_radius + jitter + s.robot_radius
    if circle and arena_radius < smallest:
        raise ConfigurationError(
            f"{invalid}it must be null or at least {smallest:.2f}, so that every start and goal "
            "lies inside"
        )
    # Each start and goal keeps a disc of this radius free of the other robots'.
    disc = s.robot_radius + s.spawn_clearance / 2
    floor_radius = arena_radius - s.robot_radius - jitter
    if 2 * s.robots * disc**2 > _MAX_COVERAGE * floor_radius**2:
        smallest = math.sqrt(2 * s.robots / _MAX_COVERAGE) * disc + s.robot_radius + jitter
        raise ConfigurationError(
            f"{invalid}{s.robots} robots with scenario.spawn_clearance {s.spawn_clearance} need "
            f"at least {smallest:.2f}"
        )
