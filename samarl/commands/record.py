"""`samarl-record`: write where everybody is at every step of one case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError, Split
from mrsan.cases import CASES_PER_SPLIT
from mrsan.fields import check_numbers, number
from samarl.agents import build_agent
from samarl.commands.agents import check_agent, print_scope_warning, selected_agent
from samarl.commands.cli import run_command
from samarl.configuration import scenario_in
from samarl.evaluation.trajectory import as_table, record_episode
from samarl.files import atomic_write, check_writable

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass
class Record:
    """Schema of `conf/record.yaml`."""

    case: int = number(MISSING, 0, len(Split) * CASES_PER_SPLIT - 1, help="case number")
    split: Split = Split.test
    output: str = MISSING
    scenario: Any = MISSING
    agent: Any = MISSING
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(record, "record", check_agent, record_schema=Record)


def record(config: DictConfig) -> None:
    """Run one case and write its trajectories."""
    scenario = scenario_in(config)
    check_numbers(Record(case=config.case, split=config.split), "")
    path = Path(config.output)
    write = table_writer(path)
    check_writable(path, "output")
    agent = build_agent(selected_agent(config), scenario)
    print_scope_warning(agent)
    table = as_table(record_episode(agent, scenario, config.split.number(config.case)))
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        write(table, file)
    print(f"written to {path}")


def table_writer(path: Path) -> Callable[[DataFrame, BinaryIO], None]:
    """Return the function that writes a table to a file with this extension.

    Raises:
        ConfigurationError: the extension is not supported.
    """
    writers: dict[str, Callable[[DataFrame, BinaryIO], None]] = {
        ".csv": lambda table, file: table.to_csv(file, index=False),
        ".npz": _write_npz,
    }
    if path.suffix.lower() not in writers:
        raise ConfigurationError(f"output is {str(path)!r}; it must end in {' or '.join(writers)}")
    return writers[path.suffix.lower()]


def _write_npz(table: DataFrame, file: BinaryIO) -> None:
    """Write one array per column."""
    columns = {name: table[name].to_numpy() for name in table}
    np.savez_compressed(file, **{**columns, "kind": columns["kind"].astype(np.str_)})


if __name__ == "__main__":
    main()
