"""A scenario in the units of the kernels: float32, radians and steps.

Every number, switch and choice of `Scenario` is handed over under its own name, and those of
`Reward` with the prefix `reward_`; a new field needs no change here. What kernels need in another
form is computed in `_derived`.
"""

from __future__ import annotations

import math
import weakref
from collections import namedtuple
from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, NamedTuple, get_type_hints

import numpy as np

from mrsan.choices import Crowd, CrowdReaction, Kinematics
from mrsan.fields import kernel_form
from mrsan.kernels.structs import KeepsStruct
from mrsan.reward import Reward
from mrsan.scenario import Scenario

# Fields that no kernel reads, or only in the form that `_derived` gives them: every number that is
# handed over costs time in each call.
_NOT_COPIED = {
    "robots",
    "humans",
    "goal_turn_degrees",
    "goal_rotation_range_degrees",
    "time_limit",
    "max_turn_rate",
    "fov_degrees",
    "team_perception",
    "team_delay",
    "team_messages",
    "crowd_reaction",
    "frame_seconds",
    "recording_scale",
    "recording_check",
    "goal_change_interval",
    "late_time",
    "neighbor_distance",
    "max_neighbors",
    "time_horizon",
    "relaxation_time",
    "force_strength",
    "force_range",
    "map_known",
    "walls_occlude",
    "nearest_walls",
    "lidar_rays",
    "lidar_range",
    "lidar_fov_degrees",
    "lidar_noise",
    "lidar_noise_share",
    "lidar_dropout",
    "lidar_targets",
    "next_passages",
    "reward_lookahead",
    "reward_lookahead_steps",
    "reward_lookahead_distance",
}

_f = np.float32
CROSSING_WIDTH, OPPOSITE_WIDTH = 8.0, 6.0  # of streams of people, if the floor is as wide, m
DEADLOCK_TIME = 10.0  # for which every driving robot stands still, s
_START_CLEAR_TIME = 2.0  # for which no recorded person crosses a robot's start, s
_SLOT_REUSE_DELAY = 6.0  # before a slot holds another recorded person, s


def _derived(s: Scenario) -> dict[str, Any]:
    """Return the numbers that are not copied from a field, or replace the copy."""
    probability = s.goal_change_probability
    probability_max = s.goal_change_probability_max
    return {
        "humans_min": s.humans if s.humans_min is None else s.humans_min,
        "goal_turn": _f(math.radians(s.goal_turn_degrees)),
        "goal_turn_spread": _f(math.radians(s.goal_rotation_range_degrees)),
        "crossing_width": _f(min(CROSSING_WIDTH, s.floor_size)),
        "opposite_width": _f(min(OPPOSITE_WIDTH, s.floor_size)),
        "arena_radius": _f(np.inf if s.arena_radius is None else s.arena_radius),
        "time_limit_steps": s.time_limit_steps,
        "instant_velocity": s.kinematics is not Kinematics.acceleration_heading,
        "max_turn": _f(s.max_turn),  # in one step
        "cos_half_fov": _f(math.cos(math.radians(s.fov_degrees / 2))),
        "team_tracks": s.team_tracks,
        "team_delay_steps": s.team_delay_steps,
        "start_clear_time_steps": s.steps(_START_CLEAR_TIME),
        "slot_reuse_delay_steps": s.steps(_SLOT_REUSE_DELAY),
        "goal_change_steps": max(1, s.steps(s.goal_change_interval)),
        "goal_change_probability_max": _f(
            probability if probability_max is None else probability_max
        ),
        "route_clearance": _f(s.route_clearance),
        "deadlock_steps": _f(s.steps(DEADLOCK_TIME)),
        "late_steps": s.steps(s.late_time),
        "people_see_robots": s.crowd_reaction is not CrowdReaction.blind,
        "people_recorded": s.crowd == Crowd.recorded,
        "people_come_and_go": s.late_probability > 0 or s.leave_probability > 0,
        "reward_goal_distance": _f(s.reward.goal_distance / s.circle_radius**2),
    }


def _forms(cls: type, prefix: str = "") -> dict[str, tuple[str, Callable[[Any], Any]]]:
    """Return of each field to copy, by its name in kernels: its own name and its conversion."""
    hints, forms = get_type_hints(cls), {}
    for field in fields(cls):
        form, name = kernel_form(hints[field.name]), prefix + field.name
        if form is not None and name not in _NOT_COPIED:
            forms[name] = (field.name, form)
    return forms


_OF_SCENARIO, _OF_REWARD = _forms(Scenario), _forms(Reward, "reward_")


def _numbers(s: Scenario) -> dict[str, Any]:
    copied = {name: form(getattr(s, own)) for name, (own, form) in _OF_SCENARIO.items()}
    reward = {name: form(getattr(s.reward, own)) for name, (own, form) in _OF_REWARD.items()}
    return copied | reward | _derived(s)


if TYPE_CHECKING:
    Parameters = Any  # its fields are those of `Scenario`, which type checkers cannot follow
else:

    class Parameters(namedtuple("Numbers", _numbers(Scenario())), KeepsStruct):
        """The numbers of a scenario by their names."""


_COMPUTED: dict[int, tuple[list[dict[str, Any]], Parameters]] = {}
"""The fields of a scenario, and its numbers, by the scenario's id, while it exists."""


def kernel_parameters(scenario: Scenario) -> Parameters:
    """Return the numbers of a scenario as a named tuple, the form that Numba takes.

    They are computed once, and again if a field of the scenario was changed.
    """
    key, values = id(scenario), [vars(scenario).copy(), vars(scenario.reward).copy()]
    if key not in _COMPUTED:
        weakref.finalize(scenario, _COMPUTED.pop, key).atexit = False
    elif _COMPUTED[key][0] == values:
        return _COMPUTED[key][1]
    parameters = Parameters(**_numbers(scenario))
    _COMPUTED[key] = values, parameters
    return parameters


class SensorParameters(NamedTuple):
    """The part of `Parameters` that decides what a robot sees: a short tuple is passed faster."""

    robot_radius: np.float32
    robot_speed: np.float32
    time_limit_steps: int
    cos_half_fov: np.float32
    sensing_range: np.float32
    occlusion: bool
    position_noise: np.float32
    velocity_noise: np.float32
    radius_noise: np.float32
    missed_detection: np.float32

    @classmethod
    def of(cls, parameters: Parameters) -> SensorParameters:
        """Return what a scenario's parameters say about the sensor."""
        return cls(*(getattr(parameters, name) for name in cls._fields))
