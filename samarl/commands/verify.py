"""`samarl-verify`: check a file of `samarl-submit`, and replay some of its cases."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from omegaconf import OmegaConf

from mrsan import ConfigurationError, Scenario
from samarl.commands.bench import Bench
from samarl.commands.console import Parser, run
from samarl.configuration import (
    composed,
    hydra_tree,
    import_plugins,
    in_quotes,
    register_schemas,
    scenario_of,
)
from samarl.files import read_json
from samarl.submission import HASHED_CASES, check_submission, replay


def main() -> None:
    """Entry point."""
    parser = Parser(
        "samarl-verify",
        "Check that the rows of a submission follow from its records, and replay cases.",
        "written by samarl-submit",
    )
    parser.add_argument(
        "--cases", type=int, default=20, help="cases to replay per column (default: %(default)s)"
    )
    parser.add_argument("--all", action="store_true", help="replay all cases")
    parser.add_argument(
        "--code",
        type=Path,
        metavar="FOLDER",
        help="folder of the agent's modules and weights, which are run: read them first",
    )
    run(parser, verify)


def verify(arguments: argparse.Namespace) -> None:
    """Check a file and print what agrees.

    Raises:
        ConfigurationError: it cannot be read, was edited, or a replay differs.
    """
    path: Path = arguments.file
    if arguments.cases < 1:
        raise ConfigurationError(f"--cases is {arguments.cases}; it must be at least 1")
    content = read_json(path)
    scenarios, protocol = _protocol(content, arguments.code)
    checked = check_submission(content, path, scenarios)
    print(f"{len(checked)} of {len(scenarios)} columns of table {content['table']}")
    print("the rows follow from the records of all cases")
    for number in range(len(checked)):
        cases = len(checked[number][1].case)
        if cases < protocol:
            print(f"note: row {number} has {cases} of {protocol} cases")
    _use_code(content, path, arguments.code)
    for number, (scenario, episodes) in enumerate(checked):
        count = len(episodes.case)
        if arguments.all:
            sample = np.arange(count)
        else:
            more = np.random.default_rng().permutation(count)[: arguments.cases]
            sample = np.union1d(np.arange(min(HASHED_CASES, count)), more)
        print(replay(content, path, number, scenario, episodes, sample), flush=True)


def _protocol(content: object, folder: Path | None) -> tuple[list[Scenario], int]:
    """Return the columns and the number of cases of the table of a submission."""
    table = content.get("table") if isinstance(content, dict) else None
    with hydra_tree(folder):
        register_schemas(bench_schema=Bench)
        config = composed("bench", [f"table={in_quotes(str(table))}"])
        columns = [scenario_of(OmegaConf.to_container(column)) for column in config.columns]
        return columns, int(config.evaluation.cases)


def _use_code(content: dict[str, object], path: Path, folder: Path | None) -> None:
    """Let the agent of a submission be built.

    Raises:
        ConfigurationError: it is not one of the package, and there is no folder of its code.
    """
    settings = content["agent"]
    assert isinstance(settings, dict)
    plugins = content.get("plugins")
    own = not str(settings.get("_target_")).startswith("samarl.") or plugins
    if folder is None and own:
        raise ConfigurationError(
            f"{path} has the agent {settings.get('_target_')} with its own code; read it, and name "
            "its folder: --code FOLDER"
        )
    if folder is not None:
        sys.path.insert(0, str(folder))
        if isinstance(plugins, list):
            import_plugins(plugins)
        weights = folder / Path(str(settings.get("checkpoint"))).name
        if weights.is_file():
            settings["checkpoint"] = str(weights)


if __name__ == "__main__":
    main()
