"""After a sweep: one table of all its cells."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from samarl.evaluation.files import write_atomically, write_json
from samarl.evaluation.summary import Row
from samarl.evaluation.table import rows_as_markdown


class GatherTable(Callback):
    """Writes `table.json` and `table.md` of every finished cell in the folder of a sweep."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """All cells are done, or one has failed."""
        folder = Path(config.hydra.sweep.dir)
        cells = sorted(folder.glob("**/row.json"))
        rows: list[Row] = [json.loads(cell.read_text())["row"] for cell in cells]
        if not rows:
            return
        rows.sort(key=lambda r: (r["method"], r["fov_degrees"], r["humans"], r["robots"]))
        text = rows_as_markdown(rows)
        write_json(folder / "table.json", rows)
        write_atomically(folder / "table.md", text + "\n")
        print(f"\n{text}\nwritten to {folder}/table.md")
