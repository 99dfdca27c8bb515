"""Other places than the circle, and what people do besides walking to their goals."""

import numpy as np
import pytest

from mrsan import Layout, Scenario, World

WORLDS = 300
OPEN = [Layout.circle, Layout.crossing, Layout.opposite, Layout.square]
LATER = [Layout.crossing, Layout.opposite, Layout.square]


def begun(worlds: int = WORLDS, **fields) -> World:
    world = World(Scenario(**fields), worlds)
    world.reset(np.arange(worlds))
    return world


def rest(world: World) -> np.ndarray:
    """Actions that leave the robots where they are."""
    return np.zeros((world.worlds, world.scenario.robots, 3), np.float32)


def far_away(world: World) -> World:
    """Robots that are in nobody's way."""
    world.state.robot_position[:] += 1000.0
    world.state.robot_goal[:] += 2000.0
    return world


def turned(points: np.ndarray, degrees: np.ndarray | float) -> np.ndarray:
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], -1)


@pytest.mark.parametrize("degrees", [-60.0, 30.0, 180.0])
def test_the_goals_of_robots_are_turned_about_the_middle(degrees: float) -> None:
    """One robot: with several a start may be drawn again, as they keep clear of the goals."""
    straight, world = begun(robots=1).state, begun(robots=1, goal_turn_degrees=degrees).state
    np.testing.assert_array_equal(world.robot_start, straight.robot_start)
    expected = turned(straight.robot_goal.astype(float), degrees)
    np.testing.assert_allclose(world.robot_goal, expected, atol=1e-5)
    np.testing.assert_array_equal(world.human_goal, straight.human_goal)
    way = world.robot_goal - world.robot_start
    np.testing.assert_allclose(world.robot_heading, np.arctan2(way[..., 1], way[..., 0]), atol=1e-5)


@pytest.mark.parametrize("layout", LATER)
def test_robots_start_and_go_anywhere_on_the_floor(layout: Layout) -> None:
    s = begun(
        1000, robots=4, humans=3, layout=layout, route_length_min=5.0, route_length_max=9.0
    ).state
    for place in (s.robot_start, s.robot_goal):
        assert np.abs(place).max() <= 7.0
        assert np.abs(place).max() > 6.9
        # Anywhere: as often in each quarter, but for chance.
        quarter = (place[..., 0] > 0) * 2 + (place[..., 1] > 0)
        assert np.abs(np.bincount(quarter.ravel()) / quarter.size - 0.25).max() < 0.05
    way = np.linalg.norm(s.robot_goal - s.robot_start, axis=-1)
    assert way.min() >= 5.0
    assert way.max() <= 9.0


@pytest.mark.parametrize("layout", OPEN)
def test_nobody_starts_too_near_to_another(layout: Layout) -> None:
    fields = {"robots": 6, "humans": 30, "human_radius_max": 0.5}
    s = begun(50, layout=layout, pair_probability=0.3, late_probability=0.3, **fields).state
    place = np.concatenate([s.robot_position, s.human_position], 1)
    radius = np.concatenate([np.full((50, 6), 0.3), s.human_radius], 1)
    gap = np.linalg.norm(place[:, :, None] - place[:, None], axis=-1)
    gap -= radius[:, :, None] + radius[:, None]
    gap[:, np.arange(36), np.arange(36)] = np.inf
    paired = np.zeros((36, 36), bool)
    evens = np.arange(6, 36, 2)
    paired[evens, evens + 1] = paired[evens + 1, evens] = True
    assert gap[:, ~paired].min() >= 0.4 - 1e-5
    assert gap[:, paired].min() == pytest.approx(0.2, abs=1e-5)


@pytest.mark.parametrize(("layout", "width"), [(Layout.crossing, 8.0), (Layout.opposite, 6.0)])
def test_people_walk_in_streams(layout: Layout, width: float) -> None:
    """To an end of the stream, and from there to the other; never out of it."""
    world = far_away(begun(humans=4, layout=layout))
    s = world.state
    goal = s.human_goal.copy()
    along = np.abs(goal).argmax(-1)  # the ends are at 7 m
    np.testing.assert_allclose(np.abs(goal).max(-1), 7.0)
    assert np.abs(goal).min(-1).max() <= width / 2
    across = np.take_along_axis(s.human_position, 1 - along[..., None], -1)
    assert np.abs(across).max() <= width / 2
    assert np.abs(across).max() > width / 2 - 0.1
    assert along.mean() == pytest.approx(0.5 if layout is Layout.crossing else 0.0, abs=0.08)
    end = np.take_along_axis(goal, along[..., None], -1)
    assert (end > 0).mean() == pytest.approx(0.5, abs=0.08)
    for _ in range(60):
        reached = np.linalg.norm(s.human_goal - s.human_position, axis=-1) < s.human_radius
        before = s.human_goal.copy()
        world.step(rest(world))
        now = np.take_along_axis(s.human_goal, along[..., None], -1)[..., 0]
        old = np.take_along_axis(before, along[..., None], -1)[..., 0]
        np.testing.assert_allclose(np.abs(now), 7.0)
        assert (now[reached] == -old[reached]).all()


