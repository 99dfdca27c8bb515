"""Every case is run once, in order, for any batch size."""

from dataclasses import dataclass

import numpy as np
import pytest

from mrsan import Observation, Scenario, Split
from samarl.agents import Agent
from samarl.agents.planners.straight import Straight
from samarl.evaluation.runner import run_cases
from samarl.evaluation.trajectory import record_episode

SCENARIO = Scenario(robots=2, humans=6, humans_min=0, missed_detection=0.1)
CASES = Split.test.case(5) + np.random.default_rng(0).permutation(50)


@pytest.fixture(scope="module")
def alone():
    """Every case in a world of its own."""
    return run_cases(Straight(SCENARIO), SCENARIO, CASES, batch=1)


@pytest.mark.parametrize("batch", [2, 7, 49, 50, 1000])
def test_the_records_do_not_depend_on_the_batch(alone, batch: int) -> None:
    together = run_cases(Straight(SCENARIO), SCENARIO, CASES, batch)
    for name in alone._fields:
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name), err_msg=name)


@dataclass
class Counting(Agent):
    """Remembers how many steps its episodes last, as an agent with a memory would."""

    def __post_init__(self) -> None:
        self.begun = 0
        self.steps = np.zeros(0, int)
        self.clock = np.zeros(0)

    def reset(self, worlds: np.ndarray) -> None:
        if len(self.steps) != len(worlds):
            self.steps, self.clock = np.zeros(len(worlds), int), np.zeros(len(worlds))
        self.steps[worlds] = 0
        self.clock[worlds] = -1
        self.begun += int(worlds.sum())

    def act(self, observation: Observation) -> np.ndarray:
        clock = observation.ego[:, 0, 10].astype(float) * self.scenario.time_limit_steps
        goes_on = clock != self.clock  # the others have ended and wait for the rest
        np.testing.assert_allclose(clock[goes_on], self.steps[goes_on], atol=1e-4)
        self.steps += 1
        self.clock = clock
        return Straight(self.scenario).act(observation)


def test_memories_are_reset_with_their_episodes() -> None:
    scenario = Scenario(robots=1, humans=0, spawn_jitter=1.0)
    agent = Counting(scenario)
    episodes = run_cases(agent, scenario, np.arange(30), batch=4)
    assert episodes.success.all()
    assert len(np.unique(episodes.duration)) > 5
    assert agent.begun == 30
    agent = Counting(Scenario(robots=1, humans=0, time_limit=2.0))
    assert run_cases(agent, agent.scenario, np.arange(12), batch=4).timeout.all()
    assert agent.begun == 12


def test_a_trajectory_is_that_of_the_evaluated_case(alone) -> None:
    case = int(CASES[3])
    trajectory = record_episode(Straight(SCENARIO), SCENARIO, case)
    steps = round(float(alone.duration[3]) / SCENARIO.time_step)
    assert trajectory.robot_position.shape == (steps + 1, 2, 2)
    assert trajectory.episodes.outcome[0].tolist() == alone.outcome[3].tolist()
    driven = np.linalg.norm(np.diff(trajectory.robot_position, axis=0), axis=-1)
    moving = trajectory.driving[:-1]
    np.testing.assert_allclose((driven * moving).sum(0), alone.path_length[3], atol=1e-4)
