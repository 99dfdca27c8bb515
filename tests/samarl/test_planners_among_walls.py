"""Planners and the shield drive one robot through places with walls, without people."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from mrsan import Observation, Outcome, Scenario, Split
from samarl.agents import Agent, build_agent
from samarl.agents.planners.straight import drive_towards
from samarl.agents.shielded import Shielded
from samarl.configuration import load_method_config
from samarl.evaluation.runner import run_cases
from samarl.observations.route import next_point
from samarl.planning.shield import Shield

PLANNERS = ["orca", "model_predictive", "model_predictive shield=true"]


@dataclass
class AlongRoute(Agent):
    """Drives at full speed towards the next corner of its route, and ignores walls."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        return drive_towards(observation, next_point(observation), self.scenario)


def outcomes(agent: Agent, cases: int) -> NDArray[np.int8]:
    numbers = Split.test.case(0) + np.arange(cases)
    return run_cases(agent, agent.scenario, numbers, batch=cases).outcome[:, 0]


@pytest.mark.parametrize("layout", ["doorway", "pillars"])
@pytest.mark.parametrize("name", PLANNERS)
def test_a_planner_arrives_and_hits_no_wall(name: str, layout: str) -> None:
    scenario = Scenario(layout=layout, robots=1, humans=0)
    outcome = outcomes(build_agent(load_method_config(name), scenario), 20)
    assert (outcome == Outcome.arrived).sum() >= 19
    assert not (outcome == Outcome.hit_wall).any()


@pytest.mark.parametrize("layout", ["doorway", "pillars"])
def test_the_shield_keeps_a_robot_that_ignores_walls_clear_of_them(layout: str) -> None:
    agent = AlongRoute(Scenario(layout=layout, robots=1, humans=0))
    blind = outcomes(agent, 100)
    safe = outcomes(Shielded(agent.scenario, agent, Shield()), 100)
    assert (blind == Outcome.hit_wall).sum() >= 4
    assert not (safe == Outcome.hit_wall).any()
    assert (safe == Outcome.arrived).sum() >= 98