def test_mixed_is_each_of_the_layouts_as_often() -> None:
    mixed = begun(1000, humans=5, layout=Layout.mixed).state
    matches = np.zeros(1000, int)
    for layout in OPEN:
        one = begun(1000, humans=5, layout=layout).state
        same = (mixed.human_position == one.human_position).all((1, 2))
        same &= (mixed.robot_goal == one.robot_goal).all((1, 2))
        assert same.mean() == pytest.approx(0.25, abs=0.07)
        matches += same
    assert (matches == 1).all()


def test_people_stand_for_whole_intervals() -> None:
    """Every 5 s: 20 steps."""
    world = far_away(begun(1000, humans=1, stand_probability=0.3))
    standing = []
    for _ in range(60):
        world.step(rest(world))
        standing.append(~world.state.human_velocity.any(-1))
    standing = np.array(standing).reshape(3, 20, 1000)
    assert (standing == standing[:, :1]).all()
    assert standing[:, 0].mean() == pytest.approx(0.3, abs=0.05)
    assert abs(np.corrcoef(standing[:2, 0].reshape(2, -1))[0, 1]) < 0.1


def test_pairs_walk_side_by_side_to_the_same_place() -> None:
    world = far_away(begun(humans=2, pair_probability=1.0, human_speed_min=0.5))
    s = world.state
    np.testing.assert_array_equal(s.human_speed[:, 0], s.human_speed[:, 1])
    offset = s.human_position[:, 1] - s.human_position[:, 0]
    for _ in range(100):
        np.testing.assert_allclose(s.human_goal[:, 1] - s.human_goal[:, 0], offset, atol=1e-4)
        world.step(rest(world))
    apart = np.linalg.norm(s.human_position[:, 1] - s.human_position[:, 0], axis=-1)
    assert np.median(apart) < 2.0


def test_who_comes_later_is_nowhere_until_then() -> None:
    world = far_away(begun(humans=6, late_probability=0.5, late_time=10.0))
    s = world.state
    entry = s.human_entry.copy()
    late = entry > 0
    assert late.mean() == pytest.approx(0.5, abs=0.05)
    assert entry[late].min() == 1
    assert entry[late].max() == 40
    assert (s.human_present == ~late).all()
    place = s.human_position.copy()
    for clock in range(45):
        world.step(rest(world))
        assert not s.human_present[entry > clock].any()
        waiting = ~s.human_present
        np.testing.assert_array_equal(s.human_position[waiting], place[waiting])
    assert s.human_present.mean() > 0.95  # where there was room


def test_who_leaves_at_its_goal_does_not_come_back() -> None:
    world = far_away(begun(humans=4, leave_probability=1.0, goal_change_probability=0.0))
    s = world.state
    gone = np.zeros_like(s.human_present)
    for _ in range(80):
        reached = np.linalg.norm(s.human_goal - s.human_position, axis=-1) < s.human_radius
        reached &= s.human_present
        world.step(rest(world))
        gone |= reached
        np.testing.assert_array_equal(s.human_present, ~gone)
    assert gone.mean() > 0.9
    assert (s.human_entry[gone] == -1).all()


@pytest.mark.parametrize("layout", [*OPEN, Layout.mixed])
def test_an_episode_does_not_depend_on_the_batch(layout: Layout) -> None:
    habits = {
        "stand_probability": 0.2,
        "hurry_probability": 0.2,
        "pair_probability": 0.4,
        "late_probability": 0.3,
        "leave_probability": 0.5,
        "goal_rotation_range_degrees": 60.0,
    }
    many, one = (World(Scenario(layout=layout, **habits), worlds) for worlds in (9, 1))
    many.reset(np.arange(9))
    one.reset([7])
    for _ in range(100):
        for world in (many, one):
            world.step(rest(world))
        for name in many.state._fields:
            np.testing.assert_array_equal(getattr(many.state, name)[7], getattr(one.state, name)[0])
