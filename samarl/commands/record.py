"""`samarl-record`: write the trajectories of one case, or a dataset of many cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import MISSING, DictConfig

from mrsan import ConfigurationError, Split
from mrsan.cases import CASES_PER_SPLIT
from mrsan.fields import check_numbers, number
from samarl import api
from samarl.agents import Agent
from samarl.commands.agents import agent_in, check_agent
from samarl.commands.cli import command_line, run_command
from samarl.evaluation.minari_dataset import check_dataset_id, write_dataset
from samarl.evaluation.trajectory import Trajectory, record_episode
from samarl.evaluation.trajnet import trajnet_lines
from samarl.files import atomic_write, check_writable
from samarl.progress import progress_bar


class Format(Enum):
    """What is written."""

    table = "table"
    minari = "minari"
    trajnet = "trajnet"


@dataclass
class Record:
    """Schema of `conf/record.yaml`."""

    case: int = number(MISSING, 0, len(Split) * CASES_PER_SPLIT - 1, help="first case number")
    cases: int = number(MISSING, 1, 10**6, help="number of cases from `case` on")
    split: Split = Split.test
    format: Format = Format.table
    output: str = MISSING
    scenario: Any = MISSING
    agent: Any = MISSING
    checkpoint: str | None = None
    plugins: list[str] = field(default_factory=list)


def main() -> None:
    """Entry point."""
    run_command(record, "record", check_agent, record_schema=Record)


def record(config: DictConfig) -> None:
    """Run the cases and write what `format` names."""
    settings = Record(config.case, config.cases, config.split, config.format, config.output)
    check_numbers(settings, "")
    check_output(settings)
    agent, target = agent_in(config), settings.output
    cases = settings.split.number(settings.case) + np.arange(settings.cases, dtype=np.int64)
    if settings.format is Format.table:
        table = api.record(agent, case=int(cases[0]))
        with atomic_write(Path(target)) as temporary:
            table.to_csv(temporary, index=False)
        print(f"written to {target}")
        return
    with progress_bar(total=len(cases), desc=agent.label, unit="case", leave=False) as bar:
        if settings.format is Format.minari:
            command = command_line("samarl-record")
            target = write_dataset(target, agent, cases, agent.label, command, bar.update)
        else:
            lines = trajnet_lines(_trajectories(agent, cases, bar.update))
            with atomic_write(Path(target)) as temporary, temporary.open("wb") as file:
                file.writelines(line.encode() for line in lines)
    print(f"written to {target}")


def check_output(settings: Record) -> None:
    """Check that the cases can be written in this format.

    Raises:
        ConfigurationError: the output or the number of cases does not suit the format.
    """
    path = Path(settings.output)
    if settings.format is Format.minari:
        check_dataset_id(settings.output)
        return
    ending = ".ndjson" if settings.format is Format.trajnet else ".csv"
    if path.suffix.lower() != ending:
        raise ConfigurationError(
            f"output is {settings.output!r}; it must end in {ending} for "
            f"format={settings.format.name}"
        )
    if settings.format is Format.table and settings.cases != 1:
        raise ConfigurationError(f"cases is {settings.cases}; it must be 1 for format=table")
    check_writable(path, "output")


def _trajectories(
    agent: Agent, cases: NDArray[np.int64], advance: Callable[[int], Any]
) -> Iterator[Trajectory]:
    """Yield the trajectory of each case."""
    for case in cases.tolist():
        yield record_episode(agent, agent.scenario, case)
        advance(1)


if __name__ == "__main__":
    main()
