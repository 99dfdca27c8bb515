"""Where episodes begin and where people want to go next."""

import numpy as np
import pytest
from numba import njit

from mrsan import Scenario, World
from mrsan.kernels import layout
from mrsan.parameters import kernel_parameters

CLEARANCE = 0.4
FIVE_SIGMA = 5.0


def begun(worlds: int, **fields) -> World:
    world = World(Scenario(**fields), worlds)
    world.reset(np.arange(worlds))
    return world


def smallest_clearance(a, b, radius_a, radius_b) -> float:
    """Surface distance of the nearest two of the discs `a` and `b`, each [K, 2]."""
    distance = np.linalg.norm(a[:, None] - b[None], axis=-1).astype(float)
    distance -= np.asarray(radius_a)[:, None] + np.asarray(radius_b)[None]
    if a is b:
        np.fill_diagonal(distance, np.inf)
    return distance.min(initial=np.inf)


@pytest.mark.parametrize("robots", [1, 3, 16])
@pytest.mark.parametrize("humans", [0, 10, 64])
def test_starts_keep_their_clearances(robots: int, humans: int) -> None:
    world = begun(
        30,
        robots=robots,
        humans=humans,
        human_radius_max=0.5,
        human_speed_min=0.5,
        human_speed_max=1.5,
    )
    s = world.state
    assert s.human_present.all()
    r = np.full(robots, 0.3)
    for e in range(30):
        start, goal, people, h = (
            s.robot_position[e],
            s.robot_goal[e],
            s.human_position[e],
            s.human_radius[e],
        )
        pairs = [(start, start, r, r), (goal, goal, r, r), (start, people, r, h)]
        pairs += [(people, people, h, h)]
        assert min(smallest_clearance(*pair) for pair in pairs) >= CLEARANCE - 1e-5
        for i in range(robots):
            others = np.arange(robots) != i
            gap = smallest_clearance(start[i : i + 1], goal[others], r[:1], r[others])
            assert gap >= CLEARANCE - 1e-5
    # Start and goal are opposite points, each coordinate of both jittered by 0.5 (times the speed).
    assert np.abs(s.robot_position + s.robot_goal).max() <= 1 + 1e-5
    people = np.abs(s.human_position + s.human_goal)
    assert (people <= s.human_speed[..., None] + 1e-5).all()
    assert not s.robot_velocity.any()
    assert not s.human_velocity.any()
    way = s.robot_goal - s.robot_position
    np.testing.assert_allclose(s.robot_heading, np.arctan2(way[..., 1], way[..., 0]), atol=1e-5)
    world.step(np.zeros((30, robots, 3)))
    assert np.isfinite(s.human_position).all()


def test_starts_lie_on_the_circle_in_every_direction() -> None:
    world = begun(3000, robots=1, humans=2, spawn_jitter=0.0)
    for start in (world.state.robot_position[:, 0], world.state.human_position[:, 1]):
        np.testing.assert_allclose(np.hypot(*start.T), 5, rtol=1e-5)
        assert np.abs(start.mean(0)).max() < FIVE_SIGMA * 5 / np.sqrt(2 * 3000)
    jittered = begun(3000, robots=1, humans=0).state
    sum_of_two = jittered.robot_position + jittered.robot_goal  # of U(-0.5, 0.5): variance 1/6
    np.testing.assert_allclose(sum_of_two.std((0, 1)), np.sqrt(1 / 6), rtol=0.05)


def test_the_number_of_people_is_uniform_from_humans_min() -> None:
    present = begun(6000, humans=5, humans_min=2).state.human_present
    count = present.sum(1)
    assert (present == (np.arange(5) < count[:, None])).all()  # the first slots
    assert set(count.tolist()) == {2, 3, 4, 5}
    spread = FIVE_SIGMA * np.sqrt(6000 * 0.25 * 0.75)
    assert (np.abs(np.bincount(count)[2:] - 1500) < spread).all()


@pytest.mark.parametrize("probability", [0.0, 0.25, 0.5, 1.0])
def test_goals_change_at_the_interval_with_the_stated_probability(probability: float) -> None:
    """Every second, that is before steps 5, 9, 13, ... when time is 0.25 s."""
    world = begun(
        400,
        robots=1,
        humans=5,
        goal_change_interval=1.0,
        goal_change_probability=probability,
        neighbor_distance=0.1,
    )
    s = world.state
    s.robot_position[:] = 100.0  # out of the way
    trials = changes = 0
    for clock in range(13):
        goal, here = s.human_goal.copy(), s.human_position.copy()
        reached = np.linalg.norm(goal - here, axis=-1) < s.human_radius
        world.step(np.zeros((400, 1, 3)))
        changed = (s.human_goal != goal).any(-1)
        assert changed[reached].all()
        far = np.linalg.norm(s.human_goal - here, axis=-1)[changed]
        assert (far >= 4 - 1e-4).all()
        on_circle = np.linalg.norm(s.human_goal[changed], axis=-1)
        assert (np.abs(on_circle - 5) <= 0.5 * np.sqrt(2) + 1e-4).all()
        if clock > 0 and clock % 4 == 0:
            trials += int((~reached).sum())
            changes += int(changed[~reached].sum())
        else:
            assert not changed[~reached].any()
    spread = FIVE_SIGMA * np.sqrt(probability * (1 - probability) / trials)
    assert trials > 5000
    assert abs(changes / trials - probability) <= spread


@njit
def largest_error(key, attempts, speed, p):
    """How far a guessed start lies from the one that is drawn, at most, m."""
    place, guessed, largest = np.empty(2, np.float32), np.empty(2, np.float32), 0.0
    for attempt in range(attempts):
        layout.draw_human_start(place, key, 0, 3, attempt, speed, layout.CIRCLE, p)
        layout.approximate_human_start(guessed, key, 3, attempt, speed, p)
        largest = max(largest, abs(place[0] - guessed[0]), abs(place[1] - guessed[1]))
    return largest


def test_a_guessed_start_is_the_one_that_is_drawn() -> None:
    """Within less than the map of free places (out to 12.8 m) allows for: it changes no start."""
    p = kernel_parameters(Scenario(circle_radius=10.0))
    assert largest_error(np.uint64(12345), 640, np.float32(1.3), p) < 1e-4
