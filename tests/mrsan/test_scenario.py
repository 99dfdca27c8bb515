"""Every number of a scenario is checked, and the message says what would be right."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from mrsan import ConfigurationError, Crowd, Layout, Reactions, Reward, Scenario
from mrsan.parameters import kernel_parameters
from samarl.evaluation.runner import Evaluation

NUMBERS = [
    (owner, field)
    for owner in (Scenario, Reward, Evaluation)
    for field in dataclasses.fields(owner)
    if "low" in field.metadata
]
# What else must change where the end of one range contradicts the default of another field.
ROOM: dict[tuple[str, str], dict[str, Any]] = {
    ("humans_min", "high"): {"humans": 64},
    ("circle_radius", "low"): {"goal_distance": 1.0},
    ("time_limit", "low"): {"time_step": 0.01},
    ("human_radius_min", "high"): {"human_radius_max": 2.0},
    ("human_radius_max", "low"): {"human_radius_min": 0.05},
    ("human_speed_min", "high"): {"human_speed_max": 10.0},
    ("human_speed_max", "low"): {"human_speed_min": 0.05},
    ("goal_distance", "high"): {"circle_radius": 1000.0},
    ("goal_change_probability_max", "low"): {"goal_change_probability": 0.0},
}
PATH = {Scenario: "scenario", Reward: "scenario.reward", Evaluation: "evaluation"}


def make(owner: type, **fields: Any) -> Any:
    if owner is Reward:
        return Scenario(reward=Reward(**fields))
    return owner(**fields)


def test_each_number_out_of_its_range_is_refused_by_name() -> None:
    for owner, field in NUMBERS:
        low, high, above = (field.metadata[key] for key in ("low", "high", "above"))
        wrong: list[Any] = [math.nan, math.inf, -math.inf, "3", True, [1], 1j]
        wrong += [np.nextafter(low, -np.inf), np.nextafter(high, np.inf), low - 1, high + 1]
        wrong += [low] if above else []
        wrong += [] if field.default is None else [None]
        if "int" in str(field.type):
            wrong.append(low + 0.5)
        for value in wrong:
            with pytest.raises(ConfigurationError) as error:
                make(owner, **{field.name: value})
            message = str(error.value)
            assert message.startswith(f"{PATH[owner]}.{field.name} is {value!r}; it must")
            assert f"{low:g}, {high:g}]" in message


def test_the_ends_of_each_range_can_be_used() -> None:
    for owner, field in NUMBERS:
        for end in ("low", "high"):
            name, value = field.name, field.metadata[end]
            if (name, end) == ("arena_radius", "low"):
                value = 6.1  # it must hold the circle
            if end == "low" and field.metadata["above"]:
                value = 1e-3
            others = ROOM.get((name, end), {}) if owner is Scenario else {}
            configuration = make(owner, **{name: value}, **others)
            actual = getattr(configuration.reward if owner is Reward else configuration, name)
            assert actual == value, f"{PATH[owner]}.{name}"


def test_contradictions_name_both_sides() -> None:
    for fields, message in (
        ({"humans": 3, "humans_min": 4}, "humans_min is 4; it must not exceed scenario.humans (3)"),
        ({"human_radius_min": 0.4}, "human_radius_min is 0.4; it must not exceed"),
        ({"human_speed_min": 1.1}, "human_speed_min is 1.1; it must not exceed"),
        ({"time_limit": 0.2}, "time_step is 0.25; it must not exceed scenario.time_limit (0.2)"),
        ({"goal_distance": 5.5}, "goal_distance is 5.5; it must not exceed scenario.circle_radius"),
        ({"arena_radius": 6.0}, "arena_radius is 6.0; it must be null or at least 6.01"),
        ({"reward": 3}, "reward is 3; it must be a Reward"),
        ({"crowd": "nobody"}, "crowd is 'nobody'; it must be one of orca, social_force"),
        ({"layout": "plaza"}, "layout is 'plaza'; it must be one of circle, crossing"),
        ({"reactions": Reactions(regular=0.9)}, "reactions has shares whose sum is 1.5"),
    ):
        with pytest.raises(ConfigurationError) as error:
            Scenario(**fields)  # type: ignore[arg-type]
        assert str(error.value).startswith(f"scenario.{message}")


def test_fields_may_contradict_each_other_where_one_of_them_is_not_used() -> None:
    square, mixed = {"layout": Layout.square}, {"layout": Layout.mixed}
    recorded, still = {"crowd": Crowd.recorded}, {"crowd": Crowd.still}
    for fields, used, unused in (
        ({"route_length_min": 20.0, "route_length_max": 30.0}, [square, mixed], [{}, recorded]),
        ({"route_length_max": 3.0}, [square, mixed, recorded], [{}]),
        ({"circle_radius": 3.0}, [{}, mixed], [square, still, recorded]),  # goal_distance is 4
        ({"goal_change_probability_max": 0.1}, [{}], [still, recorded]),
        ({"human_speed_min": 2.0}, [{}], [recorded]),
        ({"humans_min": 20}, [{}], [recorded]),
    ):
        for place in used:
            with pytest.raises(ConfigurationError, match=r"scenario\.\w+ is "):
                Scenario(**fields, **place)
        for place in unused:
            assert kernel_parameters(Scenario(**fields, **place))
