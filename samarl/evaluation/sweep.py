"""One table of all cells of a sweep."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from hydra.core.utils import JobReturn
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from mrsan import ConfigurationError
from samarl.evaluation.summary import Row, check_row
from samarl.evaluation.table import rows_as_markdown
from samarl.files import read_json, write_json, write_text


class GatherTable(Callback):
    """Hydra callback that writes `table.json` and `table.md` of a sweep into its folder.

    Launchers that run cells in other processes do not report them to this callback; in this case
    it gathers all finished cells of the folder at the end.
    """

    def __init__(self) -> None:
        """Start without cells."""
        self.cells: list[Path] = []
        self.process = platform.node(), os.getpid()  # copies in other processes do not write

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Add the cell that has ended."""
        if (platform.node(), os.getpid()) != self.process:
            return
        assert job_return.hydra_cfg is not None
        self.cells.append(Path(job_return.hydra_cfg.hydra.runtime.output_dir) / "row.json")
        if job_return.hydra_cfg.hydra.mode == RunMode.MULTIRUN:
            self._write(Path(config.hydra.sweep.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Write and print the table of all cells."""
        folder = Path(config.hydra.sweep.dir)
        text = self._write(folder)
        if text:
            print(f"\n{text}\nwritten to {folder}/table.md")

    def _write(self, folder: Path) -> str:
        """Write the table of the finished cells; return it as Markdown."""
        cells = self.cells or sorted(folder.glob("**/row.json"))
        rows: list[Row] = [cell["row"] for cell in map(read_cell, cells) if cell is not None]
        if not rows:
            return ""
        rows.sort(key=lambda r: (r["method"], r["fov_degrees"], r["humans"], r["robots"]))
        text = rows_as_markdown(rows, with_settings=True)
        write_json(folder / "table.json", rows)
        write_text(folder / "table.md", text + "\n")
        return text


def read_cell(path: Path) -> dict[str, Any] | None:
    """Return the content of a cell's `row.json`, or None if the cell must be run (again)."""
    try:
        cell: dict[str, Any] = read_json(path)
        check_row(cell["row"], path)
    except (ConfigurationError, TypeError, KeyError):
        return None
    return cell
