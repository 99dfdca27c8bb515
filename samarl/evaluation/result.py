"""The result of an evaluation for Python programs and notebooks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mrsan import Episodes, Outcome, Scenario, social_score
from samarl.evaluation.metrics import METRICS
from samarl.evaluation.summary import Row

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, repr=False, eq=False)
class EvaluationResult:
    """B episodes of one agent in one scenario with N robots."""

    scenario: Scenario
    episodes: Episodes  # the records, in the order of the cases
    row: Row  # the row of a table, as in `row.json` of `samarl-evaluate`

    @property
    def success(self) -> NDArray[np.bool_]:
        """Return whether all robots arrived without a collision, [B]."""
        return self.episodes.success

    @property
    def social_score(self) -> NDArray[np.float64]:
        """Return the social score of each robot, [B, N], 0 to 100."""
        return social_score(self.episodes)

    def to_pandas(self) -> DataFrame:
        """Return one row per robot of each episode.

        `case`, `episode`, `success`, `duration`, `steps` and `deadlock` describe the episode and
        are repeated for its robots; the other columns, of which `mrsan.Episodes` gives the units,
        describe the robot.
        """
        from pandas import DataFrame

        robots = self.episodes.outcome.shape[1]
        columns = {
            name: np.repeat(values, robots) if values.ndim == 1 else values.ravel()
            for name, values in self.episodes._asdict().items()
        }
        columns["outcome"] = np.array([Outcome(value).name for value in columns["outcome"]])
        table = DataFrame(columns)
        table.insert(1, "robot", np.tile(np.arange(robots), len(self.episodes.case)))
        table.insert(2, "success", np.repeat(self.success, robots))
        table.insert(3, "social_score", self.social_score.ravel())
        return table

    def __repr__(self) -> str:
        s, row = self.scenario, self.row
        return (
            f"{row['method']} in {s.name} (people: {s.humans}, robots: {s.robots}, "
            f"view: {s.fov_degrees:g}°), {row['episodes']} cases\n"
            f"  success, %    {_with_interval(row, 'success_rate')}\n"
            f"  social score  {_with_interval(row, 'social_score')}"
        )


def _with_interval(row: Row, metric: str) -> str:
    """Return a metric of a row with its 95 % interval."""
    value, low, high = (row[field] for field in METRICS[metric].fields)
    return f"{value:.1f} [{low:.1f}, {high:.1f}]"
