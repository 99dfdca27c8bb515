"""What robots tell each other."""

from dataclasses import replace

import numpy as np
import pytest

from mrsan import Layout, Observation, Scenario, TeamPerception, World

NARROW = Scenario(fov_degrees=90.0, robots=4, humans=12)
ROOMS = Scenario(fov_degrees=360.0, robots=4, humans=12, layout=Layout.rooms)  # walls hide people
STEPS = 30


def team(scenario: Scenario = NARROW, **changes: object) -> Scenario:
    return replace(scenario, team_perception=TeamPerception.tracks, **changes)  # type: ignore[arg-type]


def played(scenario: Scenario, worlds: int = 16) -> list[tuple[Observation, World]]:
    """What is observed on the way, with the worlds as they were then."""
    world = World(scenario, worlds)
    rng = np.random.default_rng(3)
    frames = []
    observation = world.reset(np.arange(worlds))
    for _ in range(STEPS):
        then = World(scenario, worlds)
        then.restore(world.snapshot())
        frames.append((observation, then))
        action = rng.uniform(-1, 1, (worlds, scenario.robots, 3)).astype(np.float32)
        action[..., 0] = 0.5
        observation = world.step(action).observation
    return frames


def in_world(observation: Observation, world: World, kind: str) -> np.ndarray:
    """Positions and velocities that robots know of others, in the world frame, [E, N, K, 4]."""
    seen, state = getattr(observation, kind), world.state
    cos, sin = np.cos(state.robot_heading)[..., None], np.sin(state.robot_heading)[..., None]
    parts = []
    for own, pair in (
        (state.robot_position, seen[..., :2]),
        (state.robot_velocity, seen[..., 2:4]),
    ):
        x, y = pair[..., 0], pair[..., 1]
        parts.append(np.stack([cos * x - sin * y, sin * x + cos * y], -1) + own[:, :, None])
    return np.concatenate(parts, -1)


@pytest.mark.parametrize("scenario", [NARROW, ROOMS], ids=["narrow_view", "walls"])
def test_a_robot_knows_who_any_in_reach_sees_and_where_they_are(scenario: Scenario) -> None:
    heard = 0
    for (observation, then), (alone, _) in zip(
        played(team(scenario)), played(scenario), strict=True
    ):
        n = scenario.robots
        anybody = alone.humans_visible.any(1, keepdims=True)
        np.testing.assert_array_equal(observation.humans_visible, anybody.repeat(n, 1))
        np.testing.assert_array_equal(observation.humans_reported, anybody & ~alone.humans_visible)
        assert observation.robots_visible.all()
        np.testing.assert_array_equal(observation.robots_reported, ~alone.robots_visible)
        there = np.concatenate([then.state.human_position, then.state.human_velocity], -1)
        known = in_world(observation, then, "humans")
        rows = observation.humans_reported
        heard += rows.sum()
        true = np.broadcast_to(there[:, None], known.shape)
        np.testing.assert_allclose(known[rows], true[rows], atol=2e-5)
        others = [[k for k in range(n) if k != i] for i in range(n)]
        poses = np.concatenate([then.state.robot_position, then.state.robot_velocity], -1)
        np.testing.assert_allclose(
            in_world(observation, then, "robots"), poses[:, others], atol=2e-5
        )
        assert (observation.humans[rows][:, 4] == np.float32(0.3)).all()
    assert heard > 1000


@pytest.mark.parametrize(
    "scenario",
    [
        team(team_range=0.0),
        team(team_loss=1.0),
        team(team_delay=10.0),
        team(replace(NARROW, fov_degrees=360.0), sensing_range=100.0, position_noise=0.1),
    ],
    ids=["out of reach", "lost", "not yet there", "seen anyway"],
)
def test_what_nobody_tells_changes_no_bit(scenario: Scenario) -> None:
    without = replace(scenario, team_perception=TeamPerception.none)
    for (observation, _), (alone, _) in zip(played(scenario), played(without), strict=True):
        assert not observation.humans_reported.any()
        assert not observation.robots_reported.any()
        for array, theirs in zip(observation.agents, alone.agents, strict=True):
            np.testing.assert_array_equal(array, theirs)


def test_out_of_reach_is_measured_between_the_robots() -> None:
    scenarios = dict(
        zip(("far", "near"), (team(team_range=30.0), team(team_range=5.0)), strict=True)
    )
    near = fewer = 0
    for (far, then), (close, _) in zip(
        played(scenarios["far"]), played(scenarios["near"]), strict=True
    ):
        position = then.state.robot_position
        apart = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
        reach = (apart <= 5.0) & ~np.eye(NARROW.robots, dtype=bool)
        own = far.humans_visible & ~far.humans_reported
        expected = (reach[..., None] & own[:, None]).any(2) & ~own
        np.testing.assert_array_equal(close.humans_reported, expected)
        near, fewer = near + close.humans_reported.sum(), fewer + far.humans_reported.sum()
    assert 0 < near < fewer


def test_a_delayed_track_is_moved_on() -> None:
    delayed = team(team_delay=0.75)
    frames, alone = played(delayed), played(NARROW)
    for t, (observation, _) in enumerate(frames):
        if t < 3:
            assert not observation.humans_reported.any()
            continue
        before, then = alone[t - 3]
        seen = before.humans_visible
        others = seen.sum(1, keepdims=True) > seen  # somebody else saw it
        own = alone[t][0].humans_visible
        going = frames[t][1].state.clock == t  # the clock of a world that has ended stands still
        np.testing.assert_array_equal(observation.humans_reported[going], (others & ~own)[going])
        s = then.state
        expected = s.human_position + 0.75 * s.human_velocity
        known = in_world(observation, frames[t][1], "humans")[..., :2]
        rows = observation.humans_reported & going[:, None, None]
        true = np.broadcast_to(expected[:, None], known.shape)
        np.testing.assert_allclose(known[rows], true[rows], atol=2e-5)


def test_a_restored_world_says_the_same_again() -> None:
    scenario = team(team_delay=0.5)
    world = World(scenario, 4)
    world.reset(np.arange(4))
    for _ in range(10):
        observation = world.step(np.full((4, 4, 3), 0.3, np.float32)).observation
    other = World(scenario, 4)
    other.restore(world.snapshot())
    for array, theirs in zip(
        other.observe().arrays().values(), observation.arrays().values(), strict=True
    ):
        np.testing.assert_array_equal(array, theirs)
