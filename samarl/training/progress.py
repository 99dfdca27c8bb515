"""How far a training run is, and its learning curve."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from samarl import distributed
from samarl.launch import world_size
from samarl.rollout import Rollout

SUCCESS_EPISODES = 2000  # last training episodes over which the success rate is averaged


class Progress:
    """Steps, time, success rates and learning curve of a training run, equal in all processes."""

    def __init__(self) -> None:
        """Start at zero."""
        self.steps_done = 0  # environment steps of all worlds together
        self.seconds = 0.0  # without validation and saving
        self.best_success = -1.0  # of all validations; -1 before the first
        self.recent_successes: deque[float] = deque(maxlen=SUCCESS_EPISODES)
        self.rows: list[dict[str, float]] = []  # the learning curve, one row per round

    def add_round(
        self,
        rollouts: list[Rollout],
        statistics: Mapping[str, float],
        start_time: float,
        collected_time: float,
    ) -> dict[str, float]:
        """Count a round of all processes.

        Args:
            rollouts: of this process.
            statistics: of this process's update.
            start_time: when the round began, see `time.perf_counter`.
            collected_time: when the rollouts were complete.

        Returns:
            The round's row of the learning curve.
        """
        episodes = [batch for rollout in rollouts for batch in rollout.episodes]
        successes = [float(success) for batch in episodes for success in batch.success]
        by_process = distributed.all_gather_object((successes, dict(statistics)))
        for process_successes, _ in by_process:
            self.recent_successes.extend(process_successes)
        seconds = time.perf_counter() - start_time  # until all processes are ready
        steps = world_size() * sum(rollout.environment_steps for rollout in rollouts)
        self.steps_done += steps
        self.seconds += seconds
        means = _means(process_statistics for _, process_statistics in by_process)
        return {
            "steps": float(self.steps_done),
            "seconds": round(self.seconds, 1),
            "charts/steps_per_second": round(steps / seconds, 1),
            "charts/collect_share": round((collected_time - start_time) / seconds, 3),
            "charts/success": round(float(np.mean(self.recent_successes or [0.0])), 4),
            **{name: round(value, 6) for name, value in means.items()},
        }

    def passed(self, interval: int, steps_before: int) -> bool:
        """Return whether a multiple of `interval` was reached since `steps_before`."""
        return self.steps_done // interval > steps_before // interval

    def state_dict(self) -> dict[str, Any]:
        """Return the progress in a form that can be written as JSON."""
        return {**vars(self), "recent_successes": list(self.recent_successes)}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state that `state_dict` returned."""
        self.steps_done, self.seconds = int(state["steps_done"]), float(state["seconds"])
        self.best_success = float(state["best_success"])
        self.recent_successes.clear()
        self.recent_successes.extend(map(float, state["recent_successes"]))
        self.rows = [dict(row) for row in state["rows"]]


def _means(statistics: Iterable[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each statistic over the processes that have it."""
    values_by_name: dict[str, list[float]] = {}
    for process_statistics in statistics:
        for name, value in process_statistics.items():
            values_by_name.setdefault(name, []).append(value)
    return {name: sum(values) / len(values) for name, values in values_by_name.items()}
