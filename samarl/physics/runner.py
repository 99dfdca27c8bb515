"""Evaluation of one agent on fixed cases in MuJoCo."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Observation
from samarl.agents import Agent
from samarl.physics.controllers import Controller, controller_of
from samarl.physics.engine import MujocoEngine
from samarl.physics.world import PhysicsWorld


class PhysicsRun(NamedTuple):
    """The records of B cases, and how well robots followed their commands."""

    episodes: Episodes
    # Between where a command leads in `mrsan` and where the robot is after the decision, m: mean
    # over all decisions of robots that drive.
    tracking_error: float


def run_physics_cases(
    agent: Agent,
    engine: MujocoEngine,
    cases: NDArray[np.int64],
    name: str,
    advance: Callable[[int], Any] | None = None,
) -> PhysicsRun:
    """Run every case in MuJoCo and return its record, in the order of `cases`.

    Args:
        agent: the controller of all robots, built for the scenario; a policy is exported first.
        engine: the settings of the physics.
        cases: [B] case numbers.
        name: of the agent in `conf/agent/`.
        advance: called with 1 after each case, to show progress.

    Raises:
        ConfigurationError: the engine cannot play the scenario, or the policy cannot be exported.
    """
    world = PhysicsWorld(agent.scenario, engine)
    controller = controller_of(agent, name)
    records, errors = [], []
    for case in cases:
        run_case(world, controller, int(case))
        records.append(world.record())
        errors += world.tracking_errors
        if advance is not None:
            advance(1)
    episodes = Episodes(*(np.concatenate(parts) for parts in zip(*records, strict=True)))
    return PhysicsRun(episodes, float(np.mean(errors)))


def run_case(world: PhysicsWorld, controller: Controller, case: int) -> None:
    """Run one case to its end."""
    observation = world.reset(case)
    controller.reset()
    while not world.done:
        observation = decide_and_step(world, controller, observation)


def decide_and_step(
    world: PhysicsWorld, controller: Controller, observation: Observation
) -> Observation:
    """Let the robots decide and move until the next decision; return what they perceive then."""
    state = world.world.state
    time = float(state.clock[0]) * world.scenario.time_step
    return world.step(controller.decide(observation, ~state.arrived[0], time))
