"""MSA3C, Eq. 3-4: by hand, against plain Python, and that it costs nothing where it is off.

A robot at the origin that drives at 1 m/s along x is at 0.25 m after one step; discs have radius
0.3 m. So somebody who stands at x is nearer than 0.25 m, k steps later, if x < 1.1 + 0.25 k.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from staging import stage

from mrsan import Reward, Scenario, World
from mrsan.prediction import PREDICTORS, ConstantVelocity, register_predictor

COAST = [0.0, 0.0, 0.0]
DRIVER = (0, 0, 0, 1, 9, 0)
ON = Reward(lookahead=1.0)


def paid(world: World, *actions: list[float]) -> list[float]:
    step = world.step([list(actions)])
    np.testing.assert_array_equal(sum(step.reward_parts), step.reward)
    return [round(float(r), 6) for r in step.reward_parts.lookahead[0]]


def after(k: int, weight: float = 1.0) -> float:
    return round(-weight * math.exp(-k), 6)


@pytest.mark.parametrize(
    ("x", "k"), [(1.34, 1), (1.36, 2), (1.61, 3), (2.0, 4), (2.34, 5), (2.36, None), (-0.9, None)]
)
def test_the_first_intrusion_counts(x: float, k: int | None) -> None:
    expected = 0.0 if k is None else after(k)
    assert paid(stage([DRIVER], [(x, 0, 0, 0)], reward=ON), COAST) == [expected]


RANDOM = Scenario(
    robots=3,
    humans=12,
    humans_min=4,
    terminate_on_collision=False,
    human_radius_max=0.6,
    human_speed_max=1.5,
    fov_degrees=200.0,
    late_probability=0.3,
    leave_probability=0.3,
    missed_detection=0.1,
    reward=Reward(lookahead=0.7, lookahead_steps=6, lookahead_distance=0.4),
)


def oracle(state: Any, visible: np.ndarray, e: int, i: int, s: Scenario) -> tuple[float, float]:
    """Eq. 3-4 in plain Python, and by how much it is from being another."""
    r, least, sure = s.reward, 0.0, math.inf
    for j in range(s.humans):
        if not visible[e, i, j]:
            continue
        for k in range(1, r.lookahead_steps + 1):
            gap = math.dist(
                state.robot_position[e, i] + k * s.time_step * state.robot_velocity[e, i],
                state.human_position[e, j] + k * s.time_step * state.human_velocity[e, j],
            ) - float(state.human_radius[e, j] + s.robot_radius)
            sure = min(sure, abs(gap - r.lookahead_distance))
            if gap < r.lookahead_distance:
                least = min(least, -r.lookahead * math.exp(-k))
                break
    touches = state.clock[e] in state.last_contact[e, i]
    driving = not state.arrived[e, i] and not touches
    return (least if driving else 0.0), sure


def test_it_agrees_with_plain_python() -> None:
    world, rng, agreed = World(RANDOM, 40), np.random.default_rng(0), 0
    world.reset(np.arange(40))
    for _ in range(25):
        going = ~world.state.done
        step = world.step(rng.uniform(-1, 1, (40, 3, 3)))
        for e, i in np.ndindex(40, 3):
            expected, sure = oracle(world.state, step.observation.humans_visible, e, i, RANDOM)
            if going[e] and sure > 1e-4:
                assert step.reward_parts.lookahead[e, i] == pytest.approx(expected, abs=1e-6)
                agreed += expected < 0
    assert agreed > 100


RECURRENT = replace(RANDOM, reward=replace(RANDOM.reward, lookahead_predictor="recurrent"))


def played(world: World, steps: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (60, 24, 3, 3)).astype(np.float32)
    cases = world.state.case % 24
    return [world.step(action[cases]).reward for action in actions[:steps]]


def test_going_back_goes_back_in_what_is_remembered_of_people() -> None:
    world = World(RECURRENT, 24, True)
    world.reset(np.arange(24))
    played(world, 20)
    past = world.snapshot()
    first = played(world, 30)
    world.restore(past)
    np.testing.assert_array_equal(played(world, 30), first)


@register_predictor("recorder")
class Recorder(ConstantVelocity):
    """Keeps what it was asked."""

    history = 4
    asked: list[tuple[np.ndarray, np.ndarray]] = []  # noqa: RUF012 - of all that are made

    def predict(self, past: Any, known: Any, velocity: Any, steps: int) -> Any:
        self.asked.append((past.copy(), known.copy()))
        return super().predict(past, known, velocity, steps)


del PREDICTORS["recorder"]  # other tests walk the registry; here it is put back where it is needed


def test_a_predictor_of_ones_own_is_asked_with_the_last_positions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(PREDICTORS, "recorder", Recorder)
    reward = Reward(lookahead=1.0, lookahead_predictor="recorder")
    world = World(Scenario(time_limit=2.0, robots=1, reward=reward), 3, auto_reset=True)
    world.reset(np.arange(3))
    places, Recorder.asked[:] = [world.state.human_position.copy()], []
    for t in range(1, 8):
        world.step(np.zeros((3, 1, 3)))
        places.append(world.state.human_position.copy())
        past, known = Recorder.asked[-1]
        there = min(t + 1, 4)
        assert known[..., -there:].all()
        assert not known[..., :-there].any()
        expected = np.stack(places[-there:], 2)
        np.testing.assert_array_equal(past[:, :, -there:], expected)
    world.step(np.zeros((3, 1, 3)))  # the time is up: the next episode began
    assert world.state.human_past_valid.sum(-1).tolist() == [[1] * 10] * 3
