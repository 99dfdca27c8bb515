"""The right of way on a robot: as in the simulator, and over links that lose and delay messages."""

import copy
import json
import math
import pickle
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from mrsan import ConfigurationError, Split, World
from mrsan.place_shapes import polygons_of
from mrsan.se2 import rotate
from samarl import load_agent, load_scenario
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.export import export_agent
from samarl.runtime import (
    Detection,
    Driver,
    InputError,
    KnownMap,
    Message,
    OwnState,
    RightOfWayDriver,
)
from samarl.runtime.simulation import as_seen

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENARIO = load_scenario("narrow_doorway", team_messages=True, team_loss=0.2)
MESSAGE = Message("bob", 0.0, 1.0, 2.0, 0.0, 0.0, 0.5, False, 0, 0)


@pytest.fixture(scope="module")
def office() -> KnownMap:
    return KnownMap.load(EXAMPLES / "maps/office.yaml")


@pytest.fixture(scope="module")
def macro_level(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("macro") / "macro_level.onnx"
    agent = load_agent("right_of_way", SCENARIO, macro_level="right_of_way_macro")
    export_agent(path, agent, "right_of_way")
    return path


def map_of(world: World) -> KnownMap:
    """The map of the first world, about the world's origin, so that rounding is the same."""
    known, state = KnownMap(polygons_of(world.state, 0)), world.state
    known.centre = np.zeros(2)
    names = "place", "walls", "corners", "corner_distance"
    known.local = known.local._replace(**{name: getattr(state, name)[0].copy() for name in names})
    return known


def name_of(slot: int, robot: int) -> str:
    """The name of the robot in a slot of another robot's observation."""
    return str(slot + (slot >= robot))


def heard(observation, robot: int, own: OwnState, time: float, passages: int) -> list[Message]:  # type: ignore[no-untyped-def]
    """The messages that a robot of the simulator receives, in the frame of the world."""
    rows, mask = observation.entities["messages"]
    messages = []
    for slot in np.flatnonzero(mask[0, robot]):
        x, y, vx, vy, priority, through, macro_action = map(float, rows[0, robot, slot])
        cos, sin = math.cos(own.heading), math.sin(own.heading)
        dx, dy = rotate(cos, sin, x, y)
        vx, vy = rotate(cos, sin, vx, vy)
        place = own.x + dx, own.y + dy, own.velocity_x + vx, own.velocity_y + vy
        intent = priority, through > 0.5, int(macro_action)
        messages.append(Message(name_of(slot, robot), time, *place, *intent, passages))
    return messages


@pytest.mark.parametrize("learned", [False, True])
def test_it_drives_as_the_planner_does(learned: bool, macro_level: Path) -> None:
    """Every robot of a team, also where messages are lost."""
    changes = {"macro_level": "right_of_way_macro"} if learned else {}
    agent = load_agent("right_of_way", SCENARIO, **changes)
    assert isinstance(agent, RightOfWay)
    different = steps = 0
    for case in Split.validation.case(0) + np.arange(2):
        world = World(SCENARIO, 1)
        observation = world.reset([case])
        agent.reset(np.ones(1, np.bool_))
        known, file = map_of(world), macro_level if learned else None
        team = [
            RightOfWayDriver(known, str(robot), SCENARIO, file, forget_after=1e3)
            for robot in range(SCENARIO.robots)
        ]
        for robot, driver in enumerate(team):
            driver.reset(float(observation.sensors["priority"][0, robot, 0]))
        for step in range(100):
            action, time = agent.act(observation), SCENARIO.time_step * step
            for robot, driver in enumerate(team):
                own, seen = as_seen(observation, robot)
                seen = [d._replace(id=name_of(d.id, robot) if d.robot else None) for d in seen]
                messages = heard(observation, robot, own, time, driver.passages)
                command, own_message = driver.step(own, seen, time, messages)
                if agent.memory.arrived[0, robot]:
                    assert command.speed <= math.hypot(own.velocity_x, own.velocity_y)
                    continue
                steps += 1
                different += not np.allclose(command.action, action[0, robot], atol=1e-3)
                assert own_message.macro_action == agent.macro_actions()[0, robot]
            world.tell(agent.macro_actions())
            observation = world.step(action).observation
            if world.state.done.all():
                break
    assert steps > 200
    assert different <= 0.01 * steps


@pytest.mark.parametrize(("loss", "delay"), [(0.0, 0.0), (0.3, 0.5), (1.0, 0.0)])
@pytest.mark.parametrize("first", ["ada", "bob"])
def test_two_robots_pass_a_door_in_opposite_directions(
    loss: float, delay: float, first: str, office: KnownMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They know of each other from messages alone; if both set off, the priority decides.

    Without messages they collide.
    """
    monkeypatch.syspath_prepend(str(EXAMPLES))
    example = import_module("two_robots_udp")
    lost = np.random.default_rng(0)
    team, bases, arrival = {}, {}, {}
    tracks: dict[str, list[tuple[float, float, float]]] = {name: [] for name in example.WAYS}
    sent: dict[str, list[tuple[float, str]]] = {name: [] for name in example.WAYS}
    for name, (start, goal) in example.WAYS.items():
        team[name] = RightOfWayDriver(office, name)
        team[name].reset(priority=0.9 if name == first else 0.1)
        heading = math.atan2(goal[1] - start[1], goal[0] - start[0])
        bases[name] = example.Base(*start, heading=heading)
    for tick in range(1200):
        time = example.TICK * tick
        for name, base in bases.items():
            base.move(time)
            tracks[name].append((time, base.x, base.y))
        if tick % 5:
            continue
        for name, other in zip(bases, reversed(bases), strict=True):
            ready = [text for due, text in sent[other] if due <= time]
            sent[other] = [pair for pair in sent[other] if pair[0] > time]
            messages = [Message(**json.loads(text)) for text in ready]
            own = bases[name].state(example.WAYS[name][1])
            command, message = team[name].step(own, [], time, messages)
            bases[name].execute(command)
            if lost.random() >= loss:
                sent[name].append((time + delay, json.dumps(message._asdict())))
            if math.hypot(own.x - own.goal_x, own.y - own.goal_y) < example.RADIUS:
                arrival.setdefault(name, time)
    assert len(arrival) == 2
    assert delay == 0.0 or min(arrival, key=lambda name: arrival[name]) == first
    gap = example.least_gap(tracks)
    assert gap < 0.0 if loss == 1.0 else gap > 0.2
    assert all(base.speed == 0.0 for base in bases.values())


def test_messages_of_others_are_checked(office: KnownMap) -> None:
    driver = RightOfWayDriver(office, "ada")
    own = OwnState(-4.0, 4.2, 0.0, 0.0, 0.0, -6.5, -1.5)
    valid = MESSAGE._replace(passages=driver.passages, time=5.0)
    for wrong, name in (
        (valid._replace(passages=driver.passages + 1), "passages"),
        (valid._replace(time=9.0), "time"),
        (valid._replace(priority=1.0), "priority"),
        (valid._replace(x=math.nan), "x"),
        (valid._replace(macro_action=-1), "macro_action"),
        (valid._replace(robot=3), "robot"),
        (valid._replace(through=1), "through"),
    ):
        with pytest.raises(InputError, match=rf"messages\[1\]\.{name} is "):
            driver.step(own, [], 5.0, [valid, wrong])
    _, own_message = driver.step(own, [], 5.0, [valid])  # the refused steps have changed nothing
    assert own_message.passages == driver.passages
    assert (own_message.robot, own_message.time, own_message.x, own_message.y) == (
        "ada",
        5.0,
        -4.0,
        4.2,
    )
    for priority in (1, -0.1, math.nan, "high"):
        with pytest.raises(InputError, match=rf"^priority is '?{priority}"):
            driver.reset(priority=priority)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"^robot is 3;"):
        RightOfWayDriver(office, 3)  # type: ignore[arg-type]
    for seconds in (0.0, math.nan, "ten"):
        with pytest.raises(InputError, match=r"^forget_after is"):
            RightOfWayDriver(office, "ada", forget_after=seconds)  # type: ignore[arg-type]


def test_a_driver_continues_identically_from_a_pickle(office: KnownMap, macro_level: Path) -> None:
    driver = RightOfWayDriver(office, "ada", macro_level=macro_level)
    other = MESSAGE._replace(x=-5.5, y=0.6, passages=driver.passages)
    own = OwnState(-5.5, 2.4, -1.6, 0.0, 0.0, -6.5, -1.5)
    driver.step(own, [], 0.0, [other])
    twins = copy.deepcopy(driver), pickle.loads(pickle.dumps(driver))
    for step in range(1, 5):
        command, message = driver.step(own, [], 0.25 * step)
        for twin in twins:
            twin_command, twin_message = twin.step(own, [], 0.25 * step)
            assert (twin_command.action == command.action).all()
            assert twin_message == message


def test_a_robot_waits_for_one_that_goes_until_it_is_forgotten(office: KnownMap) -> None:
    """The other one said that it goes through the door, and then nothing more."""
    driver = RightOfWayDriver(office, "ada", forget_after=4.0)
    own = OwnState(-5.5, 2.4, -1.6, 0.0, 0.0, -6.5, -1.5)
    entries = {}
    for name, start, goal in (("in", (-5.5, 0.2), (-4.2, 3.6)), ("out", (-5.5, 1.9), (-6.5, -1.5))):
        driver.reset(priority=0.5)
        for step in range(2):
            _, own_message = driver.step(OwnState(*start, 0.0, 0.0, 0.0, *goal), [], 0.25 * step)
        entries[name] = own_message.macro_action
        assert own_message.macro_action % 4 == 2  # it goes
    assert entries["in"] != entries["out"]
    driver.reset(priority=0.9)
    other = MESSAGE._replace(x=-5.5, y=0.6, macro_action=entries["in"], passages=driver.passages)
    waits = []
    for step in range(32):
        _, own_message = driver.step(own, [], 0.25 * step, [other] if step == 0 else [])
        waits.append(own_message.macro_action % 4 == 1)
    assert all(waits[:17])
    assert not any(waits[18:])


def test_a_robot_too_close_to_a_wall_drives_away(office: KnownMap) -> None:
    """1 mm from the outer wall at x = -7.8 m: the simulator's rollouts keep 12 mm."""
    driver = RightOfWayDriver(office, "ada")
    x, y, heading, goal = -7.499, 2.0, math.pi / 2, (-4.2, 2.0)
    for step in range(12):
        own = OwnState(x, y, heading, 0.0, 0.0, *goal)
        command, _ = driver.step(own, [], 0.25 * step)
        heading = command.heading
        x, y = x + 0.125 * command.speed * math.cos(heading), y
    assert x > -7.4


def test_a_detected_robot_is_the_team_mate_that_is_expected_there(office: KnownMap) -> None:
    """A robot that has not spoken is a person; one that has is not counted twice."""
    driver = RightOfWayDriver(office, "ada")
    robot = Detection(1.2, 2.0, 0.0, 0.0, robot=True)
    own_message = MESSAGE._replace(passages=driver.passages)
    assert driver._team.update([], [robot], 0.0) == [robot]
    assert driver._team.update([own_message], [robot], 0.0) == []
    assert driver._team.mates["bob"].position(1.0) == (1.2, 2.0)
    far = robot._replace(x=3.0)
    assert driver._team.update([], [far], 1.0) == [far]
    assert driver._team.update([], [far._replace(id="bob")], 1.0) == []
    assert driver._team.mates["bob"].position(1.0) == (3.0, 2.0)


def test_only_macro_levels_are_exported(macro_level: Path, tmp_path: Path) -> None:
    file = tmp_path / "macro_level.onnx"
    for level, name in ((None, "null"), ("random", "random"), ("enter", "enter")):
        agent = load_agent("right_of_way", SCENARIO, macro_level=level)
        with pytest.raises(ConfigurationError, match=rf"agent\.macro_level is {name};"):
            export_agent(file, agent, "right_of_way")
    with pytest.raises(ConfigurationError, match="it is a macro level"):
        Driver.load(macro_level)
    assert not file.exists()


def test_other_files_are_no_macro_levels(office: KnownMap, tmp_path: Path) -> None:
    (tmp_path / "damaged.onnx").write_bytes(b"no network")
    for name, reason in (("missing.onnx", "there is no such file"), ("damaged.onnx", "cannot be")):
        with pytest.raises(ConfigurationError, match=reason):
            RightOfWayDriver(office, "ada", macro_level=tmp_path / name)
