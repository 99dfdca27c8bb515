"""The closest human of an episode against plain NumPy over the states round each step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mrsan import Crowd, Outcome, Scenario, World
from mrsan.metrics import episodes_of
from mrsan.recording import load_recording

CASES = np.arange(40)
CROWDS: dict[str, dict[str, Any]] = {
    "circle": {},
    "people who come and go": {"late_probability": 0.5, "leave_probability": 1.0},
    "recorded": {"crowd": Crowd.recorded, "humans": 64},
    "recorded, with few slots": {
        "crowd": Crowd.recorded,
        "humans": 4,
        "robots": 1,
        "terminate_on_collision": False,
    },
}


def positions_before(world: World) -> np.ndarray:
    """Where whoever is in a slot now was before the step that has just been taken, [E, M, 2].

    People who came in with this step were not in their slots yet; the recording says where they
    were. Other people come in where their slots have been since the reset.
    """
    state, scenario = world.state, world.scenario
    way = load_recording(scenario.recording, scenario.frame_seconds, scenario.time_step)
    track = state.human_track
    row = way.row[track] - way.first[track] + (state.record_step + state.clock - 1)[:, None]
    return way.position[np.where(state.human_present, row, 0)].astype(np.float64)


def swept_distance(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Smallest norm of relative positions [..., 2] that move straight from one to the other."""
    way = after - before
    length_squared = np.square(way).sum(-1)
    share = -(before * way).sum(-1) / np.where(length_squared > 0, length_squared, 1.0)
    return np.linalg.norm(before + np.clip(share, 0.0, 1.0)[..., None] * way, axis=-1)


def drive(scenario: Scenario) -> tuple[World, np.ndarray, np.ndarray]:
    """Robots that drive straight ahead until every episode has ended.

    Returns:
        The world, and the closest approach of each robot to a human, [E, N]: at any moment of its
        steps, and at their ends alone.
    """
    world = World(scenario, len(CASES))
    world.reset(CASES)
    state = world.state
    ahead = np.zeros((len(CASES), scenario.robots, scenario.action_size), np.float32)
    ahead[..., 0] = 1.0
    within_steps = np.full((len(CASES), scenario.robots), np.inf)
    at_step_ends = within_steps.copy()
    while not state.done.all():
        driving = ~state.arrived & ~state.done[:, None]
        robots, humans = (
            position.astype(np.float64) for position in (state.robot_position, state.human_position)
        )
        world.step(ahead)
        if scenario.crowd == Crowd.recorded:
            humans = positions_before(world)
        before = humans[:, None] - robots[:, :, None]  # [E, N, M, 2]
        after = (state.human_position[:, None] - state.robot_position[:, :, None]).astype(float)
        reach = (state.human_radius + scenario.robot_radius)[:, None]
        counts = driving[..., None] & state.human_present[:, None]
        for closest, distance in (
            (within_steps, swept_distance(before, after)),
            (at_step_ends, np.linalg.norm(after, axis=-1)),
        ):
            gap = np.where(counts, distance - reach, np.inf).min(-1)
            np.minimum(closest, gap, out=closest)
    return world, within_steps, at_step_ends


@pytest.mark.parametrize("crowd", CROWDS)
def test_it_is_the_closest_approach_at_any_moment_of_a_step(crowd: str) -> None:
    world, within_steps, at_step_ends = drive(Scenario(**CROWDS[crowd]))
    episodes = episodes_of(world.state, world.scenario, np.ones(len(CASES), np.bool_))
    np.testing.assert_allclose(episodes.closest_human, within_steps, rtol=0, atol=2e-5)
    assert (at_step_ends - within_steps).max() > 1e-3  # so the moments in between matter
    clear = np.abs(within_steps) > 1e-4
    hit = episodes.outcome == Outcome.hit_human
    np.testing.assert_array_equal(hit[clear], (within_steps < 0)[clear])
    assert hit.any()
