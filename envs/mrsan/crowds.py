"""Crowd models: the compiled functions that move people, by the names that scenarios use.

A custom crowd model is a function that chooses the next velocity of one person, registered by a
module that commands import with `plugins=[module]`; `register_crowd` describes its arguments.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, NamedTuple, TypeVar, get_type_hints

import numpy as np

from mrsan.choices import Crowd
from mrsan.fields import ConfigurationError, check_numbers, kernel_form
from mrsan.kernels import function, kernel
from mrsan.kernels.people import (
    enter_and_leave,
    follow_recording,
    orca_crowd,
    social_force_crowd,
    stand_still,
    walk_as_recorded,
    walk_to_goals,
)
from mrsan.kernels.step import advance

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class CrowdModel:
    """The functions of a crowd model; see `mrsan.kernels.people` for their arguments."""

    name: str
    choose_velocities: Any  # of all people of a world
    update_presence: Any = enter_and_leave
    crowd_velocity: Any = None  # of one person, which `walk_to_goals` calls
    settings: type | None = None  # dataclass of `Scenario.crowd_settings`; None: there are none
    kernel_settings: Callable[[Any], tuple[Any, ...]] = lambda scenario: ()


CROWDS: dict[str, CrowdModel] = {}


def register_crowd(name: str, settings: type | None = None) -> Callable[[F], F]:
    """Register a function, which Numba must be able to compile, as a crowd model.

    The function returns the next velocity (vx, vy) of one person in m/s. Goals, standing, pairs,
    entering and leaving are the same for all crowd models. Its arguments are, in this order:

    - `agents`: rows `[px, py, vx, vy, radius]` of the people present and, with
      `Scenario.robots_visible`, of the robots; radii include `Scenario.human_safety_space`;
    - `count`: the number of rows;
    - `i`: the row of the person;
    - `preferred_x`, `preferred_y`: the velocity straight to the goal at the preferred speed, or
      zero for a person who stands;
    - `max_speed`: the preferred speed;
    - `p`: the scenario's parameters, such as `p.time_step`;
    - `settings`: the model's own settings, such as `settings.reach`;
    - `scratch`: the arrays of `mrsan.kernels.orca.orca_room` to work in.

    Args:
        name: value of `Scenario.crowd`.
        settings: a dataclass of the model's own settings, each with a default, whose values
            `Scenario.crowd_settings` changes; None: there are none.
    """

    def register(source: F) -> F:
        CROWDS[name] = CrowdModel(
            name, walk_to_goals, crowd_velocity=function(source), settings=settings,
            kernel_settings=(lambda scenario: ()) if settings is None else _reader(settings),
        )  # fmt: skip
        return source

    return register


def _reader(settings: type) -> Callable[[Any], tuple[Any, ...]]:
    """Return what reads `Scenario.crowd_settings` into a named tuple, the form that Numba takes."""
    hints = get_type_hints(settings)
    forms = {f.name: kernel_form(hints[f.name]) for f in fields(settings)}
    for name, form in forms.items():
        if form is None:
            raise TypeError(
                f"{settings.__name__}.{name} has type {hints[name]}; a setting of a crowd model "
                "must be a float, an int, a bool or an enum"
            )
    numbers: Any = namedtuple("Numbers", forms)  # type: ignore[misc]
    # Numba stores the type in its cache, so it must be importable.
    numbers.__module__ = settings.__module__
    numbers.__qualname__ = f"{settings.__qualname__}.Numbers"
    settings.Numbers = numbers  # type: ignore[attr-defined]

    def read(scenario: Any) -> tuple[Any, ...]:
        values = settings(**scenario.crowd_settings)
        return numbers(*(form(getattr(values, name)) for name, form in forms.items() if form))

    return read


class OrcaSettings(NamedTuple):
    """The settings of ORCA, which are fields of `Scenario`."""

    neighbor_distance: np.float32
    max_neighbors: int
    time_horizon: np.float32

    @classmethod
    def of(cls, s: Any) -> OrcaSettings:
        """Return those of a scenario."""
        return cls(
            np.float32(s.neighbor_distance), int(s.max_neighbors), np.float32(s.time_horizon)
        )


class SocialForceSettings(NamedTuple):
    """The settings of the social-force model, which are fields of `Scenario`."""

    relaxation_time: np.float32
    force_strength: np.float32
    force_range: np.float32

    @classmethod
    def of(cls, s: Any) -> SocialForceSettings:
        """Return those of a scenario."""
        return cls(
            np.float32(s.relaxation_time), np.float32(s.force_strength), np.float32(s.force_range)
        )


for _model in (
    CrowdModel(
        Crowd.orca.value, walk_to_goals, crowd_velocity=orca_crowd, kernel_settings=OrcaSettings.of
    ),
    CrowdModel(
        Crowd.social_force.value, walk_to_goals, crowd_velocity=social_force_crowd,
        kernel_settings=SocialForceSettings.of,
    ),
    CrowdModel(Crowd.still.value, stand_still),
    CrowdModel(Crowd.recorded.value, walk_as_recorded, update_presence=follow_recording),
):  # fmt: skip
    CROWDS[_model.name] = _model


def check_crowd(name: Any, settings: Any) -> None:
    """Check the name of a crowd model and its settings.

    Raises:
        ConfigurationError: there is no such model, or a setting is unknown or out of range.
    """
    if not isinstance(name, str) or name not in CROWDS:
        raise ConfigurationError(
            f"scenario.crowd is {name!r}; it must be one of {', '.join(CROWDS)} (plugins=[module] "
            "registers others)"
        )
    if not isinstance(settings, dict):
        raise ConfigurationError(
            f"scenario.crowd_settings is {settings!r}; it must be names with their values"
        )
    schema = CROWDS[name].settings
    names = [] if schema is None else [f.name for f in fields(schema)]
    for key in settings:
        if key not in names:
            permitted = f"have only {', '.join(names)}" if names else "be empty"
            raise ConfigurationError(
                f"scenario.crowd_settings has {key!r}; with scenario.crowd {name} it must "
                f"{permitted}"
            )
    if schema is not None:
        check_numbers(schema(**settings), "scenario.crowd_settings")


@cache
def step_kernel(model: CrowdModel) -> kernel:
    """Return the kernel that moves worlds whose people follow a crowd model."""
    return advance.variant(
        model.name,
        choose_velocities=model.choose_velocities,
        update_presence=model.update_presence,
        crowd_velocity=model.crowd_velocity,
    )
