"""The playground's sessions: what is done by hand, undone, saved and played again."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrsan import ConfigurationError, Kinematics, Outcome, Scenario, Split
from samarl.api import evaluate, load_agent, load_scenario
from samarl.evaluation.trajectory import Playback, record_episode
from samarl.play.keyboard import keyboard_action
from samarl.play.server import answer
from samarl.play.session import MessageError, Session

CASE = Split.test.case(3)
TASK = Scenario(robots=2, humans=3)


def session(folder: Path, scenario: Scenario = TASK, *agents: str) -> Session:
    scenes = folder / "scenes"
    scenes.mkdir(exist_ok=True)
    return Session(scenes, scenario, agents or ("orca", "straight"), CASE, folder)


def send(visitor: Session, kind: str, **fields: Any) -> dict[str, Any]:
    return visitor.handle({"type": kind, **fields})


def steps(visitor: Session, count: int) -> None:
    for _ in range(count):
        send(visitor, "step")


def finish(visitor: Session) -> None:
    while not all(side.is_over for side in visitor.sides):
        send(visitor, "step")


def assert_same(visitor: Session, name: str, folder: Path) -> None:
    """Every agent plays the saved scene to the same bits, and is evaluated to the same end."""
    case = load_scenario(case_file=str(folder / f"{name}.yaml"))
    for agent, side in zip(visitor.agents, visitor.sides, strict=True):
        trajectory = record_episode(load_agent(agent, case), case, visitor.scene.case)
        for field in ("robot_position", "robot_velocity", "robot_heading", "human_position"):
            played = getattr(side.trajectory(), field)
            np.testing.assert_array_equal(getattr(trajectory, field), played, err_msg=field)
        outcome = evaluate(agent, case, cases=5).episodes.outcome
        np.testing.assert_array_equal(outcome, side.trajectory().episodes.outcome)


def test_a_saved_scene_plays_bit_for_bit_as_on_the_page(tmp_path: Path) -> None:
    visitor = session(tmp_path)
    steps(visitor, 8)
    send(visitor, "move", what="person", number=1, position=[0.5, 0.253])
    steps(visitor, 2)
    send(visitor, "move", what="person", number=1, position=[0.6, 0.5], begins=False)
    send(visitor, "move", what="goal", number=1, position=[-2.0, 0.5])
    send(visitor, "drive", robot=0, keys=["up", "left"])
    steps(visitor, 3)
    send(visitor, "drive", robot=None)
    send(visitor, "move", what="robot", number=1, position=[3.0, 3.0])
    finish(visitor)
    assert send(visitor, "save", name="mine")["path"] == str(tmp_path / "mine.yaml")
    assert_same(visitor, "mine", tmp_path)
    # Another agent, and the same again, play the same scene.
    before = visitor.sides[0].trajectory().robot_position
    send(visitor, "choose", agents=["straight"])
    send(visitor, "choose", agents=["orca"])
    finish(visitor)
    np.testing.assert_array_equal(visitor.sides[0].trajectory().robot_position, before)
    reopened = session(tmp_path, load_scenario(case_file=str(tmp_path / "mine.yaml")), "orca")
    finish(reopened)
    np.testing.assert_array_equal(reopened.sides[0].trajectory().robot_position, before)


def test_a_walking_person_and_a_wall_are_saved(tmp_path: Path) -> None:
    visitor = session(tmp_path, TASK, "orca")
    steps(visitor, 4)
    clock = send(visitor, "add", position=[0.0, 0.0])
    assert (clock["clock"], clock["humans"], clock["walker"]) == (0, 4, 3)
    send(visitor, "walk", position=[0.0, 2.0])
    steps(visitor, 4)
    human = visitor.sides[0].world.state.human_position[0, 3]
    np.testing.assert_allclose(human, [0.0, 1.4], atol=1e-3)  # a second at walking speed
    send(visitor, "wall", start=[1.0, -1.0], end=[1.0, 1.0])
    assert send(visitor, "step")["layout"] == "map"
    assert visitor.sides[0].world.state.human_position[0, 3, 1] == pytest.approx(1.75, abs=2e-3)
    finish(visitor)
    send(visitor, "save", name="walled")
    assert_same(visitor, "walled", tmp_path)
    undone = send(visitor, "undo")  # the wall
    assert (undone["clock"], undone["layout"], undone["walker"]) == (4, "circle", 3)
    finish(visitor)
    send(visitor, "save", name="undone")
    assert_same(visitor, "undone", tmp_path)


def test_undoing_returns_to_the_moment_before(tmp_path: Path) -> None:
    visitor = session(tmp_path)
    steps(visitor, 5)
    before = send(visitor, "step")
    future = [send(visitor, "step") for _ in range(3)][-1]
    visitor = session(tmp_path)
    steps(visitor, 6)
    send(visitor, "move", what="robot", number=0, position=[0.0, 0.0])
    steps(visitor, 3)
    send(visitor, "wall", start=[2.0, -1.0], end=[2.0, 1.0])
    send(visitor, "undo")
    undone = send(visitor, "undo")
    assert (undone["clock"], undone["undo"], undone["changes"]) == (6, 0, 0)
    assert undone["sides"] == before["sides"]
    assert [send(visitor, "step") for _ in range(3)][-1]["sides"] == future["sides"]
    with pytest.raises(MessageError, match="undone"):
        send(visitor, "undo")


def test_walls_can_be_drawn_and_erased(tmp_path: Path) -> None:
    visitor = session(tmp_path, TASK, "orca")
    robot = visitor.sides[0].world.state.robot_position[0, 0].tolist()
    with pytest.raises(ConfigurationError, match="touches robot 0"):
        send(visitor, "wall", start=robot, end=[0.0, 0.0])
    with pytest.raises(ConfigurationError, match=r"shorter than 0\.2"):
        send(visitor, "wall", start=[0.0, 0.0], end=[0.1, 0.0])
    with pytest.raises(ConfigurationError, match="no wall"):
        send(visitor, "erase", position=[0.0, 0.0])
    send(visitor, "wall", start=[0.0, -1.0], end=[0.0, 1.0])
    assert visitor.sides[0].scenario.has_walls
    view = send(visitor, "erase", position=[0.1, 0.5])
    assert view["layout"] == "circle"
    doorway = session(tmp_path, replace(TASK, layout="doorway"), "orca")  # type: ignore[arg-type]
    state = doorway.sides[0].world.state
    corner = state.walls[0, :2, 0].tolist()
    count = state.place[0, 0]
    with pytest.raises(ConfigurationError, match="outline"):
        send(doorway, "erase", position=corner)
    send(doorway, "add", position=np.mean(state.robot_position[0], 0).tolist())
    assert doorway.sides[0].world.state.place[0, 0] == count


def test_the_menu_names_the_task(tmp_path: Path) -> None:
    task = load_scenario("doorway", team_messages=True)
    visitor = Session(tmp_path, task, ["orca"], CASE, name="doorway")
    assert visitor.view()["scenario"] == "doorway"
    assert send(visitor, "choose", humans=2)["scenario"] == "doorway"
    assert visitor.sides[0].scenario.team_messages
    assert send(visitor, "choose", scenario="crossing")["scenario"] == "crossing"


def test_it_says_what_is_decided_and_what_it_is_worth(tmp_path: Path) -> None:
    visitor = session(tmp_path, TASK, "cadrl", "orca")
    cadrl, orca = send(visitor, "step")["sides"]
    assert orca["insight"][0]["words"].startswith("The policy wants to ")
    assert orca["episode"]["values"] is None
    assert np.shape(cadrl["episode"]["values"]) == (2, 1)
    steps(visitor, 2)
    before = visitor.view()["sides"]
    send(visitor, "move", what="robot", number=0, position=[3.0, 3.0])
    steps(visitor, 2)
    assert send(visitor, "undo")["sides"] == before


def test_bad_messages_change_nothing(tmp_path: Path) -> None:
    visitor = session(tmp_path)
    steps(visitor, 2)
    before = json.dumps(visitor.view())
    for text, word in (
        ("", "JSON"),
        ("[" * 9000, "JSON"),
        ('{"type": "step", "x": NaN}', "JSON"),
        ("[]", "type"),
        ('{"type": "fly"}', "fly"),
        ('{"type": ["step"]}', "type"),
        ('{"type": "move", "what": "person", "number": 3, "position": [0, 0]}', "[0, 2]"),
        ('{"type": "move", "what": "person", "number": true, "position": [0, 0]}', "True"),
        ('{"type": "move", "what": "dog", "number": 0, "position": [0, 0]}', "dog"),
        ('{"type": "move", "what": "robot", "number": 0, "position": [0, 1e9]}', "position"),
        ('{"type": "move", "what": "robot", "number": 0, "position": "00"}', "position"),
        ('{"type": "move", "what": ["robot"], "number": 0, "position": [0, 0]}', "what"),
        ('{"type": "wall", "start": [0, 0]}', "end"),
        ('{"type": "walk", "position": [0, 0]}', "add a person"),
        ('{"type": "drive", "robot": 0, "keys": ["jump"]}', "jump"),
        ('{"type": "drive", "robot": 7}', "7"),
        ('{"type": "choose", "agents": []}', "agents"),
        ('{"type": "choose", "agents": ["/etc/passwd"]}', "passwd"),
        ('{"type": "choose", "agents": ["orca", "orca"]}', "differ"),
        ('{"type": "choose", "agents": ["masac"]}', "kinematics"),
        ('{"type": "choose", "scenario": "../x"}', "scenario"),
        ('{"type": "choose", "robots": 99}', "scenario.robots is 99"),
        ('{"type": "choose", "humans": "many"}', "scenario.humans"),
        ('{"type": "choose", "layout": "moon"}', "moon"),
        ('{"type": "choose", "layout": "map"}', "map"),
        ('{"type": "choose", "crowd": "os.system"}', "os.system"),
        ('{"type": "choose", "case": -1}', "case"),
        ('{"type": "save", "name": "../up"}', "name"),
        ('{"type": "save", "name": ""}', "name"),
    ):
        reply = answer(visitor, text)
        assert reply["type"] == "error", text
        assert word in reply["message"], reply
        assert "internal" not in reply["message"]
        assert json.dumps(visitor.view()) == before, text
    send(visitor, "save", name="taken")
    assert "exists" in answer(visitor, '{"type": "save", "name": "taken"}')["message"]


def test_keys_drive_robots_of_every_kind() -> None:
    for kinematics, keys, turned in (
        # Two steps of 0.25 s with 1 m/s^2, turning with a radius of 1 m, or by 15 degrees in each.
        (Kinematics.acceleration_heading, ["up", "left"], (0.25 + 0.5) * 0.25),
        (Kinematics.unicycle, ["up", "left"], math.radians(30)),
        (Kinematics.holonomic, ["left"], None),
    ):
        task = Scenario(robots=1, humans=0, kinematics=kinematics)
        playback = Playback(load_agent("straight", task), task, 0)
        state = playback.world.state
        start, heading = state.robot_position[0, 0].copy(), float(state.robot_heading[0, 0])
        for _ in range(2):
            speed = float(np.hypot(*state.robot_velocity[0, 0]))
            action = keyboard_action(keys, speed, float(state.robot_heading[0, 0]), task)
            playback.world.step(np.array(action, np.float32)[None, None])
        if turned is None:
            moved = state.robot_position[0, 0] - start
            np.testing.assert_allclose(moved, [-0.5, 0.0], atol=1e-3)
            continue
        assert np.hypot(*state.robot_velocity[0, 0]) == pytest.approx(0.5, abs=1e-3)
        turn = math.remainder(float(state.robot_heading[0, 0]) - heading, 2 * math.pi)
        assert turn == pytest.approx(turned, abs=1e-3)


def test_an_attack_finds_a_path_that_makes_an_agent_fail(tmp_path: Path) -> None:
    visitor = session(tmp_path, Scenario(robots=1, humans=2), "orca")

    def search() -> float:
        for _ in range(20):
            reply = send(visitor, "attack")
            if reply["change"] is not None:
                break
        assert reply["failure"] in ("a robot runs into a person", "a person runs into a robot")
        return float(reply["change"])

    change = search()
    assert 0.0 < change < 5.0
    send(visitor, "move", what="goal", number=0, position=[3.0, 3.0])
    with pytest.raises(MessageError, match="no path"):  # that was for another goal
        send(visitor, "attack", play=True)
    send(visitor, "undo")
    assert search() == change
    view = send(visitor, "attack", play=True)
    assert (view["clock"], view["undo"]) == (0, 1)
    finish(visitor)
    assert visitor.sides[0].trajectory().episodes.outcome[0, 0] == Outcome.hit_human
    person = next(person for person in visitor.scene.people if person)
    walked = np.linalg.norm(np.diff(np.array(person["path"])[:, 1:], axis=0), axis=1)
    assert walked.max() <= 1.4 * 0.25  # walking speed
    send(visitor, "save", name="found")
    assert_same(visitor, "found", tmp_path)
    send(visitor, "restart")
    with pytest.raises(ConfigurationError, match="fails in this case by itself"):
        send(visitor, "attack")
