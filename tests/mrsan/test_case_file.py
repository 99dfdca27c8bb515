"""Case files: starts, paths and changes happen as they say, and damaged ones are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from mrsan import ConfigurationError, Scenario, World
from mrsan.case_file import case_of
from mrsan.place_shapes import polygons_of
from mrsan.scenario import scenario_of_case

STILL = np.zeros((1, 2, 3), np.float32)


def written(folder: Path, **content: Any) -> Scenario:
    path = folder / "case.yaml"
    fields = {"robots": 2, "humans": 3, "route_length_min": 2.0, **content.pop("scenario", {})}
    path.write_text(yaml.safe_dump({"scenario": fields, "case": 7, **content}))
    return scenario_of_case(str(path), {})


def test_a_case_file_says_who_starts_where_and_what_happens_when(tmp_path: Path) -> None:
    people = [None, {"position": [1.0, 0.0], "path": [[1.0, 1.0, 1.2], [1.5, 1.6, 1.2]]}, None]
    edits = [
        {"time": 0.5, "person": 0, "position": [3.0, 3.0]},
        {"time": 0.5, "robot": 1, "goal": [0.0, -3.0]},
        {"time": 0.75, "robot": 0, "action": [1.0, 0.0, 0.0]},
    ]
    robots = [{"position": [-3.0, 0.0], "goal": [3.0, 0.0]}, None]
    world = World(written(tmp_path, people=people, robots=robots, edits=edits))
    plain = World(Scenario(robots=2, humans=3, route_length_min=2.0))
    plain.reset([7])
    world.reset([7])
    state = world.state
    assert state.robot_position[0, 0].tolist() == [-3.0, 0.0]
    assert state.robot_heading[0, 0] == 0.0  # towards its goal
    assert state.route_length[0, 0] == 6.0
    np.testing.assert_array_equal(state.human_position[0, 0], plain.state.human_position[0, 0])
    for k in range(1, 7):
        world.step(STILL)
        if k <= 4:  # 1.2 m in a second, then 0.6 m in half a second
            np.testing.assert_allclose(state.human_position[0, 1], [1.0, 0.3 * k], atol=1e-6)
            np.testing.assert_allclose(state.human_velocity[0, 1], [0.0, 1.2], atol=1e-5)
        if k == 2:
            assert state.human_position[0, 0].tolist() == [3.0, 3.0]
            assert state.robot_goal[0, 1].tolist() == [0.0, -3.0]
        assert (np.hypot(*state.robot_velocity[0, 0]) > 0.0) == (k > 3)
    np.testing.assert_allclose(state.human_position[0, 1], [1.6, 1.2], atol=1e-6)


def test_a_person_on_a_path_who_walks_into_a_robot_hits_it(tmp_path: Path) -> None:
    people = [{"position": [0.0, 2.0], "path": [[2.0, 0.0, 0.0]]}, None, None]
    robots = [{"position": [0.0, 0.0], "goal": [4.0, 0.0]}, None]
    world = World(written(tmp_path, people=people, robots=robots))
    world.reset([7])
    while not world.state.done[0]:
        world.step(STILL)
    assert world.state.clock[0] == 6  # surfaces touch after 1.4 m at 1 m/s
    assert world.state.collision[0].tolist() == [1, 0]


def test_a_file_without_changes_plays_the_case_itself(tmp_path: Path) -> None:
    for layout in ("circle", "doorway"):
        scenario = written(tmp_path, scenario={"layout": layout})
        world, plain = World(scenario), World(Scenario(**{**vars(scenario), "case_file": None}))
        for each in (world, plain):
            each.reset([7])
        for _ in range(20):
            world.step(STILL)
            plain.step(STILL)
        for name, array in world.state._asdict().items():
            np.testing.assert_array_equal(array, getattr(plain.state, name), err_msg=name)


def test_walls_of_a_case_file(tmp_path: Path) -> None:
    walls = [[[0.0, -2.0], [0.0, 2.0]]]
    robots = [{"position": [-2.0, 0.0], "goal": [2.0, 0.0]}, None]
    edits = [{"time": 0.25, "robot": 0, "goal": [-2.0, 3.0]}]
    scenario = written(
        tmp_path,
        walls=walls,
        floor=[-5.0, -5.0, 5.0, 5.0],
        robots=robots,
        edits=edits,
        scenario={"layout": "map", "nearest_walls": 0},
    )
    world = World(scenario)
    world.reset([7])
    state = world.state
    assert [polygon.tolist() for polygon in polygons_of(state, 0)] == walls
    # Round an end of the wall with a clearance of 0.4 m, corners of the route being squares.
    assert 5.6 < state.route_length[0, 0] < 6.6
    world.step(STILL)
    assert state.route_left[0, 0] == pytest.approx(3.0)


def test_damaged_case_files_are_refused(tmp_path: Path) -> None:
    for content, words in (
        ([], ("the file", "mapping")),
        ({"cases": 3}, ("cases", "case")),
        ({"case": -1}, ("case", "-1")),
        ({"walls": [[[0, 0]]]}, ("walls[0]",)),
        ({"walls": [[[0, 0], [0, 0]]]}, ("walls[0]",)),
        ({"floor": [0, 1]}, ("floor", "[0, 1]")),
        ({"people": [{"speed": -1}]}, ("people[0].speed", "-1")),
        ({"people": [{"path": [[1, 0, 0], [1, 2, 2]]}]}, ("people[0].path", "increase")),
        ({"robots": [{"path": []}]}, ("robots[0]", "path")),
        ({"robots": [{"position": [0, float("nan")]}]}, ("robots[0].position", "nan")),
        ({"edits": [{"time": 1, "person": 0}]}, ("edits[0]",)),
        ({"edits": [{"time": -1, "person": 0, "goal": [0, 0]}]}, ("edits[0].time", "-1")),
        ({"edits": [{"time": 1, "person": 0, "action": [0, 0]}]}, ("edits[0].action",)),
        ({"edits": [{"time": 1, "robot": True, "goal": [0, 0]}]}, ("edits[0].robot", "True")),
    ):
        with pytest.raises(ConfigurationError) as error:
            case_of(content)
        assert all(word in str(error.value) for word in words), error.value
    for content, words in (
        ({"people": [None]}, ("scenario.humans is 3", "1")),
        ({"edits": [{"time": 0, "robot": 2, "goal": [0, 0]}]}, ("robot is 2", "[0, 1]")),
        ({"edits": [{"time": 0, "robot": 0, "action": [2, 0, 0]}]}, ("action", "2")),
    ):
        with pytest.raises(ConfigurationError) as error:
            World(written(tmp_path, **content))
        assert all(word in str(error.value) for word in words), error.value
    with pytest.raises(ConfigurationError, match="layout is circle"):
        written(tmp_path, walls=[[[0, 0], [1, 1]]])
    (tmp_path / "case.yaml").write_text("a: [")
    for path in ("case.yaml", "missing.yaml"):
        with pytest.raises(ConfigurationError, match=r"scenario\.case_file.*" + path):
            scenario_of_case(str(tmp_path / path), {})
