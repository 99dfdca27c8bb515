"""Summary of a sweep of training runs."""

from __future__ import annotations

import re
import statistics
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from samarl.evaluation.table import markdown_table
from samarl.files import write_text
from samarl.training.learning_curve import read_curve

_SEED = re.compile(r"_?trainer\.seed-\d+_?")
_SUCCESS = "validation/success_"


class SummariseSeeds(Callback):
    """Hydra callback that writes and prints `summary.md` of a sweep: means over its seeds."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Summarise the runs in the folder of the sweep."""
        folder = Path(config.hydra.sweep.dir)
        text = summary(folder)
        if text:
            write_text(folder / "summary.md", f"{text}\n")
            print(f"\n{text}\nwritten to {folder}/summary.md")


def summary(folder: Path) -> str:
    """Return a table of the last validation of all runs in a folder; empty if there are none.

    Runs whose folders differ in `trainer.seed` only are one line: the mean success rate over the
    seeds, and the lowest and the highest.
    """
    runs: dict[str, list[dict[str, float]]] = {}
    for path in sorted(folder.rglob("progress.csv")):
        if row := _last_validation(path):
            name = _SEED.sub("", path.parent.relative_to(folder).as_posix())
            runs.setdefault(name, []).append(row)
    if not runs:
        return ""
    columns = list(dict.fromkeys(key for rows in runs.values() for row in rows for key in row))
    columns.remove("steps")
    header = ["run", "seeds", "steps", *(f"success {c.removeprefix(_SUCCESS)} %" for c in columns)]
    lines = []
    for name, rows in runs.items():
        steps = sorted({f"{row['steps']:,.0f}" for row in rows})
        cells = [_mean([row[key] for row in rows if key in row]) for key in columns]
        lines.append([name or "all", str(len(rows)), " or ".join(steps), *cells])
    return markdown_table(header, lines)


def _last_validation(path: Path) -> dict[str, float]:
    """Return the steps and the success rates of the last validation in a learning curve."""
    curve = {key: points for key, points in read_curve(path).items() if _SUCCESS in key}
    if not curve:
        return {}
    last = {key: float(values[-1]) for key, (_, values) in curve.items()}
    return {"steps": max(float(steps[-1]) for steps, _ in curve.values()), **last}


def _mean(rates: list[float]) -> str:
    """Return the mean of success rates with the lowest and the highest, in percent."""
    if not rates:
        return ""
    mean, low, high = (100 * f(rates) for f in (statistics.mean, min, max))
    return f"{mean:.1f} [{low:.1f}, {high:.1f}]" if len(rates) > 1 else f"{mean:.1f}"
