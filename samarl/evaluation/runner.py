"""Run one agent over fixed cases, in batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from mrsan import Episodes, Observation, Scenario, Split, World
from mrsan.fields import check_numbers, number, setting
from mrsan.metrics import episodes_of


@dataclass
class Evaluation:
    """Which cases are played."""

    split: Split = setting(Split.test, help="cases to draw from")
    first_case: int = number(0, 0, 10**9, help="first case within the split")
    cases: int = number(500, 1, 10**6, help="number of cases")
    batch: int = number(
        128, 1, 10**5, help="worlds simulated side by side; does not affect the result"
    )

    def __post_init__(self) -> None:
        """Check every number."""
        check_numbers(self, "evaluation")

    def numbers(self) -> NDArray[np.int64]:
        """The case numbers, [cases]."""
        return self.split.case(self.first_case) + np.arange(self.cases, dtype=np.int64)


class Driver(Protocol):
    """What `run_cases` needs of an agent."""

    def reset(self, worlds: NDArray[np.bool_]) -> None:
        """Forget the worlds [E] in which an episode begins."""

    def act(self, observation: Observation) -> NDArray[np.float32]:
        """The action of every robot, [E, N, A]."""


def run_cases(
    agent: Driver, scenario: Scenario, cases: NDArray[np.int64], batch: int, title: str = ""
) -> Episodes:
    """The record of every case, in the order given.

    A world that has ended begins the next case at once, so the batch stays full.

    Args:
        agent: drives all robots.
        scenario: the task.
        cases: [B] case numbers, all different.
        batch: worlds side by side.
        title: of the progress bar; empty: none.
    """
    worlds = min(batch, len(cases))
    world = World(scenario, worlds)
    begins = np.ones(worlds, np.bool_)
    current = cases[:worlds].copy()
    observation = world.reset(current)
    begun, remaining = worlds, len(cases)
    records: list[Episodes] = []
    with tqdm(
        total=len(cases), desc=title, unit="case", leave=False, disable=None if title else True
    ) as bar:
        while True:
            if begins.any():
                agent.reset(begins)
            step = world.step(agent.act(observation))
            observation = step.observation
            ended = (step.terminated | step.truncated) & (current >= 0)
            begins = np.zeros(worlds, np.bool_)
            if not ended.any():
                continue
            records.append(episodes_of(world.state, scenario, ended))
            bar.update(int(ended.sum()))
            remaining -= int(ended.sum())
            if not remaining:
                break
            current[ended] = -1
            slots = np.flatnonzero(ended)[: len(cases) - begun]
            if len(slots):
                current[slots] = cases[begun : begun + len(slots)]
                begun += len(slots)
                begins[slots] = True
                observation = world.reset(np.maximum(current, 0), begins)
    played = Episodes(*(np.concatenate(parts) for parts in zip(*records, strict=True)))
    by_case = {number: row for row, number in enumerate(played.case.tolist())}
    order = np.array([by_case[number] for number in cases.tolist()])
    return Episodes(*(array[order] for array in played))
