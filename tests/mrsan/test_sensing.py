"""Fields of view, noise and missed detections."""

import math

import numpy as np
import pytest
from staging import stage

from mrsan import EGO_FEATURES, Crowd, Scenario, World

WORLDS = 4000
FIVE_SIGMA = 5.0


@pytest.mark.parametrize("heading", [0.0, 1.3, math.pi, -2.9])
@pytest.mark.parametrize("fov_degrees", [1.0, 90.0, 180.0, 270.0, 360.0])
def test_the_field_of_view_ends_at_its_half_angle(fov_degrees: float, heading: float) -> None:
    half = fov_degrees / 2
    inside = [0, half - 0.1, -half + 0.1] if half < 180 else [0, 90, 179.99, 180, -179.99]
    outside = [half + 0.1, -half - 0.1, 180] if half < 180 else []
    for bearing in inside + outside:
        angle = heading + math.radians(bearing)
        place = (1 + 3 * math.cos(angle), 2 + 3 * math.sin(angle))
        world = stage(
            [(1, 2, heading, 0, 9, 9), (*place, 0, 0, 9, -9)],
            [(*place, 0, 0)],
            fov_degrees=fov_degrees,
        )
        seen = world.observe()
        assert bool(seen.humans_visible[0, 0, 0]) is (bearing in inside)
        assert bool(seen.robots_visible[0, 0, 0]) is (bearing in inside)
        if bearing in inside:
            ahead = 3 * math.cos(math.radians(bearing)), 3 * math.sin(math.radians(bearing))
            np.testing.assert_allclose(seen.humans[0, 0, 0, :2], ahead, atol=1e-5)
            np.testing.assert_allclose(seen.robots[0, 0, 0, :2], ahead, atol=1e-5)
        else:
            assert not seen.humans[0, 0].any()
            assert not seen.robots[0, 0].any()


def test_an_observation_by_hand() -> None:
    """A robot at (1, 2) that faces north: north is ahead, west is to the left."""
    world = stage([(1, 2, math.pi / 2, 0.5, 1, 5), (-1, 2, 0, 1, 9, 9)], [(2, 4, -1, 0)], clock=50)
    seen = world.observe()
    ego = dict(zip(EGO_FEATURES, seen.ego[0, 0].tolist(), strict=True))
    expected = {
        "goal_x": 3,
        "goal_y": 0,
        "velocity_x": 0.5,
        "velocity_y": 0,
        "origin_x": -2,
        "origin_y": 1,
        "heading_cos": 0,
        "heading_sin": 1,
        "radius": 0.3,
        "preferred_speed": 1,
        "time": 0.25,
    }
    assert ego == pytest.approx(expected, abs=1e-6)
    # Two ahead, one to the right; walks west, while the robot drives ahead at 0.5.
    np.testing.assert_allclose(seen.humans[0, 0, 0], [2, -1, -0.5, 1, 0.3], atol=1e-6)
    # Two to the left; drives east.
    np.testing.assert_allclose(seen.robots[0, 0, 0], [0, 2, -0.5, -1, 0.3], atol=1e-6)


def observed(**noise: float) -> World:
    scenario = Scenario(robots=1, humans=2, crowd=Crowd.still, **noise)
    world = World(scenario, WORLDS)
    world.reset(np.arange(WORLDS))
    return world


def errors(**noise: float) -> np.ndarray:
    """Deviations of what is observed of human 0, [WORLDS, 5]."""
    exact, noisy = observed().observe(), observed(**noise).observe()
    both = exact.humans_visible[:, 0, 0] & noisy.humans_visible[:, 0, 0]
    np.testing.assert_array_equal(exact.ego, noisy.ego)  # a robot knows itself exactly
    return (noisy.humans - exact.humans)[both, 0, 0]


def test_noise_has_the_stated_spread_in_each_direction_alone() -> None:
    error = errors(position_noise=0.1, velocity_noise=0.3)
    n = len(error)
    assert n > 0.5 * WORLDS
    sigma = np.array([0.1, 0.1, 0.3, 0.3])
    assert (error[:, 4] == 0).all()
    assert (np.abs(error[:, :4].mean(0)) < FIVE_SIGMA * sigma / np.sqrt(n)).all()
    np.testing.assert_allclose(error[:, :4].std(0), sigma, rtol=FIVE_SIGMA / np.sqrt(2 * n))
    correlation = np.corrcoef(error[:, :4].T) - np.eye(4)
    assert np.abs(correlation).max() < FIVE_SIGMA / np.sqrt(n)
    inside = (np.abs(error[:, :4]) < sigma).mean(0)  # of a normal distribution: 68.27 %
    np.testing.assert_allclose(inside, 0.6827, atol=FIVE_SIGMA * 0.466 / np.sqrt(n))


def test_noise_of_the_radius_is_of_people_and_drawn_anew_at_every_step() -> None:
    """The radius itself stays what it is, and that of robots is known."""
    error = errors(radius_noise=0.05)
    n = len(error)
    assert (error[:, :4] == 0).all()
    assert abs(error[:, 4].mean()) < FIVE_SIGMA * 0.05 / np.sqrt(n)
    assert error[:, 4].std() == pytest.approx(0.05, rel=FIVE_SIGMA / np.sqrt(2 * n))
    world = World(Scenario(robots=2, humans=1, crowd=Crowd.still, radius_noise=0.05), WORLDS)
    world.reset(np.arange(WORLDS))
    first = world.observe()
    world.state.clock[:] += 1
    later = world.observe()
    both = first.humans_visible[:, 0, 0] & first.humans_visible[:, 1, 0]
    seen = [of.humans[both, i, 0, 4] for of in (first, later) for i in range(2)]
    assert np.abs(np.corrcoef(seen) - np.eye(4)).max() < FIVE_SIGMA / np.sqrt(both.sum())
    assert (first.robots[first.robots_visible][:, 4] == np.float32(0.3)).all()
    assert (world.state.human_radius == np.float32(0.3)).all()
    assert (world.observe(privileged=True).humans[..., 4] == np.float32(0.3)).all()


def test_detections_are_missed_with_the_stated_probability_at_every_step_anew() -> None:
    world = observed(missed_detection=0.3)
    exact = observed()
    there = exact.observe().humans_visible[:, 0]
    first = world.observe()
    missed = ~first.humans_visible[:, 0]
    assert not first.humans[:, 0][missed].any()  # and nothing is told of who was missed
    world.state.clock[:] += 1
    later = ~world.observe().humans_visible[:, 0]
    share, n = missed[there].mean(), there.sum()
    assert share == pytest.approx(0.3, abs=FIVE_SIGMA * np.sqrt(0.21 / n))
    both = (missed & later)[there].mean()
    assert both == pytest.approx(0.09, abs=FIVE_SIGMA * np.sqrt(0.09 * 0.91 / n))
