"""Evaluation of one agent on fixed cases, in batches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Scenario, Split, World
from mrsan.fields import check_numbers, number, setting
from mrsan.metrics import episodes_of
from samarl.agents.agent import Controller, act_and_tell


@dataclass
class Evaluation:
    """The cases on which an agent is evaluated."""

    split: Split = setting(Split.test, help="cases to draw from")
    first_case: int = number(0, 0, 10**9, help="first case within the split")
    cases: int = number(500, 1, 10**6, help="number of cases")
    batch: int = number(
        256, 1, 10**5, help="worlds simulated in parallel; results do not depend on it"
    )

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            ConfigurationError: a number is out of range.
        """
        check_numbers(self, "evaluation")

    def case_numbers(self) -> NDArray[np.int64]:
        """Return the case numbers, [cases]."""
        return self.split.case(self.first_case) + np.arange(self.cases, dtype=np.int64)


def warm_up(agent: Controller, scenario: Scenario) -> None:
    """Let an agent act once, so that its kernels are compiled; it cannot be used afterwards."""
    world = World(scenario, 2)
    agent.reset(np.ones(2, np.bool_))
    agent.act(world.observe())


def run_cases(
    agent: Controller,
    scenario: Scenario,
    cases: NDArray[np.int64],
    batch: int,
    advance: Callable[[int], Any] | None = None,
) -> Episodes:
    """Run every case and return its record, in the order of `cases`.

    A world whose episode has ended starts the next case immediately, so the batch stays full.

    Args:
        agent: the controller of all robots; its method `focus` is called if it has one.
        scenario: the task.
        cases: [B] case numbers, all different.
        batch: number of worlds simulated in parallel.
        advance: called with the number of episodes that have just ended, to show progress.
    """
    worlds = min(batch, len(cases))
    world = World(scenario, worlds)
    is_init = np.ones(worlds, np.bool_)
    current = cases[:worlds].copy()
    observation = world.reset(current)
    started, remaining = worlds, len(cases)
    records: list[Episodes] = []
    focus = getattr(agent, "focus", None)
    while True:
        if is_init.any():
            agent.reset(is_init)
        if focus is not None:
            focus((current >= 0)[:, None] & ~world.state.arrived)
        step = world.step(act_and_tell(agent, observation, world))
        observation = step.observation
        ended = (step.terminated | step.truncated) & (current >= 0)
        is_init = np.zeros(worlds, np.bool_)
        if not ended.any():
            continue
        records.append(episodes_of(world.state, scenario, ended))
        if advance is not None:
            advance(int(ended.sum()))
        remaining -= int(ended.sum())
        if not remaining:
            break
        current[ended] = -1
        slots = np.flatnonzero(ended)[: len(cases) - started]
        if len(slots):
            current[slots] = cases[started : started + len(slots)]
            started += len(slots)
            is_init[slots] = True
            observation = world.reset(np.maximum(current, 0), is_init)
    episodes = Episodes(*(np.concatenate(parts) for parts in zip(*records, strict=True)))
    row_of_case = {case: row for row, case in enumerate(episodes.case.tolist())}
    order = np.array([row_of_case[case] for case in cases.tolist()])
    return Episodes(*(array[order] for array in episodes))
