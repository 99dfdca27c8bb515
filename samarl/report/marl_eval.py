"""Results in the format of marl-eval (Gorsane et al., 2022), for its statistics and plots."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from samarl.evaluation.summary import Row, column_of
from samarl.evaluation.table import column_name
from samarl.report.leaderboard import task_of


def marl_eval_json(rows: Sequence[Row]) -> str:
    """Return rows as `environment: task: algorithm: seed: absolute_metrics`, one value per seed."""
    tasks: dict[str, Any] = {}
    for row in rows:
        success = row.get("success_of_seeds", [row["success_rate"]])
        social = row.get("social_of_seeds", [row["social_score"]])
        task = task_of(row) or column_name(column_of(row))
        tasks.setdefault(task, {})[row["method"]] = {
            f"seed_{k}": {
                "absolute_metrics": {"success_rate": [values[0]], "social_score": [values[1]]}
            }
            for k, values in enumerate(zip(success, social, strict=True))
        }
    return json.dumps({"mrsan": tasks}, indent=1) + "\n"
