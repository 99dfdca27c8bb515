"""Crowd models: the compiled functions that move people, by the names that scenarios use.

A custom crowd model is a function that chooses the next velocity of one person. A user's module
registers it with `register_crowd`, and commands import that module with `plugins=[module]`.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from inspect import signature
from typing import Any, NamedTuple, TypeVar, cast, get_type_hints

import numpy as np

from mrsan.choices import Crowd
from mrsan.fields import ConfigurationError, check_numbers, kernel_form
from mrsan.groups import group_parameters
from mrsan.kernels import function, kernel
from mrsan.kernels.along import move_along_path, pieces_of_path
from mrsan.kernels.groups import count_intrusions
from mrsan.kernels.people import (
    enter_and_leave,
    follow_recording,
    orca_crowd,
    social_force_crowd,
    stand_still,
    walk_as_recorded,
    walk_to_goals,
)
from mrsan.kernels.scripted import follow_paths
from mrsan.kernels.society import (
    place_in_group,
    place_reacting_in_zone,
    walk_socially,
    walk_socially_past_walls,
)
from mrsan.kernels.spawn import (
    begin_episodes,
    draw_route_among_recorded,
    place_recorded_people,
)
from mrsan.kernels.step import advance
from mrsan.kernels.walled import (
    orca_crowd_past_walls,
    progress_along_route,
    robot_touches_wall,
    walk_along_routes,
)
from mrsan.kernels.walled_spawn import walled_begin
from mrsan.reactions import reaction_parameters
from mrsan.scenario_fields import ScenarioFields

F = TypeVar("F", bound=Callable[..., Any])


def _no_settings(scenario: ScenarioFields) -> tuple[()]:
    return ()


@dataclass(frozen=True)
class CrowdModel:
    """The functions of a crowd model; see `mrsan.kernels.people` for their arguments."""

    variant: str  # names the cache file of the compiled step
    choose_velocities: Any  # of all people of a world
    update_presence: Any = enter_and_leave
    crowd_velocity: Any = None  # of one person, which `walk_to_goals` calls
    crowd_velocity_past_walls: Any = None  # the same in places with walls, if it differs
    settings: type | None = None  # dataclass of `Scenario.crowd_settings`; None: it has none
    kernel_settings: Callable[[ScenarioFields], tuple[Any, ...]] = _no_settings


CROWDS: dict[str, CrowdModel] = {}


def register_crowd(name: str, settings: type | None = None) -> Callable[[F], F]:
    """Register a function, which Numba must be able to compile, as a crowd model.

    The function returns the next velocity (vx, vy) of one person in m/s. Goals, standing, pairs,
    entering and leaving are the same for all crowd models. Its arguments are, in this order:

    - `agents`: rows `[px, py, vx, vy, radius]` of the people present and, for those who avoid
      robots, of the robots; radii include `Scenario.human_safety_space`;
    - `count`: the number of rows;
    - `i`: the row of the person;
    - `preferred_x`, `preferred_y`: the velocity straight to the goal, or to the next corner of the
      route, at the preferred speed; zero for a person who stands;
    - `max_speed`: the preferred speed;
    - `p`: the scenario's parameters, such as `p.time_step`;
    - `settings`: the model's own settings, such as `settings.reach`;
    - `scratch`: the working arrays of `mrsan.kernels.orca.allocate_orca_scratch`. In places with
      walls `scratch.wall_points` holds the nearest points of the first `scratch.wall_counts[0]`
      walls, nearest first. A velocity that would lead into a wall is changed afterwards.

    Args:
        name: value of `Scenario.crowd`, an identifier. A later model of the same name replaces an
            earlier one, except the built-in ones.
        settings: a dataclass of the model's own settings, whose values `Scenario.crowd_settings`
            changes. Each has a default and is a number declared by `mrsan.fields.number`, a bool
            or an enum. None: the model has no settings.

    Raises:
        ValueError: the name is not an identifier or belongs to a built-in model.
        TypeError: the function or the settings do not have the required form.
    """
    if not name.isidentifier() or name in Crowd.__members__:
        raise ValueError(
            f"the name of a crowd model is {name!r}; it must be an identifier other than "
            f"{', '.join(Crowd)}"
        )

    def register(source: F) -> F:
        expected = list(signature(orca_crowd).parameters)
        if len(signature(source).parameters) != len(expected):
            raise TypeError(
                f"crowd model {name} takes {', '.join(signature(source).parameters)}; it must "
                f"take {', '.join(expected)}"
            )
        # A cached kernel refers to the module of the function, so it is of no use to another one.
        CROWDS[name] = CrowdModel(
            f"{name}_{source.__module__}",
            walk_to_goals,
            crowd_velocity=function(source),
            settings=settings,
            kernel_settings=_no_settings if settings is None else _conversion(settings),
        )
        return source

    return register


def _conversion(schema: type) -> Callable[[ScenarioFields], tuple[Any, ...]]:
    """Return the function from a scenario to the settings of its crowd model, a named tuple."""
    schema()  # raises TypeError if a setting has no default
    hints = get_type_hints(schema)
    forms: dict[str, Callable[[Any], Any]] = {}
    for field in fields(schema):
        form = kernel_form(hints[field.name])
        if form is None or (hints[field.name] in (int, float) and "low" not in field.metadata):
            raise TypeError(
                f"{schema.__name__}.{field.name} is declared as {hints[field.name]}; a setting of "
                "a crowd model must be a number declared by mrsan.fields.number, a bool or an enum"
            )
        forms[field.name] = form
    settings_tuple = __getattr__(_PREFIX + ":".join(forms))

    def convert(scenario: ScenarioFields) -> tuple[Any, ...]:
        settings = _checked_settings(schema, scenario.crowd_settings)
        values = (form(getattr(settings, name)) for name, form in forms.items())
        return cast(tuple[Any, ...], settings_tuple(*values))

    return convert


def _checked_settings(schema: type, values: dict[str, Any]) -> Any:
    settings = schema(**values)
    check_numbers(settings, "scenario.crowd_settings")
    return settings


_PREFIX = "CrowdSettings:"


@cache
def __getattr__(name: str) -> Any:
    """Return the named-tuple class of settings with the names in `CrowdSettings:name:name`.

    Numba stores this class in its cache by module and name, and loads it even when the cached
    kernel is out of date. A class in the user's module would no longer exist after it was renamed.
    """
    if not name.startswith(_PREFIX):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    names = name.removeprefix(_PREFIX).split(":")
    settings_tuple: Any = namedtuple("CrowdSettings", names)  # type: ignore[misc]
    settings_tuple.__module__, settings_tuple.__qualname__ = __name__, name
    return settings_tuple


def _of_scenario(settings_tuple: Any) -> Callable[[ScenarioFields], tuple[Any, ...]]:
    """Return the function from a scenario to those of its fields that a named tuple lists."""
    types = get_type_hints(settings_tuple)

    def convert(scenario: ScenarioFields) -> tuple[Any, ...]:
        values = {name: kind(getattr(scenario, name)) for name, kind in types.items()}
        return cast(tuple[Any, ...], settings_tuple(**values))

    return convert


class OrcaSettings(NamedTuple):
    """The settings of ORCA, which are fields of `Scenario`."""

    neighbor_distance: np.float32
    max_neighbors: int
    time_horizon: np.float32


class SocialForceSettings(NamedTuple):
    """The settings of the social-force model, which are fields of `Scenario`."""

    relaxation_time: np.float32
    force_strength: np.float32
    force_range: np.float32


CROWDS |= {
    Crowd.orca.value: CrowdModel(
        "orca",
        walk_to_goals,
        crowd_velocity=orca_crowd,
        crowd_velocity_past_walls=orca_crowd_past_walls,
        kernel_settings=_of_scenario(OrcaSettings),
    ),
    Crowd.social_force.value: CrowdModel(
        "social_force",
        walk_to_goals,
        crowd_velocity=social_force_crowd,
        kernel_settings=_of_scenario(SocialForceSettings),
    ),
    Crowd.still.value: CrowdModel("still", stand_still),
    Crowd.recorded.value: CrowdModel(
        "recorded", walk_as_recorded, update_presence=follow_recording
    ),
}


def crowd_model(name: Any) -> CrowdModel:
    """Return the crowd model of a name.

    Raises:
        ConfigurationError: no such model is registered in this process.
    """
    if not isinstance(name, str) or name not in CROWDS:
        raise ConfigurationError(
            f"scenario.crowd is {name!r}; it must be one of {', '.join(CROWDS)} or registered in "
            "this process: import its module, in commands by plugins=[module]"
        )
    return CROWDS[name]


def check_crowd(name: Any, settings: Any) -> None:
    """Check the name of a crowd model and its settings.

    Raises:
        ConfigurationError: there is no such model, or a setting is unknown or out of range.
    """
    schema = crowd_model(name).settings
    if not isinstance(settings, dict):
        raise ConfigurationError(
            f"scenario.crowd_settings is {settings!r}; it must be a mapping from names to values"
        )
    names = [] if schema is None else [f.name for f in fields(schema)]
    for key in settings:
        if key not in names:
            permitted = f"have only {', '.join(names)}" if names else "be empty"
            raise ConfigurationError(
                f"scenario.crowd_settings has {key!r}; with scenario.crowd {name} it must "
                f"{permitted}"
            )
    if schema is not None:
        _checked_settings(schema, settings)


def social_settings(scenario: ScenarioFields, crowd_settings: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the settings of a crowd whose people react or form groups, else an empty tuple.

    They are those of the crowd model by their own names, and those of `Scenario.reactions` and
    `Scenario.groups` with the prefixes `reaction_` and `group_`; kernels take no nested tuples.
    """
    if not scenario.is_social:
        return ()
    values = dict(zip(getattr(crowd_settings, "_fields", ()), crowd_settings, strict=True))
    s = scenario
    for prefix, numbers in (
        ("reaction", reaction_parameters(s.reactions, s.crowd_reaction, s.steps)),
        ("group", group_parameters(s.groups, s.relaxation_time)),
    ):
        values |= {f"{prefix}_{name}": value for name, value in numbers.items()}
    return cast(tuple[Any, ...], __getattr__(_PREFIX + ":".join(values))(*values.values()))


