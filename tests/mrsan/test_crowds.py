"""Custom crowd models: registration, settings, motion, errors and other processes."""

import multiprocessing
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrsan import ConfigurationError, PluginError, Scenario, World, register_crowd
from mrsan.crowds import CROWDS, crowd_model
from mrsan.fields import number, setting
from samarl.configuration import import_plugins

GUIDE = Path(__file__).parents[2] / "docs/extending.md"
STILL_ROBOTS = np.zeros((2, 3, 3), np.float32)


@pytest.fixture(scope="module")
def stroll(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Import the crowd model of the guide from a temporary folder."""
    folder = tmp_path_factory.mktemp("plugin")
    section = GUIDE.read_text().split("## A crowd model\n")[1]
    (folder / "my_crowd.py").write_text(section.split("```python\n")[1].split("```")[0])
    sys.path.append(str(folder))
    import_module("my_crowd")
    yield
    sys.path.remove(str(folder))
    del CROWDS["stroll"], sys.modules["my_crowd"]


@pytest.fixture
def registry() -> Iterator[None]:
    """Forget the models that a test registers."""
    before = dict(CROWDS)
    yield
    CROWDS.clear()
    CROWDS.update(before)


class Mood(Enum):
    calm = 0
    hasty = 3


@dataclass
class MoodSettings:
    mood: Mood = setting(Mood.calm)
    neighbours: int = number(2, 0, 9)
    distance: float = number(0.5, 0.0, 5.0)
    alert: bool = setting(True)


def walk(agents, count, i, preferred_x, preferred_y, max_speed, p, settings, scratch):
    return preferred_x, preferred_y


def speeds(scenario: Scenario) -> list[float]:
    """Return all speeds after one step of two worlds."""
    world = World(scenario, 2)
    world.reset([0, 1])
    world.step(STILL_ROBOTS)
    return np.linalg.norm(world.state.human_velocity, axis=-1).ravel().tolist()


def test_a_velocity_that_is_not_finite_is_named(
    stroll: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would otherwise count as a person who is nowhere, so that nobody collides."""
    world = World(Scenario(crowd="stroll"), 2)
    world.reset([0, 7])
    world.step(STILL_ROBOTS)
    move = world._move

    def broken(*arguments: Any) -> Any:
        result = move(*arguments)
        world.state.human_velocity[1, 2, 0] = np.nan
        return result

    monkeypatch.setattr(world, "_move", broken)
    with pytest.raises(PluginError, match=r"crowd stroll is nan for person 2 in world 1.*case 7"):
        world.step(STILL_ROBOTS)


@pytest.mark.parametrize(
    ("settings", "speed"), [({}, 0.6), ({"pace": 0.25}, 0.3), ({"pace": 1}, 1.2)]
)
def test_a_setting_changes_the_speed(stroll: None, settings: dict[str, Any], speed: float) -> None:
    fast = {"human_speed_min": 1.2, "human_speed_max": 1.2}
    world = World(Scenario(crowd="stroll", crowd_settings=settings, **fast), 2)
    world.reset([0, 1])
    before = world.state.human_position.copy()
    ahead = world.state.human_goal - before
    world.step(STILL_ROBOTS)
    expected = speed * 0.25 * ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    np.testing.assert_allclose(world.state.human_position - before, expected, atol=2e-6)


def test_invalid_settings_are_named(stroll: None) -> None:
    for settings, message in (
        ({"speed": 1.0}, r"scenario\.crowd_settings.*'speed'.*pace"),
        ({"pace": 1.5}, r"scenario\.crowd_settings\.pace is 1\.5.*\[0, 1\]"),
        (0.5, r"scenario\.crowd_settings.*0\.5"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            replace(Scenario(crowd="stroll"), crowd_settings=settings)


def test_settings_reach_the_function_as_numbers(registry: None) -> None:
    register_crowd("moody", MoodSettings)(walk)
    scenario = Scenario(crowd="moody", crowd_settings={"mood": "hasty", "distance": 1})
    settings: Any = crowd_model("moody").kernel_settings(scenario)
    assert settings._asdict() == {"mood": 3, "neighbours": 2, "distance": 1.0, "alert": True}
    assert type(settings.distance) is np.float32
    with pytest.raises(ConfigurationError, match=r"crowd_settings\.mood is 'sad'.*calm, hasty"):
        Scenario(crowd="moody", crowd_settings={"mood": "sad"})


@pytest.mark.slow
def test_worker_processes_need_the_module(stroll: None) -> None:
    scenario = Scenario(crowd="stroll", crowd_settings={"pace": 0.25})
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, import_plugins, (["my_crowd"],)) as pool:
        assert pool.submit(speeds, scenario).result() == speeds(scenario)
    with ProcessPoolExecutor(1, context) as pool:
        error = pool.submit(speeds, scenario).exception()
    assert isinstance(error, ConfigurationError)
    assert "scenario.crowd is 'stroll'" in str(error)
