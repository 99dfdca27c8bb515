"""The sensor of passages, against numbers that can be checked by hand."""

from pathlib import Path

import numpy as np
import pytest
import shapely

from mrsan import ConfigurationError, Layout, Place, Scenario, World
from mrsan.kernels.routes import GOAL
from mrsan.passages import find_passages
from mrsan.place_shapes import route_of
from mrsan.sensors import passages as sensor
from mrsan.sensors.passages import PASSAGE_FEATURES

NARROW = Place(door_width_max=1.4, corridor_width_min=1.0, corridor_width_max=1.4)
OFFICE = Path(__file__).parents[2] / "examples" / "maps" / "office.yaml"


def world_of(layout: Layout, **fields) -> World:
    usual = {"layout": layout, "place": NARROW, "robots": 2, "humans": 4, "next_passages": 2}
    world = World(Scenario(**(usual | fields)), 1)
    world.reset([0])
    return world


def seen(world: World, robot: int = 0, slot: int = 0) -> dict[str, float] | None:
    features, mask = world.observe().entities["passages"]
    if not mask[0, robot, slot]:
        assert not features[0, robot, slot].any()
        return None
    return dict(zip(PASSAGE_FEATURES, features[0, robot, slot].tolist(), strict=True))


def put(world: World, x: float, goal: float, heading: float, y: float) -> None:
    """Put robot 0 on the axis of a passage, with a goal straight ahead."""
    state = world.state
    state.robot_position[0, 0], state.robot_goal[0, 0] = (x, y), (goal, y)
    state.robot_heading[0, 0], state.robot_velocity[0] = heading, 0.0
    state.route_corner[0, state.human_radius.shape[1]] = GOAL


def test_a_robot_before_in_and_behind_a_passage() -> None:
    """Doorway and corridor are rectangles: vertices 3, 4 and 9 of the outline say which."""
    for layout in (Layout.doorway, Layout.corridor):
        world = world_of(layout, sensing_range=4.0, walls_occlude=False)
        state = world.state
        end, (low, high) = float(state.walls[0, 0, 4]), np.sort(state.walls[0, 1, [9, 3]])
        y, width = float(low + high) / 2, float(high - low)
        state.robot_position[0, 1] = (-50.0, 0.0)  # out of sight
        state.human_position[0] = [(0.5 - end, y), (-end - 2.0, y), (-end - 2.6, y), (-50.0, 0.0)]
        state.human_velocity[0] = [(-0.8, 0.0), (1.0, 0.0), (0.0, 0.0), (0.0, 0.0)]

        put(world, -end - 3.0, end + 2.0, 0.0, y)
        row = seen(world)
        expected = {"mouth_x": 3.0, "mouth_y": 0.0, "axis_x": 1.0, "axis_y": 0.0, "distance": 3.0}
        expected |= {"length": 2 * end, "width": width, "inside": 0.0}
        expected |= {"occupants": 1.0, "flow": -0.8, "people": 2.0}  # 0.5 m inside, 2 m before it
        assert row == pytest.approx(expected, abs=2e-4)
        assert seen(world, slot=1) is None

        put(world, -end - 3.0, end + 2.0, np.pi / 2, y)  # the passage is on its right
        turned = {"mouth_x": 0.0, "mouth_y": -3.0, "axis_x": 0.0, "axis_y": -1.0}
        assert seen(world) == pytest.approx(expected | turned, abs=2e-4)

        put(world, end + 3.0, -end - 2.0, np.pi, y)  # from the other side
        state.human_position[0, 0, 0] = end - 0.5
        row = seen(world)
        assert row["flow"] == pytest.approx(0.8, abs=1e-4)
        assert row["distance"] == pytest.approx(3.0, abs=1e-4)

        put(world, end - 0.25, end + 2.0, 0.0, y)  # inside: the person comes towards it
        row = seen(world)
        expected |= {"mouth_x": 0.25, "distance": 0.25, "inside": 1.0, "flow": -0.8}
        for name in ("mouth_x", "mouth_y", "axis_x", "distance", "length", "inside", "flow"):
            assert row[name] == pytest.approx(expected[name], abs=2e-4), name

        put(world, end + 0.5, end + 2.0, 0.0, y)
        assert seen(world) is None


def test_whoever_is_out_of_sight_counts_if_it_tells() -> None:
    """A robot in the middle of a corridor, of which team-mates 8 m away see nothing."""
    for team_messages in (False, True):
        world = world_of(Layout.corridor, humans=0, sensing_range=2.0, team_messages=team_messages)
        state = world.state
        end, y = float(state.walls[0, 0, 4]), float(state.walls[0, 1, [9, 3]].mean())
        put(world, -end - 3.0, end + 2.0, 0.0, y)
        state.robot_position[0, 1], state.robot_velocity[0, 1] = (0.0, y), (0.6, 0.0)
        row = seen(world)
        assert row["occupants"] == team_messages
        assert row["flow"] == pytest.approx(0.6 * team_messages, abs=1e-4)
        assert row["people"] == 0.0


def test_the_doors_of_an_office_come_in_the_order_of_the_route() -> None:
    """Shapely: at these distances along the routes are mouths that `find_passages` knows."""
    number = 16
    scenario = Scenario(
        layout=Layout.map, map=str(OFFICE), robots=2, humans=0, next_passages=2, team_messages=True
    )
    world = World(scenario, number)
    features, mask = world.reset(np.arange(number)).entities["passages"]
    state = world.state
    passages = find_passages(state.walls[0], state.place[0], sensor.open_width(0.3))
    assert mask.any((0, 1)).all()
    for e, i, slot in np.argwhere(mask):
        row = dict(zip(PASSAGE_FEATURES, features[e, i, slot].tolist(), strict=True))
        ends = state.robot_position[e, i], state.robot_goal[e, i]
        route = shapely.LineString(route_of(state, e, i, *ends))
        point = np.array(route.interpolate(row["distance"]).coords[0])
        k = np.linalg.norm(passages.mouth - point, axis=-1).argmin()
        assert np.linalg.norm(passages.mouth[k] - point) <= passages.width[k] / 2 + 1e-3
        assert row["width"] == pytest.approx(passages.width[k], abs=1e-3)
        offset = np.hypot(row["mouth_x"], row["mouth_y"])
        beeline = np.linalg.norm(passages.mouth[k] - state.robot_position[e, i])
        assert offset == pytest.approx(beeline, abs=1e-3)
        assert slot == 0 or row["distance"] > features[e, i, 0, PASSAGE_FEATURES.index("distance")]


def test_it_follows_episodes_and_changes_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """Passages are those of the present episode, and are not looked for where it is off."""
    observed = world_of(Layout.corridor, time_limit=1.0)
    again = World(observed.scenario, 1)
    again.reset([3])
    observed.reset([3])
    assert seen(observed) == seen(again)
    monkeypatch.setattr(sensor, "find_passages", None)
    without = world_of(Layout.corridor, time_limit=1.0, next_passages=0)
    without.reset([3])
    assert "passages" not in without.observe().entities
    for _ in range(4):
        steps = [world.step(np.ones((1, 2, 3))) for world in (observed, without)]
        np.testing.assert_array_equal(*(step.observation.ego for step in steps))
        np.testing.assert_array_equal(*(step.reward for step in steps))
    with pytest.raises(ConfigurationError, match=r"scenario\.next_passages is 1;.*map_known"):
        Scenario(layout=Layout.corridor, next_passages=1, map_known=False)