@cache
def step_kernel(
    model: CrowdModel,
    walled: bool = False,
    social: bool = False,
    scripted: bool = False,
    along_paths: bool = False,
) -> kernel:
    """Return the kernel that moves worlds whose people follow a crowd model.

    Args:
        model: the crowd model.
        walled: in places with walls.
        social: people react to robots or walk in groups.
        scripted: some people walk along the paths of a case file.
        along_paths: robots move along paths (`mrsan.kernels.along`) instead of by actions.
    """
    parts = {"walled": walled, "social": social, "scripted": scripted, "along": along_paths}
    name = "_".join([model.variant, *(part for part, applies in parts.items() if applies)])
    functions = {
        "choose_velocities": model.choose_velocities,
        "update_presence": model.update_presence,
        "crowd_velocity": model.crowd_velocity,
    }
    if walled:
        functions |= {"touches_wall": robot_touches_wall, "route_progress": progress_along_route}
        functions["crowd_velocity"] = model.crowd_velocity_past_walls or model.crowd_velocity
    if along_paths:
        functions |= {"pieces": pieces_of_path, "move_robot": move_along_path}
    if social:
        functions["count_intrusions"] = count_intrusions
    if model.choose_velocities is walk_to_goals:
        functions["choose_velocities"] = {
            (False, False): walk_to_goals,
            (True, False): walk_along_routes,
            (False, True): walk_socially,
            (True, True): walk_socially_past_walls,
        }[walled, social]
    if scripted:
        functions["choose_velocities"] = follow_paths(functions["choose_velocities"])
    return advance.variant(name, **functions)


@cache
def begin_kernel(walled: bool = False, social: bool = False, recorded: bool = False) -> kernel:
    """Return the kernel that begins episodes.

    Args:
        walled: in places with walls.
        social: people react to robots or walk in groups.
        recorded: people follow a recording, without walls and reactions.
    """
    if recorded:
        return begin_episodes.variant(
            "recorded", draw_route=draw_route_among_recorded, place_people=place_recorded_people
        )
    begin = walled_begin() if walled else begin_episodes
    if not social:
        return begin
    place_human = place_reacting_in_zone if walled else place_in_group
    return begin.variant("social", place_human=place_human)
