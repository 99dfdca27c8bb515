"""How far a training run is, and its learning curve."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from samarl import distributed
from samarl.launch import world_size
from samarl.rollout import Rollout

SUCCESS_EPISODES = 2000  # last training episodes over which the success rate is averaged
STAGE_EPISODES = 300  # the same of one stage


class Progress:
    """Steps, time, success rates and learning curve of a training run, equal in all processes."""

    def __init__(self) -> None:
        """Start at zero."""
        self.steps_done = 0  # environment steps of all worlds together
        self.seconds = 0.0  # without validation and saving
        self.best_success = -1.0  # of all validations; -1 before the first
        self.recent_successes: deque[float] = deque(maxlen=SUCCESS_EPISODES)
        self.stage_successes: dict[int, deque[float]] = {}
        self.stage_credit: dict[int, float] = {}  # a stage takes part in a round once it is 1
        self.rows: list[dict[str, float]] = []  # the learning curve, one row per round

    def add_round(
        self,
        rollouts: Mapping[int, Rollout],
        statistics: Mapping[str, float],
        start_time: float,
        collected_time: float,
    ) -> dict[str, float]:
        """Count a round of all processes.

        Args:
            rollouts: of this process, by the numbers of their stages.
            statistics: of this process's update.
            start_time: when the round began, see `time.perf_counter`.
            collected_time: when the rollouts were complete.

        Returns:
            The round's row of the learning curve.
        """
        successes = [
            (stage, float(success))
            for stage, rollout in rollouts.items()
            for batch in rollout.episodes
            for success in batch.success
        ]
        by_process = distributed.all_gather_object((successes, dict(statistics)))
        for process_successes, _ in by_process:
            for stage, success in process_successes:
                self.recent_successes.append(success)
                self._successes_of(stage).append(success)
        seconds = time.perf_counter() - start_time  # until all processes are ready
        steps = world_size() * sum(rollout.environment_steps for rollout in rollouts.values())
        self.steps_done += steps
        self.seconds += seconds
        means = _means(process_statistics for _, process_statistics in by_process)
        return {
            "steps": float(self.steps_done),
            "seconds": round(self.seconds, 1),
            "charts/steps_per_second": round(steps / seconds, 1),
            "charts/collect_share": round((collected_time - start_time) / seconds, 3),
            "charts/success": round(float(np.mean(self.recent_successes or [0.0])), 4),
            **{
                f"charts/success_of_stage_{stage}": round(float(np.mean(recent)), 4)
                for stage, recent in sorted(self.stage_successes.items())
                if recent
            },
            **{name: round(value, 6) for name, value in means.items()},
        }

    def next_stages(self, active: Sequence[int], least_participation: float) -> list[int]:
        """Return which of the active stages take part in the next round; at least one.

        Stages take part the more often, the more there is to learn: a stage with success p in a
        share 4 p (1 - p) of the rounds (learnability, Rutherford et al., 2024), but at least in
        `least_participation` of them.
        """
        for stage in active:
            share = max(least_participation, self._learnability(stage))
            self.stage_credit[stage] = self.stage_credit.get(stage, 0.0) + share
        credit = self.stage_credit
        due = [stage for stage in active if credit[stage] > 1.0 - 1e-9]
        due = due or [max(active, key=lambda stage: credit[stage])]
        for stage in due:
            credit[stage] -= 1.0
        return due

    def _learnability(self, stage: int) -> float:
        recent = self._successes_of(stage)
        if len(recent) < STAGE_EPISODES // 3:
            return 1.0
        success = float(np.mean(recent))
        return 4.0 * success * (1.0 - success)

    def _successes_of(self, stage: int) -> deque[float]:
        return self.stage_successes.setdefault(stage, deque(maxlen=STAGE_EPISODES))

    def passed(self, interval: int, steps_before: int) -> bool:
        """Return whether a multiple of `interval` was reached since `steps_before`."""
        return self.steps_done // interval > steps_before // interval

    def state_dict(self) -> dict[str, Any]:
        """Return the progress in a form that can be written as JSON."""
        return {
            **vars(self),
            "recent_successes": list(self.recent_successes),
            "stage_successes": {i: list(recent) for i, recent in self.stage_successes.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state that `state_dict` returned."""
        self.steps_done, self.seconds = int(state["steps_done"]), float(state["seconds"])
        self.best_success = float(state["best_success"])
        self.recent_successes.clear()
        self.recent_successes.extend(map(float, state["recent_successes"]))
        self.stage_successes.clear()
        for stage, recent in state["stage_successes"].items():  # JSON turned numbers into text
            self._successes_of(int(stage)).extend(map(float, recent))
        credit = state["stage_credit"].items()
        self.stage_credit = {int(stage): float(value) for stage, value in credit}
        self.rows = [dict(row) for row in state["rows"]]


def _means(statistics: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each statistic over the processes that have it."""
    values_by_name: dict[str, list[float]] = {}
    for process_statistics in statistics:
        for name, value in process_statistics.items():
            values_by_name.setdefault(name, []).append(value)
    return {name: sum(values) / len(values) for name, values in values_by_name.items()}
