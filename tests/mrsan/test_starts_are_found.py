"""Every scenario starts or is refused within seconds, whatever its numbers."""

import dataclasses
import time
from enum import Enum
from functools import cache
from typing import Any, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mrsan import ConfigurationError, Crowd, Layout, Scenario, World

SECONDS = 10.0


def reset(scenario: Scenario, worlds: int = 1) -> World:
    world = World(scenario, worlds)
    world.reset(np.arange(worlds))
    return world


@pytest.mark.parametrize("length", [0.1, 4.0, 10.0, 14.0])
def test_routes_of_one_fixed_length_are_drawn(length: float) -> None:
    scenario = Scenario(
        layout=Layout.square, humans=0, robots=2, route_length_min=length, route_length_max=length
    )
    state = reset(scenario, 200).state
    way = np.linalg.norm(state.robot_goal - state.robot_position, axis=-1)
    np.testing.assert_allclose(way, length, rtol=1e-5)
    # Two robots may need a wider floor than its 14 m, but only little.
    assert np.abs([state.robot_position, state.robot_goal]).max() < 7.0 * 2.0


def test_a_place_without_room_is_refused_at_once() -> None:
    begin = time.process_time()
    wide = {"layout": Layout.square, "floor_size": 6.0, "arena_radius": 25.0, "robot_radius": 2.0}
    for fields in ({"crowd": Crowd.recorded, "spawn_clearance": 10.0}, wide):
        with pytest.raises(ConfigurationError, match=r"^scenario\.robots is 16.*spawn_clearance"):
            reset(Scenario(robots=16, **fields), 5)
    crowded = {"human_radius_min": 0.05, "human_radius_max": 2.0, "spawn_clearance": 10.0}
    reset(Scenario(humans=64, pair_probability=1.0, **crowded), 5)
    assert time.process_time() - begin < SECONDS


@cache
def compile_kernels() -> None:
    """Do once what takes long only because kernels are compiled at first use."""
    for crowd in Crowd:  # each has its own kernel, with and without walls
        for layout in (Layout.circle, Layout.doorway):
            if crowd is not Crowd.recorded or layout is Layout.circle:
                reset(Scenario(crowd=crowd, layout=layout, lidar_rays=4)).step(np.zeros((1, 3, 3)))


def values(field: dataclasses.Field, hint: Any) -> st.SearchStrategy:
    """Legal values of a field, its extremes among them."""
    if hint is bool:
        return st.booleans()
    if isinstance(hint, type) and issubclass(hint, Enum):
        return st.sampled_from(list(hint))
    low, high = field.metadata["low"], field.metadata["high"]
    if hint is int or int in getattr(hint, "__args__", ()):
        return st.integers(int(low), int(high))
    low += 1e-3 * field.metadata["above"]
    return st.sampled_from([low, high]) | st.floats(low, high) | st.floats(low, min(low + 5, high))


def scenarios() -> st.SearchStrategy[dict[str, Any]]:
    """A few fields of a scenario with legal values."""
    hints = get_type_hints(Scenario)
    choices = {
        f.name: values(f, hints[f.name])
        for f in dataclasses.fields(Scenario)
        if "low" in f.metadata or f.type in ("bool", "Layout", "Kinematics")
    } | {"crowd": st.sampled_from(list(Crowd))}
    return st.lists(st.sampled_from(sorted(choices)), unique=True, max_size=12).flatmap(
        lambda names: st.fixed_dictionaries({name: choices[name] for name in names})
    )


@settings(max_examples=100, deadline=None, suppress_health_check=list(HealthCheck))
@given(fields=scenarios())
def test_any_legal_scenario_starts_or_is_refused_within_seconds(fields: dict[str, Any]) -> None:
    compile_kernels()
    begin = time.process_time()
    try:
        world = reset(Scenario(**fields))
        world.step(np.zeros((1, world.scenario.robots, world.scenario.action_size)))
        assert np.isfinite(world.state.robot_position).all()
        assert np.isfinite(world.state.human_position).all()
    except ConfigurationError:
        pass
    assert time.process_time() - begin < SECONDS
