"""Model cards beside the included policies, in the format of model hubs: `NAME.md`.

`python -m tools.update_docs` writes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from mrsan import TASKS
from samarl.evaluation.methods import label_of, method_of_policy
from samarl.evaluation.seeds import without_seed
from samarl.evaluation.summary import Row, column_of
from samarl.macro_level.network import MACRO_LEVEL
from samarl.policies.card import read_card
from samarl.report.leaderboard import task_of

_METRICS = {"success_rate": "joint success, %", "social_score": "social score"}


def model_cards(root: Path, rows: Sequence[Row]) -> dict[Path, str]:
    """Return the text of the card of each policy in `results/checkpoints`, by path.

    Args:
        root: the repository.
        rows: results, of which those of each policy without further settings are listed.
    """
    weights = sorted((root / "results/checkpoints").glob("*.safetensors"))
    return {path.with_suffix(".md"): _card(path, rows) for path in weights}


def _card(weights: Path, rows: Sequence[Row]) -> str:
    card, name = read_card(weights), weights.stem
    method = method_of_policy(name)
    best: dict[str, Row] = {}
    for row in sorted(rows, key=lambda row: int(row["episodes"])):  # the most cases win
        task, is_alone = task_of(row), column_of(row).team_perception == "none"
        if task and is_alone and row["method"] == method:
            best[TASKS[task].id] = row
    results = [
        {
            "task": {"type": "reinforcement-learning", "name": "social navigation"},
            "dataset": {"name": task, "type": task},
            "metrics": [
                {"type": key, "name": title, "value": row[key]} for key, title in _METRICS.items()
            ],
        }
        for task, row in best.items()
    ]
    front: dict[str, Any] = {
        "license": "mit",
        "library_name": "samarl",
        "pipeline_tag": "reinforcement-learning",
        "tags": ["robotics", "social-navigation", "multi-agent"],
    }
    if results:
        front["model-index"] = [{"name": name, "results": results}]
    origin = card.provenance
    seed_of = without_seed(name)
    about = label_of(method_of_policy(seed_of)) + ("" if seed_of == name else ", another seed")
    training = (
        f"`{origin.get('command', 'unknown')}` at commit {origin.get('commit', 'unknown')}, "
        f"{origin.get('steps', 0):,} steps in {origin.get('seconds', 0) / 60:.0f} minutes on "
        f"{origin.get('machine', 'an unknown machine')}"
    )
    use = f'`samarl-evaluate agent={name}` or `samarl.load_agent("{name}")`'
    if card.policy == MACRO_LEVEL:
        use = f"`samarl-evaluate agent=right_of_way agent.macro_level={name}`"
    return f"""---
{yaml.safe_dump(front, sort_keys=False, default_flow_style=None, width=200)}---

# {name}

{about}: a {card.policy} policy; every robot acts on its own observations.

- Use: {use}.
- Training: {training}.
- Limits: robots of another size or dynamics, and people who behave otherwise than in training; it
  is not certified for use among people. See `docs/models.md` and `docs/limitations.md`.
"""
