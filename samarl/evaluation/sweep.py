"""After a sweep: one table of all its cells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from mrsan import ConfigurationError
from samarl.evaluation.summary import Row, check_row
from samarl.evaluation.table import rows_as_markdown
from samarl.files import read_json, write_atomically, write_json


class GatherTable(Callback):
    """Writes `table.json` and `table.md` of the cells of a sweep in its folder.

    A launcher that runs cells in other processes does not report them here; then all finished
    cells of the folder are gathered.
    """

    def __init__(self) -> None:
        """Nothing gathered yet."""
        self.cells: list[Path] = []

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """One cell is done."""
        assert job_return.hydra_cfg is not None
        self.cells.append(Path(job_return.hydra_cfg.hydra.runtime.output_dir) / "row.json")
        if job_return.hydra_cfg.hydra.mode == RunMode.MULTIRUN:
            self._write(Path(config.hydra.sweep.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """All cells are done."""
        folder = Path(config.hydra.sweep.dir)
        text = self._write(folder)
        if text:
            print(f"\n{text}\nwritten to {folder}/table.md")

    def _write(self, folder: Path) -> str:
        """The table of the cells that are done so far."""
        cells = self.cells or sorted(folder.glob("**/row.json"))
        rows: list[Row] = [cell["row"] for cell in map(read_cell, cells) if cell is not None]
        if not rows:
            return ""
        rows.sort(key=lambda r: (r["method"], r["fov_degrees"], r["humans"], r["robots"]))
        text = rows_as_markdown(rows, with_settings=True)
        write_json(folder / "table.json", rows)
        write_atomically(folder / "table.md", text + "\n")
        return text


def read_cell(path: Path) -> dict[str, Any] | None:
    """What a finished cell wrote into its `row.json`; None: it must be played (again)."""
    try:
        cell: dict[str, Any] = read_json(path)
        check_row(cell["row"], path)
    except (ConfigurationError, TypeError, KeyError):
        return None
    return cell
